"""What systemd hears, and that nobody listening is no error."""

import os
import socket

import pytest

from fringed.sdnotify import Notifier


@pytest.mark.parametrize("abstract", [False, True])
def test_ready_status_and_watchdog_arrive(tmp_path, abstract):
    name = f"fringed-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(f"\0{name}" if abstract else name)
        manager.settimeout(5)
        notifier = Notifier({"NOTIFY_SOCKET": f"@{name}" if abstract else name, "WATCHDOG_USEC": "2000000"})
        notifier.ready("serving")
        notifier.alive()
        notifier.close()
        assert manager.recv(1000).decode().splitlines()[:2] == ["READY=1", "STATUS=serving"]
        assert manager.recv(1000) == b"WATCHDOG=1"
    assert notifier.watchdog_s == 2.0


def test_without_a_manager_nothing_happens():
    notifier = Notifier({})
    notifier.ready("x")
    assert notifier.watchdog_s == 0.0


def test_a_manager_that_is_gone_is_no_error(tmp_path):
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")})
    notifier.ready("x")
    notifier.close()


def test_the_watchdog_of_another_process_is_not_ours():
    assert Notifier({"WATCHDOG_USEC": "5", "WATCHDOG_PID": "1"}).watchdog_s == 0.0
