"""The runtime directory: private to the user, and owned by one daemon at a time.

Owns the folder's mode, the lock file and stale sockets; knows nothing of what is served there.
"""

from __future__ import annotations

import fcntl
import os
import stat
import time
from pathlib import Path

from fringed.config.paths import IPC_PATH_MAX
from fringed.errors import ConfigurationError, StationBusy, StorageError

SOCKETS = ("control", "stream", "work")


def lock_holder(folder: Path) -> int | None:
    """Return the process id of the daemon that owns `folder`, None when nobody does."""
    try:
        descriptor = os.open(folder / "lock", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _pid_in(descriptor)
    finally:
        os.close(descriptor)
    return None


class RuntimeLock:
    """Own a runtime directory from `acquire` to `release`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._descriptor = -1

    def acquire(self) -> None:
        """Make the folder, take its lock and remove sockets that a dead daemon left.

        Raises
        ------
        StationBusy
            another daemon serves there; the message names its process.
        StorageError
            the folder cannot be made or used.
        ConfigurationError
            its path is too long for a socket.
        """
        self._check_length()
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._check_owner()
            self._descriptor = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            _lock(self._descriptor)
        except BlockingIOError as error:
            pid = _pid_in(self._descriptor)
            self._close()
            who = f"process {pid}" if pid else "another process"
            raise StationBusy(
                f"{who} already serves in {self.folder}; stop it (kill {pid or 'PID'}), "
                f"or set another FRINGED_RUNTIME_DIR"
            ) from error
        except StorageError:  # which is an OSError too
            raise
        except OSError as error:
            raise StorageError(
                f"the runtime directory {self.folder} cannot be used: {error.strerror or error}; "
                f"set FRINGED_RUNTIME_DIR to a folder that this user can write"
            ) from error
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, f"{os.getpid()}\n".encode(), 0)
        self.remove_sockets()

    def remove_sockets(self) -> None:
        """Remove the sockets' files; only while the lock is held."""
        for name in SOCKETS:
            (self.folder / name).unlink(missing_ok=True)

    def release(self) -> None:
        """Give the folder back; the lock file stays, so that nobody locks a removed one."""
        if self._descriptor >= 0:
            self.remove_sockets()
            os.ftruncate(self._descriptor, 0)
            self._close()

    def _check_length(self) -> None:
        longest = max(len(os.fsencode(self.folder / name)) for name in SOCKETS)
        if longest > IPC_PATH_MAX:
            raise ConfigurationError(
                f"the runtime directory {self.folder} gives sockets of {longest} bytes; the system allows "
                f"{IPC_PATH_MAX}: set FRINGED_RUNTIME_DIR to a shorter path"
            )

    def _check_owner(self) -> None:
        info = self.folder.stat()
        if info.st_uid != os.getuid():
            raise StorageError(
                f"the runtime directory {self.folder} belongs to user {info.st_uid}, this is user {os.getuid()}; "
                f"set FRINGED_RUNTIME_DIR to a folder of your own"
            )
        if stat.S_IMODE(info.st_mode) != 0o700:
            self.folder.chmod(0o700)

    def _close(self) -> None:
        os.close(self._descriptor)
        self._descriptor = -1


def _lock(descriptor: int) -> None:
    """Take the lock; whoever only looks (`lock_holder`) holds it for a moment, so try more than once."""
    for _ in range(5):
        try:
            return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(0.02)
    return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _pid_in(descriptor: int) -> int | None:
    text = os.pread(descriptor, 32, 0).strip()
    return int(text) if text.isdigit() else None
