"""The rules of udev, run by the machine's own `udevadm test` on an emulated /sys in a namespace of their own."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from fake_machine import HOST, lab

from fringed.errors import UsageError
from fringed.finding.naming import name_rules

UDEV = Path(__file__).resolve().parents[3] / "udev"
RULES = UDEV / "60-fringed.rules"
IN_NAMESPACE = """
set -eu
mount --bind "$1/sys" /sys
mount -t tmpfs none /run
mkdir /run/real; mount --rbind /dev /run/real
mount -t tmpfs none /dev
cp -a "$1/dev/." /dev/
touch /dev/null; mount --bind /run/real/null /dev/null
mkdir -p /run/udev/rules.d; cp "$1"/rules/*.rules /run/udev/rules.d/
shift
for device; do echo "@@@ $device"; udevadm test "/sys/$device" 2>&1; done
"""
USB1 = f"{HOST}/usb1"
DEVICES = {
    "ftdi": f"{USB1}/1-1/1-1:1.0/ttyUSB0/tty/ttyUSB0",
    "ftdi usb": f"{USB1}/1-1",
    "ftdi chip": f"{USB1}/1-1/1-1:1.0/ttyUSB0",
    "alike 1": f"{USB1}/1-3/1-3.1/1-3.1:1.0/ttyUSB2/tty/ttyUSB2",
    "alike 2": f"{USB1}/1-3/1-3.2/1-3.2:1.0/ttyUSB3/tty/ttyUSB3",
    "double 0": f"{USB1}/1-4/1-4:1.0/ttyUSB4/tty/ttyUSB4",
    "double 1": f"{USB1}/1-4/1-4:1.1/ttyUSB5/tty/ttyUSB5",
    "acm": f"{USB1}/1-5/1-5:1.0/tty/ttyACM0",
    "board": "devices/platform/serial8250/tty/ttyS0",
    "webcam": f"{USB1}/1-6/1-6:1.0/video4linux/video0",
    "webcam metadata": f"{USB1}/1-6/1-6:1.0/video4linux/video1",
    "webcam usb": f"{USB1}/1-6",
    "u3v": f"{HOST}/usb2/2-1",
}


def namespaced(root: Path, rules: dict[str, str]) -> dict[str, str]:
    """Return what `udevadm test` says of each device of a machine, with `rules` beside the distribution's."""
    udevadm, unshare = shutil.which("udevadm"), shutil.which("unshare")
    if not udevadm or not unshare:
        pytest.skip("udevadm and unshare are needed to run rules on emulated devices")
    (root / "rules").mkdir()
    for name, text in rules.items():
        (root / "rules" / name).write_text(text)
    flags = ["-m"] if os.geteuid() == 0 else ["-rm"]
    probe = subprocess.run([unshare, *flags, "true"], capture_output=True, text=True, check=False)
    if probe.returncode:
        pytest.skip(f"this user may make no namespaces: {probe.stderr.strip()}")
    command = [unshare, *flags, "bash", "-c", IN_NAMESPACE, "bash", str(root), *DEVICES.values()]
    environment = os.environ | {"SYSTEMD_DEVICE_VERIFY_SYSFS": "0"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=100)
    if "mount" in done.stderr:
        pytest.skip(f"nothing may be mounted here: {done.stderr.strip()}")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    parts = done.stdout.split("@@@ ")[1:]
    return dict(zip(DEVICES, parts, strict=True))


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    root = lab(tmp_path_factory.mktemp("machine")).root
    names = name_rules({"projector": "1-3.2", "camera": "CAM0001"})
    return namespaced(root, {RULES.name: RULES.read_text(), "61-fringed-names.rules": names})


def links(answer: str) -> set[str]:
    found = re.search(r"^DEVLINKS=(.*)$", answer, re.M)
    return {name for name in (found[1].split() if found else ()) if name.startswith("/dev/fringed/")}


def test_rules_are_read_without_a_complaint(answers):
    for answer in answers.values():
        assert not re.search(r"fringed(-names)?\.rules:\d+ (Invalid|Unknown|Failed|conflicting)", answer), answer
        assert "Invalid" not in answer


def test_adapter_has_links_by_serial_number_and_by_port(answers):
    assert links(answers["ftdi"]) == {"/dev/fringed/serial-FTA1-00", "/dev/fringed/port-1-1-00"}


def test_alike_adapters_without_serial_numbers_are_told_apart_by_their_ports(answers):
    assert links(answers["alike 1"]) == {"/dev/fringed/port-1-3.1-00"}
    assert links(answers["alike 2"]) == {"/dev/fringed/port-1-3.2-00", "/dev/fringed/projector"}


def test_ports_of_one_double_adapter_are_told_apart(answers):
    assert links(answers["double 0"]) == {"/dev/fringed/serial-FTD4-00", "/dev/fringed/port-1-4-00"}
    assert links(answers["double 1"]) == {"/dev/fringed/serial-FTD4-01", "/dev/fringed/port-1-4-01"}


def test_ports_that_are_none_of_ours_are_left_alone(answers):
    for name in ("acm", "board", "webcam", "webcam metadata", "webcam usb"):
        assert links(answers[name]) == set(), name
        assert "ID_MM_PORT_IGNORE" not in answers[name]
        assert "FRINGED_U3V" not in answers[name]


def test_named_port_starts_the_service_and_is_for_who_sits_there(answers):
    named = answers["alike 2"]
    assert "SYSTEMD_WANTS=fringed.service" in named
    assert re.search(r"^CURRENT_TAGS=.*:uaccess:", named, re.M)
    assert "ID_MM_PORT_IGNORE=1" in named
    assert "SYSTEMD_WANTS" not in answers["alike 1"]


def test_u3v_camera_has_its_links_group_and_stays_awake(answers):
    answer = answers["u3v"]
    assert links(answer) == {"/dev/fringed/u3v-CAM0001", "/dev/fringed/camera-usb"}
    assert re.search(r"^CURRENT_TAGS=.*:uaccess:", answer, re.M)
    assert re.search(r"60-fringed\.rules:\d+ GROUP \d+", answer)
    assert re.search(r"60-fringed\.rules:\d+ MODE 0660", answer)
    assert re.search(r"ATTR '.*/2-1/power/control' writing 'on'", answer)
    assert "SYSTEMD_WANTS=fringed.service" in answer


def test_latency_timer_of_ftdi_chips_is_set(answers):
    assert re.search(r"ATTR '.*/latency_timer' writing '1'", answers["ftdi chip"])


@pytest.mark.parametrize("identity", ["FTD4-if01", "1-4-if01", "pci-0000:00:14.0-usb-0:4-if01"])
def test_names_by_serial_number_port_or_path_choose_one_interface(tmp_path, identity):
    root = lab(tmp_path).root
    rules = name_rules({"projector": identity, "camera": "pci-0000:00:14.0-usb-0:6"})
    found = namespaced(root, {RULES.name: RULES.read_text(), "61-fringed-names.rules": rules})
    assert [name for name, answer in found.items() if "/dev/fringed/projector" in links(answer)] == ["double 1"]
    assert [name for name, answer in found.items() if "/dev/fringed/camera-video" in links(answer)] == ["webcam"]


@pytest.mark.parametrize("identity", ["", "a b", "FT*", 'x", RUN+="/bin/sh', "A|B", "ttyUSB0\n", "é"])
def test_ids_that_no_rule_can_match_are_refused(identity):
    with pytest.raises(UsageError, match="serial number"):
        name_rules({"camera": identity})


def test_one_id_for_two_roles_is_refused():
    with pytest.raises(UsageError, match="each needs its own"):
        name_rules({"projector": "FTA1", "camera": "FTA1"})


def test_newer_udev_verifies_the_rules(tmp_path):
    udevadm = shutil.which("udevadm")
    if udevadm is None or subprocess.run([udevadm, "verify", "--help"], capture_output=True, check=False).returncode:
        pytest.skip("this udevadm has no `verify`: it came with systemd 254")
    names = tmp_path / "61-fringed-names.rules"
    names.write_text(name_rules({"projector": "FTA1-if01", "camera": "1-2"}))
    command = [udevadm, "verify", "--resolve-names=never", str(RULES), str(names)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def rules_of(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.strip() and not line.startswith("#")]


USB_DEVICE = {"idVendor", "idProduct", "serial", "busnum"}
USB_INTERFACE = {"bInterfaceNumber", "bInterfaceClass"}


@pytest.mark.parametrize(
    "text", [RULES.read_text(), name_rules({"projector": "FTA1-if01", "camera": "1-2"}), name_rules({"camera": "CAM"})]
)
def test_every_rule_asks_one_parent_only_and_is_well_formed(text):
    key = r'[A-Z]+(?:\{[^}"]+\})?(?:==|!=|\+=|=)"[^"]*"'
    for rule in rules_of(text):
        assert re.fullmatch(rf"{key}(, {key})*", rule), rule
        above = set(re.findall(r"ATTRS\{(\w+)\}", rule))
        assert above <= USB_DEVICE or above <= USB_INTERFACE, f"no parent has all of {above}: {rule}"
        if "uaccess" in rule:
            assert int(RULES.name[:2]) < 73


def test_labels_are_there():
    text = RULES.read_text()
    assert set(re.findall(r'GOTO="(\w+)"', text)) == set(re.findall(r'LABEL="(\w+)"', text))
