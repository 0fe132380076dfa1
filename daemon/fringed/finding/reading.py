"""Small files of /sys, and links to device nodes.

Owns that a file which is missing, unreadable or torn away while it is read is an empty text.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

LINK_FOLDERS = ("dev/fringed", "dev/serial/by-id", "dev/serial/by-path", "dev/v4l/by-id", "dev/v4l/by-path")


def text(path: Path) -> str:
    """Return a file's text without the space around it; empty where it cannot be read."""
    try:
        return path.read_bytes().decode("utf-8", "replace").strip().strip("\0")
    except OSError:
        return ""


def data(path: Path) -> bytes:
    """Return a file's bytes; none where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError:
        return b""


def number(path: Path) -> int | None:
    """Return the whole number in a file; None where there is none."""
    try:
        return int(text(path))
    except ValueError:
        return None


def entries(folder: Path, pattern: str = "*") -> list[Path]:
    """Return what is in a folder, sorted; nothing where it cannot be listed."""
    try:
        return sorted(folder.glob(pattern), key=lambda path: _in_order(path.name))
    except OSError:
        return []


def target_name(link: Path) -> str:
    """Return the last part of what a link points to; empty where it is none."""
    try:
        return link.readlink().name
    except OSError:
        return ""


def links_to(root: Path, node: str) -> tuple[str, ...]:
    """Return the stable names, ours first, that lead to the device node `node` such as `/dev/ttyUSB0`."""
    wanted = root / node.lstrip("/")
    return tuple(
        f"/{link.relative_to(root)}" for link in _links(root) if _end(link) == _end(wanted)
    )  # fmt: skip


def _links(root: Path) -> Iterator[Path]:
    for folder in LINK_FOLDERS:
        yield from (path for path in entries(root / folder) if path.is_symlink())


def _end(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        return path


def _in_order(name: str) -> tuple[str, int, str]:
    """Let ttyUSB10 follow ttyUSB9."""
    head = name.rstrip("0123456789")
    tail = name[len(head) :]
    return head, int(tail) if tail else -1, name
