"""Where sockets and recordings are, from configuration and environment.

Owns the rules only: nothing is created here.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

IPC_PATH_MAX = 107  # sun_path of a Unix socket, without its final zero


def runtime_dir(configured: str = "") -> Path:
    """Return the folder of the sockets: configured, $FRINGED_RUNTIME_DIR, $XDG_RUNTIME_DIR/fringed, or one in /tmp."""
    if configured or os.environ.get("FRINGED_RUNTIME_DIR"):
        return Path(configured or os.environ["FRINGED_RUNTIME_DIR"]).expanduser()
    if os.environ.get("XDG_RUNTIME_DIR"):
        return Path(os.environ["XDG_RUNTIME_DIR"]) / "fringed"
    return Path(tempfile.gettempdir()) / f"fringed-{os.getuid()}"


def data_dir(configured: str = "") -> Path:
    """Return the folder of the recordings: configured, $FRINGED_DATA_DIR, or the user's data folder."""
    if configured or os.environ.get("FRINGED_DATA_DIR"):
        return Path(configured or os.environ["FRINGED_DATA_DIR"]).expanduser()
    base = os.environ.get("XDG_DATA_HOME")
    return (Path(base) if base else Path.home() / ".local" / "share") / "fringed"


def endpoint(runtime: Path, socket: str) -> str:
    """Return the ZeroMQ address of `socket` ("control", "stream" or "work") in a runtime folder."""
    return f"ipc://{runtime / socket}"
