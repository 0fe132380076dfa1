"""One daemon owns a runtime directory; what a dead one left is removed."""

import os
import signal
import stat
import subprocess
import sys

import pytest

from fringed.errors import ConfigurationError, StationBusy, StorageError
from fringed.serving.runtime import RuntimeLock, lock_holder


def test_a_second_owner_is_refused_with_the_process_of_the_first(tmp_path):
    first = RuntimeLock(tmp_path / "run")
    first.acquire()
    with pytest.raises(StationBusy, match=str(os.getpid())):
        RuntimeLock(tmp_path / "run").acquire()
    assert lock_holder(tmp_path / "run") == os.getpid()
    first.release()
    assert lock_holder(tmp_path / "run") is None
    again = RuntimeLock(tmp_path / "run")
    again.acquire()
    again.release()


def test_the_folder_is_private_and_stale_sockets_go(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir(mode=0o755)
    (folder / "control").write_text("stale")
    (folder / "other").write_text("kept")
    lock = RuntimeLock(folder)
    lock.acquire()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert not (folder / "control").exists()
    assert (folder / "other").exists()
    lock.release()


def test_the_lock_of_a_killed_process_is_free(tmp_path):
    code = (
        "import sys, os; from pathlib import Path; from fringed.serving.runtime import RuntimeLock\n"
        f"RuntimeLock(Path({str(tmp_path)!r})).acquire(); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    lock = RuntimeLock(tmp_path)
    lock.acquire()
    lock.release()


def test_a_path_that_is_too_long_for_sockets_is_told(tmp_path):
    with pytest.raises(ConfigurationError, match="the system allows 107"):
        RuntimeLock(tmp_path / ("x" * 120)).acquire()


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="FRINGED_RUNTIME_DIR"):
        RuntimeLock(tmp_path / "file" / "run").acquire()
