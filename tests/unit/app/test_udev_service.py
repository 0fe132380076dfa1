"""The unit, the user and the folders, as systemd's own tools judge them without a running systemd."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

UDEV = Path(__file__).resolve().parents[3] / "udev"
UNIT = UDEV / "fringed.service"
MOST_EXPOSURE = 2.0


def tool(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed here")
    return found


def exposure(unit: Path) -> float:
    command = [tool("systemd-analyze"), "security", "--offline=true", "--no-pager", str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "unrecognized option" in done.stderr:
        pytest.skip("this systemd-analyze is older than 250: it judges running units only")
    found = re.search(r"Overall exposure level for \S+: ([\d.]+)", done.stdout)
    assert found, done.stdout + done.stderr
    return float(found[1])


def test_exposure_is_at_most_2(capsys):
    level = exposure(UNIT)
    with capsys.disabled():
        print(f"\nsystemd-analyze security: exposure {level}, at most {MOST_EXPOSURE} wanted")
    assert level <= MOST_EXPOSURE


def test_exposure_stays_below_with_a_network_for_devices(tmp_path):
    unit = tmp_path / UNIT.name
    unit.write_text(UNIT.read_text().replace("IPAddressAllow=localhost", "IPAddressAllow=localhost 192.168.7.0/24"))
    assert exposure(unit) <= MOST_EXPOSURE


def test_unit_is_valid(tmp_path):
    unit = tmp_path / UNIT.name
    unit.write_text(UNIT.read_text().replace("/usr/bin/fringed", sys.executable))
    done = subprocess.run(
        [tool("systemd-analyze"), "verify", "--no-pager", str(unit)], capture_output=True, text=True, check=False
    )  # fmt: skip
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def settings() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in UNIT.read_text().splitlines():
        if "=" in line and not line.startswith("#"):
            key, _, value = line.partition("=")
            found.setdefault(key, []).append(value)
    return found


def test_unit_lets_the_daemon_do_its_work():
    unit = settings()
    allowed = {value.split()[0] for value in unit["DeviceAllow"]}
    assert {"char-ttyUSB", "char-ttyACM", "char-usb_device", "char-drm", "char-video4linux", "char-tty"} <= allowed
    assert "yes" not in unit.get("MemoryDenyWriteExecute", [])  # numba's compiler
    assert not {"PrivateDevices", "PrivateNetwork", "TasksMax"} & set(unit)
    assert "AF_NETLINK" in unit["RestrictAddressFamilies"][0]  # libusb hears of plugging by it
    assert unit["Type"] == ["notify"] and int(unit["WatchdogSec"][0]) >= 5


def test_classes_of_devices_are_known_before_the_service_starts():
    unit = settings()
    assert all(name in unit["Wants"][0] and name in unit["After"][0] for name in ("usbserial", "cdc_acm", "videodev"))


def test_user_and_groups_are_those_of_the_unit(tmp_path):
    (tmp_path / "etc").mkdir()
    command = [tool("systemd-sysusers"), f"--root={tmp_path}", str(UDEV / "sysusers.d" / "fringed.conf")]
    subprocess.run(command, capture_output=True, check=True)
    assert re.search(
        r"^fringed:x:\d+:\d+:.*:/var/lib/fringed:/usr/sbin/nologin$", (tmp_path / "etc/passwd").read_text()
    )
    groups = dict(line.split(":")[0::3] for line in (tmp_path / "etc/group").read_text().splitlines())
    assert {name for name, members in groups.items() if members == "fringed"} == set(
        settings()["SupplementaryGroups"][0].split()
    )


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives folders away")
def test_folder_and_usb_memory_are_set(tmp_path):
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/passwd").write_text("root:x:0:0::/root:/bin/sh\n")
    (tmp_path / "etc/group").write_text("root:x:0:\nfringed:x:997:\n")
    limit = tmp_path / "sys/module/usbcore/parameters/usbfs_memory_mb"
    limit.parent.mkdir(parents=True)
    limit.write_text("16\n")
    command = [tool("systemd-tmpfiles"), f"--root={tmp_path}", "--create", str(UDEV / "tmpfiles.d" / "fringed.conf")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    folder = (tmp_path / "etc/fringed").stat()
    assert (folder.st_mode & 0o777, folder.st_uid, folder.st_gid) == (0o750, 0, 997)
    assert int(limit.read_text()) == 256
