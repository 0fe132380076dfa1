"""Bytes to and from files, with the errors of a full, unwritable or vanished disk in plain words.

Owns the system calls that make a write lasting; knows nothing of HDF5 or of what is written.
"""

from __future__ import annotations

import ctypes
import errno
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fringed.data import Array
from fringed.errors import StorageError

_SYNC_FILE_RANGE_WRITE = 2
_CHUNK_BYTES = 8 * 1024 * 1024
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_DENIED = (errno.EACCES, errno.EPERM, errno.EROFS)
_libc = ctypes.CDLL(None, use_errno=True)


def free_bytes(folder: Path) -> int:
    """Return what an unprivileged user may still write there; 0 where the folder is gone."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


@contextmanager
def storage_errors(folder: Path, needed_bytes: int = 0, making: bool = False) -> Iterator[None]:
    """Turn what the system (or HDF5) raises into a StorageError; `making`: the folder was not there before."""
    try:
        yield
    except StorageError:
        raise
    except (OSError, RuntimeError) as error:  # h5py raises RuntimeError where closing a file fails
        raise storage_error(error, folder, needed_bytes, making) from error


def storage_error(error: Exception, folder: Path, needed_bytes: int = 0, making: bool = False) -> StorageError:
    """Say in plain words what failed at `folder`."""
    number = _errno(error)
    needed = f"{needed_bytes / 1e6:.1f} MB needed, " if needed_bytes else ""
    if number in _FULL:
        text = (
            f"the disk of {folder} is full: {needed}{free_bytes(folder) / 1e6:.1f} MB free; "
            "remove recordings, or set data_dir to another disk"
        )
    elif number in _DENIED:
        text = f"{folder} cannot be written ({os.strerror(number)}); give this user the right to, or set data_dir"
    elif file := next((one for one in (folder, *folder.parents) if one.is_file()), None):
        text = f"{folder} cannot be a folder of recordings: {file} is a file; set data_dir to a folder"
    elif number in (errno.ENOENT, errno.ENOTDIR, errno.ESTALE) and making:
        text = f"{folder} does not exist and cannot be made ({os.strerror(number)}); set data_dir to another folder"
    elif number in (errno.ENOENT, errno.ENOTDIR, errno.ESTALE):
        text = f"{folder} has vanished ({os.strerror(number)}); mount or make it again, or set data_dir"
    else:
        text = f"writing to {folder} failed: {error}; check the disk and its cable, or set data_dir to another one"
    return StorageError(text)


def _errno(error: Exception) -> int:
    if isinstance(error, OSError) and error.errno:
        return error.errno
    found = re.search(r"errno = (\d+)", str(error))
    return int(found[1]) if found else 0


def write_at(fd: int, data: Array | bytes, offset: int, start_io: bool = True) -> None:
    """Write all of `data` at `offset`, and have the kernel start to put it on the disk.

    The early start leaves little for the sync at the end; it is a hint, so file systems without it
    are as right, only slower.
    """
    whole: memoryview[Any] = memoryview(data)  # type: ignore[arg-type]
    view = whole.cast("B") if whole.nbytes else memoryview(b"")
    done = 0
    while done < len(view):
        written = os.pwrite(fd, view[done : done + _CHUNK_BYTES], offset + done)
        if start_io:
            _libc.sync_file_range(
                fd, ctypes.c_int64(offset + done), ctypes.c_int64(written), ctypes.c_uint(_SYNC_FILE_RANGE_WRITE)
            )  # fmt: skip
        done += written


def read_at(fd: int, into: memoryview, offset: int) -> int:
    """Fill `into` from `offset`; return how many bytes there were."""
    done = 0
    while done < len(into):
        count = os.preadv(fd, [into[done:]], offset + done)
        if count == 0:
            break
        done += count
    return done


def make_folder(folder: Path) -> None:
    """Make `folder` and its parents so that they survive a loss of power."""
    missing = [p for p in (folder, *folder.parents) if not p.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for made in missing:
        sync_folder(made.parent)


def sync_folder(folder: Path) -> None:
    """Make the folder's entries lasting."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def replace_file(path: Path, content: bytes) -> None:
    """Put a small file in place of another, whole or not at all."""
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        sync_folder(path.parent)
    except OSError:
        with suppress(OSError):
            part.unlink()
        raise
