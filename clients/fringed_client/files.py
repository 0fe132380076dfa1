"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from fringed.errors import StorageError


def write_aside(path: Path, content: Any) -> Path:
    """Write bytes (or whatever exports a buffer) beside `path`, then rename.

    Raises
    ------
    StorageError
        the folder is missing, unwritable or full.
    """
    aside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        aside.write_bytes(content)
        aside.replace(path)
    except OSError as error:
        aside.unlink(missing_ok=True)
        raise StorageError(f"{path} cannot be written: {error.strerror or error}; choose another --output") from error
    return path


def make_folder(path: Path) -> Path:
    """Return the folder, made if need be.

    Raises
    ------
    StorageError
        it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"the folder {path} cannot be made: {error.strerror or error}; choose another one"
        ) from error
    return path
