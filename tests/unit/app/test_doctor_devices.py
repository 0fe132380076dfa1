"""`fringed doctor` on devices, displays and the service: what it says of machines that are made for it."""

from __future__ import annotations

import os

import pytest
from fake_machine import FTDI, FakeMachine, edid, lab

from fringed.cli.doctor_devices import device_findings
from fringed.cli.doctor_displays import display_findings, video_drivers
from fringed.cli.doctor_service import service_findings
from fringed.finding import Machine, User
from fringed.finding.naming import name_rules

KMS = ("x11", "wayland", "kmsdrm", "dummy")
PANEL_PX = (1024, 768)


def stranger(root, environment=None) -> Machine:
    """A user who owns nothing and is in no group of a device."""
    return Machine(root, User("ann", os.geteuid() + 4242, frozenset({"ann"})), environment or {})


def owner(root, environment=None) -> Machine:
    return Machine(root, User("root", 0, frozenset({"root"})), environment or {})


def by_what(findings) -> dict:
    found = {finding.what: finding for finding in findings}
    assert all(finding.do for finding in found.values() if finding.level != "ok"), found
    return found


def displays(machine, drivers=KMS, pygame="", panel_px=PANEL_PX):
    return by_what(display_findings(machine, panel_px, lambda: drivers, pygame))


def test_port_that_the_user_may_not_open_says_who_may(tmp_path):
    lab(tmp_path)
    found = by_what(device_findings(stranger(tmp_path)))["serial port /dev/ttyUSB0"]
    assert found.level == "warn"
    assert "0660" in found.found and "not usable by ann" in found.found and "FT232R" in found.found


def test_group_is_named_with_the_command_that_adds_it(tmp_path, monkeypatch):
    lab(tmp_path)
    monkeypatch.setattr("fringed.finding.permissions._group_name", lambda gid: "dialout")
    found = by_what(device_findings(stranger(tmp_path)))
    assert found["serial port /dev/ttyUSB0"].do == "sudo usermod -aG dialout ann, then log in again"
    assert found["groups"].level == "warn"
    assert found["groups"].do == "sudo usermod -aG dialout ann, then log out and in again"


def test_group_that_waits_for_the_next_login_is_not_asked_for_again(tmp_path, monkeypatch):
    lab(tmp_path)
    monkeypatch.setattr("fringed.finding.permissions._group_name", lambda gid: "dialout")
    monkeypatch.setattr(User, "to_be", lambda self: frozenset({"dialout"}))
    found = by_what(device_findings(stranger(tmp_path)))
    assert found["serial port /dev/ttyUSB0"].do.startswith("log out and in again")
    assert found["groups"].do == "log out and in again"


def test_slow_ftdi_chips_are_named_with_their_file(tmp_path):
    lab(tmp_path)
    found = by_what(device_findings(owner(tmp_path)))
    assert found["latency timer of /dev/ttyUSB0"].level == "warn"
    assert "16 ms" in found["latency timer of /dev/ttyUSB0"].found
    assert "ttyUSB0/latency_timer" in found["latency timer of /dev/ttyUSB0"].do
    assert "latency timer of /dev/ttyUSB1" not in found  # at 1 ms already
    assert "latency timer of /dev/ttyUSB2" not in found  # no FTDI chip


def test_taken_port_names_the_program(tmp_path):
    machine = lab(tmp_path)
    machine.write("proc/812/comm", "minicom\n")
    (tmp_path / "proc/812/fd").mkdir()
    (tmp_path / "proc/812/fd/5").symlink_to("/dev/ttyUSB0")
    found = by_what(device_findings(owner(tmp_path)))["serial port /dev/ttyUSB0"]
    assert "minicom (process 812)" in found.found and "stop it" in found.do


def test_node_that_udev_did_not_make_is_said(tmp_path):
    lab(tmp_path)
    (tmp_path / "dev/ttyUSB0").unlink()
    found = by_what(device_findings(owner(tmp_path)))["serial port /dev/ttyUSB0"]
    assert found.level == "warn" and "/dev/ttyUSB0 is not there" in found.found


def test_adapters_without_serial_numbers_are_to_stay_in_their_sockets(tmp_path):
    lab(tmp_path)
    found = by_what(device_findings(owner(tmp_path)))
    assert "keep it in this socket" in found["name of /dev/ttyUSB2"].do


@pytest.mark.parametrize(("limit", "level"), [("16", "warn"), ("256", "ok"), ("1000", "ok"), ("0", "ok")])
def test_memory_for_usb_cameras(tmp_path, limit, level):
    lab(tmp_path).write("sys/module/usbcore/parameters/usbfs_memory_mb", limit)
    assert by_what(device_findings(owner(tmp_path)))["USB memory"].level == level


def test_memory_matters_only_where_a_u3v_camera_is(tmp_path):
    FakeMachine(tmp_path).write("sys/module/usbcore/parameters/usbfs_memory_mb", "16")
    assert by_what(device_findings(owner(tmp_path)))["USB memory"].level == "ok"


def test_u3v_camera_in_a_slow_socket(tmp_path):
    FakeMachine(tmp_path).camera_u3v("1-2", "C1", speed="480")
    found = by_what(device_findings(owner(tmp_path)))
    assert "480 Mbit/s" in found["speed of camera C1"].found and "USB 3" in found["speed of camera C1"].do


def test_programs_that_take_adapters_are_named(tmp_path):
    machine = FakeMachine(tmp_path)
    machine.tty_usb(machine.usb("1-1", FTDI, "F"), "ttyUSB0", 0, 1)
    machine.write("usr/lib/udev/rules.d/85-brltty.rules", "")
    machine.write("proc/77/comm", "ModemManager\n")
    found = by_what(device_findings(owner(tmp_path)))
    assert found["brltty"].level == found["ModemManager"].level == "warn"
    machine.write("etc/udev/rules.d/60-fringed.rules", "")
    assert "ModemManager" not in by_what(device_findings(owner(tmp_path)))


def test_machine_without_devices_is_good(tmp_path):
    found = by_what([*device_findings(owner(tmp_path)), *service_findings(owner(tmp_path))]) | displays(owner(tmp_path))
    assert {finding.level for finding in found.values()} == {"ok"}


def test_display_with_the_panel_s_mode_is_good_another_is_not(tmp_path):
    machine = FakeMachine(tmp_path)
    machine.connector("HDMI-A-1", ("1024x768", "800x600"), edid())
    machine.connector("DP-1", ("1920x1080",))
    found = displays(owner(tmp_path))
    assert found["display card0-HDMI-A-1"].level == "ok" and "CP-X260" in found["display card0-HDMI-A-1"].found
    assert found["display card0-DP-1"].level == "warn" and "no 1024x768" in found["display card0-DP-1"].found
    assert displays(owner(tmp_path), panel_px=(1920, 1080))["display card0-DP-1"].level == "ok"


def test_nothing_connected_is_said(tmp_path):
    FakeMachine(tmp_path).connector("HDMI-A-1")
    found = displays(owner(tmp_path))["displays"]
    assert found.level == "warn" and "card0-HDMI-A-1" in found.found


def test_card_that_is_not_usable_or_taken(tmp_path):
    machine = FakeMachine(tmp_path)
    machine.connector("HDMI-A-1", ("1024x768",))
    assert displays(owner(tmp_path))["KMS /dev/dri/card0"].level == "ok"
    assert displays(stranger(tmp_path))["KMS /dev/dri/card0"].level == "warn"
    machine.write("proc/900/comm", "Xorg\n")
    (tmp_path / "proc/900/fd").mkdir()
    (tmp_path / "proc/900/fd/9").symlink_to("/dev/dri/card0")
    taken = displays(owner(tmp_path))["KMS /dev/dri/card0"]
    assert taken.level == "warn" and "Xorg (process 900)" in taken.found
    machine.write("tmp/.X11-unix/X0", "")
    assert displays(owner(tmp_path, {"DISPLAY": ":0"}))["KMS /dev/dri/card0"].level == "ok"


def test_display_variable_without_a_server(tmp_path):
    assert displays(owner(tmp_path, {"DISPLAY": ":7"}))["DISPLAY"].level == "warn"
    FakeMachine(tmp_path).write("tmp/.X11-unix/X7", "")
    assert displays(owner(tmp_path, {"DISPLAY": ":7.0"}))["DISPLAY"].level == "ok"
    assert displays(owner(tmp_path, {"DISPLAY": "far:10"}))["DISPLAY"].level == "ok"
    assert "KMS" in displays(owner(tmp_path))["DISPLAY"].found


def test_pygame_without_kmsdrm_or_beside_pygame_ce(tmp_path):
    without = displays(owner(tmp_path), drivers=("x11", "dummy"))["pygame's drivers"]
    assert without.level == "warn" and "pygame-ce" in without.do
    assert displays(owner(tmp_path), drivers=())["pygame's drivers"].level == "warn"
    assert displays(owner(tmp_path), pygame="2.6.1")["pygame"].level == "warn"


def test_sdl_is_asked_for_its_drivers_without_starting_video():
    pytest.importorskip("pygame")
    assert "dummy" in video_drivers()


def test_rules_that_are_missing_matter_where_something_is_plugged_in(tmp_path):
    machine = lab(tmp_path)
    assert by_what(service_findings(owner(tmp_path)))["udev rules"].level == "warn"
    machine.write("etc/udev/rules.d/60-fringed.rules", "")
    found = by_what(service_findings(owner(tmp_path)))
    assert found["udev rules"].level == "ok" and "no device is named" in found["udev rules"].found


def test_names_that_are_expected_and_absent(tmp_path):
    machine = lab(tmp_path)
    machine.write("etc/udev/rules.d/60-fringed.rules", "")
    machine.write("etc/udev/rules.d/61-fringed-names.rules", name_rules({"projector": "FTA1", "camera": "C"}))
    machine.link("dev/fringed/projector", "dev/ttyUSB0")
    machine.link("dev/fringed/serial-X-00", "dev/ttyUSB9")
    found = by_what(service_findings(owner(tmp_path)))
    assert "/dev/fringed/projector -> /dev/ttyUSB0" in found["udev links"].found
    assert found["the camera's name"].level == "warn" and "the projector's name" not in found
    assert "leads nowhere" in found["link /dev/fringed/serial-X-00"].found
    machine.write("etc/udev/rules.d/61-fringed-names.rules", name_rules({"projector": "FTA1"}))
    assert "the camera's name" not in by_what(service_findings(owner(tmp_path)))


def test_service_that_is_installed_badly(tmp_path):
    machine = FakeMachine(tmp_path)
    machine.write("etc/systemd/system/fringed.service", "[Service]\nExecStart=/opt/fringed/bin/fringed run\n")
    found = by_what(service_findings(owner(tmp_path)))
    assert found["service"].level == "warn" and "does not start at boot" in found["service"].found
    assert found["service's program"].level == "fail" and found["service's user"].level == "fail"


def test_service_that_is_installed_well(tmp_path):
    machine = FakeMachine(tmp_path)
    machine.write("etc/systemd/system/fringed.service", "[Service]\nExecStart=/opt/fringed/bin/fringed run\n")
    machine.link("etc/systemd/system/multi-user.target.wants/fringed.service", "etc/systemd/system/fringed.service")
    machine.write("opt/fringed/bin/fringed", "")
    machine.write("etc/passwd", "fringed:x:997:997::/var/lib/fringed:/usr/sbin/nologin\n")
    groups = ("dialout", "video", "render", "input", "tty")
    machine.write("etc/group", "".join(f"{name}:x:1:fringed\n" for name in groups))
    found = by_what(service_findings(owner(tmp_path)))
    assert {finding.level for finding in found.values()} == {"ok"}
    machine.write("etc/group", "dialout:x:1:\n")
    assert "render" in by_what(service_findings(owner(tmp_path)))["service's groups"].found
