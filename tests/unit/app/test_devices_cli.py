"""`fringed devices`, and what is found in /sys: of a lab's machine that is made as a folder, and of this one."""

from __future__ import annotations

import json
import os

import pytest
from fake_machine import FTDI, PROLIFIC, FakeMachine, edid, lab

from fringed.cli.devices import look
from fringed.cli.main import main
from fringed.finding import Machine, User, access, cameras, connectors, holders, installed, serial_ports, usb_devices
from fringed.finding.displays import parse_edid
from fringed.finding.machine import this_machine

NOBODY = User("ann", 4242, frozenset({"ann"}))


def run(capsys, *arguments):
    code = 0
    try:
        main(list(arguments))
    except SystemExit as ended:
        code = ended.code
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return lab(tmp_path_factory.mktemp("lab")).root


def test_adapters_are_known_by_serial_number_else_by_their_socket(root):
    found = {port.node: port.id for port in serial_ports(root)}
    assert found == {
        "/dev/ttyACM0": "ACM01", "/dev/ttyS0": "/dev/ttyS0", "/dev/ttyUSB0": "FTA1", "/dev/ttyUSB1": "FTB2",
        "/dev/ttyUSB2": "1-3.1", "/dev/ttyUSB3": "1-3.2", "/dev/ttyUSB4": "FTD4-if00", "/dev/ttyUSB5": "FTD4-if01",
    }  # fmt: skip


def test_settings_are_what_drivers_of_serial_devices_take(root):
    settings = {port.node: port.setting for port in serial_ports(root)}
    assert settings["/dev/ttyUSB0"] == "usb:serial=FTA1"
    assert settings["/dev/ttyUSB3"] == "usb:location=1-3.2"
    assert settings["/dev/ttyUSB5"] == "usb:location=1-4:1.1"
    assert settings["/dev/ttyS0"] == "/dev/ttyS0"


def test_copies_with_the_same_serial_number_are_told_by_their_sockets(tmp_path):
    machine = FakeMachine(tmp_path)
    machine.tty_usb(machine.usb("1-1", FTDI, "A50285BI"), "ttyUSB0", 0, 16)
    machine.tty_usb(machine.usb("1-2", FTDI, "A50285BI"), "ttyUSB1", 0, 16)
    ports = serial_ports(tmp_path)
    assert [port.id for port in ports] == ["1-1", "1-2"]
    assert all("2 devices have the serial number A50285BI" in port.by_port for port in ports)


def test_serial_number_that_no_rule_can_match_is_not_an_id(tmp_path):
    machine = FakeMachine(tmp_path)
    machine.tty_usb(machine.usb("1-7", FTDI, 'A"*'), "ttyUSB0", 0, 16)
    assert serial_ports(tmp_path)[0].id == "1-7"


def test_ids_stay_when_devices_are_plugged_in_another_order(tmp_path):
    one, two = FakeMachine(tmp_path / "one"), FakeMachine(tmp_path / "two")
    for machine, names in ((one, ("ttyUSB0", "ttyUSB1")), (two, ("ttyUSB1", "ttyUSB0"))):
        machine.tty_usb(machine.usb("1-3.1", PROLIFIC), names[0])
        machine.tty_usb(machine.usb("1-3.2", PROLIFIC), names[1])
    before = {port.id for port in serial_ports(tmp_path / "one")}
    assert before == {port.id for port in serial_ports(tmp_path / "two")} == {"1-3.1", "1-3.2"}


def test_latency_interface_driver_and_path_are_read(root):
    port = {port.node: port for port in serial_ports(root)}["/dev/ttyUSB5"]
    assert (port.latency_ms, port.interface, port.driver) == (16, "01", "ftdi_sio")
    assert port.usb is not None and port.usb.path == "pci-0000:00:14.0-usb-0:4"
    assert port.latency_file == "/sys/devices/pci0000:00/0000:00:14.0/usb1/1-4/1-4:1.1/ttyUSB5/latency_timer"


def test_hubs_and_ports_without_a_chip_are_no_devices(root, tmp_path):
    assert not [device for device in usb_devices(root) if device.ids == "05e3:0608"]
    machine = FakeMachine(tmp_path)
    machine.tty_board("ttyS3", 0)
    assert serial_ports(tmp_path) == []


def test_ports_that_only_pyserial_knows_are_listed_too(root):
    found = serial_ports(root, [("/dev/ttyUSB0", "again"), ("/dev/cu.usbserial", "an adapter")])
    assert [port.node for port in found].count("/dev/ttyUSB0") == 1
    assert found[-1].node == "/dev/cu.usbserial"


def test_stable_names_are_found_ours_first(tmp_path):
    machine = lab(tmp_path)
    machine.link("dev/serial/by-id/usb-FTDI_FTA1-if00-port0", "dev/ttyUSB0")
    assert {port.node: port.stable for port in serial_ports(tmp_path)}["/dev/ttyUSB0"].startswith("/dev/serial/by-id/")
    machine.link("dev/fringed/projector", "dev/ttyUSB0")
    port = {port.node: port for port in serial_ports(tmp_path)}["/dev/ttyUSB0"]
    assert port.links == ("/dev/fringed/projector", "/dev/serial/by-id/usb-FTDI_FTA1-if00-port0")


def test_displays_say_what_they_are(root):
    found = {item.name: item for item in connectors(root)}
    beamer = found["HDMI-A-1"]
    assert (beamer.connected, beamer.id, beamer.display, beamer.driver) == (True, "HIT1234-77", "HIT CP-X260", "i915")
    assert beamer.modes == ("1024x768", "800x600")
    assert not found["DP-1"].connected


def test_alike_displays_are_told_by_their_connectors(tmp_path):
    machine = FakeMachine(tmp_path)
    machine.connector("HDMI-A-1", ("1024x768",), edid())
    machine.connector("HDMI-A-2", ("1024x768",), edid())
    machine.connector("HDMI-A-3", ("1024x768",), edid(serial=0))
    assert [item.id for item in connectors(tmp_path)] == ["HDMI-A-1", "HDMI-A-2", "HDMI-A-3"]


@pytest.mark.parametrize("block", [b"", b"\x00" * 128, edid()[:-1] + b"\x00", edid()[:100], b"\xff" * 300])
def test_broken_edids_say_nothing(block):
    assert parse_edid(block) is None


def test_cameras_are_told_by_class_and_webcams_show_one_node(root):
    found = {(camera.kind, camera.node, camera.id) for camera in cameras(root)}
    assert found == {("usb3-vision", "/dev/bus/usb/002/002", "CAM0001"), ("v4l2", "/dev/video0", "WEB6")}


def test_access_is_that_of_the_user_asked_for(root):
    node = root / "dev/ttyUSB0"
    node.chmod(0o660)
    found = access(root, "/dev/ttyUSB0", NOBODY)
    assert found is not None and not found.usable and found.mode == "0660"
    member = User("ann", 4242, frozenset({found.group}))
    assert access(root, "/dev/ttyUSB0", member).usable
    node.chmod(0o640)
    assert not access(root, "/dev/ttyUSB0", member).usable
    assert access(root, "/dev/ttyUSB77", NOBODY) is None
    node.chmod(0o660)


def test_who_has_a_port_open_is_named(tmp_path):
    machine = lab(tmp_path)
    machine.write("proc/812/comm", "minicom\n")
    (tmp_path / "proc/812/fd").mkdir()
    (tmp_path / "proc/812/fd/5").symlink_to("/dev/ttyUSB0")
    assert [str(holder) for holder in holders(tmp_path, "/dev/ttyUSB0")] == ["minicom (process 812)"]
    assert holders(tmp_path, "/dev/ttyUSB1") == ()


def test_links_that_lead_nowhere_are_told_from_those_that_do(tmp_path):
    machine = lab(tmp_path)
    machine.link("dev/fringed/projector", "dev/ttyUSB0")
    machine.link("dev/fringed/camera", "dev/ttyUSB9")
    found = installed(tmp_path)
    assert found.links == {"/dev/fringed/projector": "/dev/ttyUSB0"}
    assert found.dangling == ("/dev/fringed/camera",)


def test_files_that_vanish_while_they_are_read_are_no_errors(tmp_path):
    machine = lab(tmp_path)
    (tmp_path / "sys/class/tty/ttyUSB9").symlink_to("../../devices/gone")
    (tmp_path / "sys/bus/usb/devices/1-9").symlink_to("../../../devices/gone")
    (tmp_path / "sys/class/drm/card0-DP-9").symlink_to("../../devices/gone")
    machine.link("dev/fringed/loop", "dev/fringed/loop")
    found = look(Machine(tmp_path, NOBODY))
    assert "/dev/ttyUSB9" not in {port["node"] for port in found["serial_ports"]}


def test_command_lists_all_as_text_and_as_json(capsys, root):
    code, out, _ = run(capsys, "devices", "--root", str(root))
    assert code == 0
    for text in ("FTD4-if01", "told by its port, because it has no serial number", "HIT CP-X260", "CAM0001",
                 "usb:location=1-3.2"):  # fmt: skip
        assert text in out
    code, out, _ = run(capsys, "devices", "--json", "--root", str(root))
    found = json.loads(out)
    assert code == 0 and set(found) == {"serial_ports", "displays", "cameras", "links"}
    ids = [item["id"] for kind in ("serial_ports", "displays", "cameras") for item in found[kind]]
    assert len(ids) == len(set(ids))
    assert found["serial_ports"][2]["usb"]["serial"] == "FTA1"


def test_command_works_here_and_where_nothing_is(capsys, tmp_path):
    assert run(capsys, "devices", "--json")[0] == 0
    code, out, _ = run(capsys, "devices", "--root", str(tmp_path))
    assert code == 0 and out.count("none") == 3


def test_missing_root_is_a_usage_error(capsys, tmp_path):
    code, _, err = run(capsys, "devices", "--root", str(tmp_path / "nowhere"))
    assert code == 2 and "no such folder" in err


def test_this_machine_is_seen_by_who_runs_the_process():
    machine = this_machine()
    assert machine.user.uid == os.geteuid() and machine.user.groups
