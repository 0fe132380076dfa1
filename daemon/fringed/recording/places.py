"""Where a recording lies: `DATA/YYYY/MM/DD/<id>.<kind>.h5`, found from its id alone.

Owns names and folders; opens no file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from fringed.data import RECORDED
from fringed.errors import NotFound, UsageError

SUFFIX = ".h5"
PART = ".part"
_ID = re.compile(r"(\d{4})(\d{2})(\d{2})T\d{6}\.\d{6}Z-[0-9a-f]{4}")
_DIGITS = re.compile(r"\d+")


def kebab(kind: str) -> str:
    """Return `range-image` for `RangeImage`."""
    return "".join(f"-{c.lower()}" if c.isupper() else c for c in kind).lstrip("-")


KIND_OF_NAME = {kebab(cls.__name__): cls.__name__ for cls in RECORDED}


def kind_named(name: str) -> str:
    """Return the type's name for `RangeImage`, `range-image` or `rangeimage`.

    Raises
    ------
    UsageError
        nothing of that name is recorded.
    """
    for short, kind in KIND_OF_NAME.items():
        if name.lower() in (short, kind.lower()):
            return kind
    raise UsageError(f"nothing of kind {name!r} is recorded; there are {', '.join(sorted(KIND_OF_NAME))}")


def day_of(record_id: str) -> str:
    """Return `YYYY/MM/DD` of an id.

    Raises
    ------
    UsageError
        it is not an id of this station's making.
    """
    match = _ID.fullmatch(record_id)
    if match is None:
        raise UsageError(f"{record_id[:80]!r} is not an id; one looks like 20260102T030405.678901Z-1f0c")
    return "/".join(match.groups())


def place(root: Path, record_id: str, kind: str) -> Path:
    """Return where a recording of that id and kind belongs."""
    return root / day_of(record_id) / f"{record_id}.{kebab(kind)}{SUFFIX}"


def find(root: Path, record_id: str) -> Path:
    """Return where the recording lies.

    Raises
    ------
    NotFound
        there is none of that id.
    """
    folder = root / day_of(record_id)
    for name in KIND_OF_NAME:
        path = folder / f"{record_id}.{name}{SUFFIX}"
        if path.exists():
            return path
    raise NotFound(f"nothing is recorded under the id {record_id} in {root}; `fringe list` shows what is")


def parse(name: str) -> tuple[str, str] | None:
    """Return id and kind of a file's name, None for what is no recording."""
    if not name.endswith(SUFFIX):
        return None
    record_id, dot, short = name[: -len(SUFFIX)].rpartition(".")
    kind = KIND_OF_NAME.get(short)
    return (record_id, kind) if dot and kind and _ID.fullmatch(record_id) else None


def newest_first(root: Path, before: str = "") -> Iterator[tuple[str, str, Path]]:
    """Yield id, kind and path of every recording whose id sorts before `before`, newest first."""
    for folder in day_folders(root):
        day = "".join(folder.parts[-3:])
        if before and day > before[:8]:
            continue
        for name in sorted(_names(folder), reverse=True):
            parsed = parse(name)
            if parsed is not None and (not before or parsed[0] < before):
                yield parsed[0], parsed[1], folder / name


def day_folders(root: Path) -> Iterator[Path]:
    """Yield the folders of days, newest first."""
    for year in _numbered(root):
        for month in _numbered(year):
            yield from _numbered(month)


def parts(root: Path) -> list[Path]:
    """Return every file that was being written."""
    found = [p for p in (root / n for n in _names(root)) if p.name.endswith(PART)]
    for folder in day_folders(root):
        found += [folder / name for name in _names(folder) if name.endswith(PART)]
    return found


def _numbered(folder: Path) -> list[Path]:
    return [folder / name for name in sorted(_names(folder), reverse=True) if _DIGITS.fullmatch(name)]


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208  ten thousand names: Path objects would cost ten times as much
    except (FileNotFoundError, NotADirectoryError):
        return []
