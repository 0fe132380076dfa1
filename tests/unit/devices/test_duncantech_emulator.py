"""The MS3100's emulator as a process: the control over its pseudo-terminal, its faults, its pace, its JSON lines."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from duncantech_lines import EmulatorProcess, PtyPort

from fringed.devices.camera.duncantech_control import COLOURS, ControlSettings, DuncanTechControl
from fringed.emulators.ms3100_camera import EmulatedMs3100
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError
from fringed.protocols.duncantech import LINES, Dialect, GetOffset, SetGain, encode
from fringed.protocols.duncantech_frames import Frame, checksum, decode_frame
from fringed.transports.serial_port import SerialPort, SerialSettings

UNVERIFIED = Dialect(unverified=True)


@pytest.fixture
def emulator(tmp_path: Path) -> Iterator[EmulatorProcess]:
    process = EmulatorProcess(tmp_path / "ms3100")
    try:
        process.next("ready")
        yield process
    finally:
        process.close()


@pytest.fixture
def link(tmp_path: Path) -> Path:
    return tmp_path / "ms3100"


def control_of(link: Path, baud: int = 9600, reply_timeout_s: float = 2.0, retries: int = 2) -> DuncanTechControl:
    return DuncanTechControl(
        PtyPort(link, baud), ControlSettings(UNVERIFIED, reply_timeout_s=reply_timeout_s, retries=retries)
    )


def test_settings_go_over_the_terminal_and_are_published(emulator: EmulatorProcess, link: Path) -> None:
    control = control_of(link)
    assert str(link) in control.open()
    assert control.set_integration_s("blue", 0.01) == pytest.approx(0.01)
    assert control.set_gain("red", 300) == 300
    control.close()
    state = emulator.state()
    assert state["ccds"]["blue"] == {"gain": 256, "offset": 10, "lines": 80, "integration_us": 10000.0}
    assert state["ccds"]["red"]["gain"] == 300
    changes = [e["ccds"] for e in emulator.events if e["event"] == "settings"]
    assert [c["blue"]["lines"] for c in changes] == [64, 80, 80]


def test_serial_port_of_the_house_finds_it_free_takes_it_and_comes_back(emulator: EmulatorProcess, link: Path) -> None:
    port = SerialPort(str(link), SerialSettings(9600))
    control = DuncanTechControl(port, ControlSettings(UNVERIFIED, reply_timeout_s=2.0))
    try:
        for lines in (700, 701):
            control.open()
            assert control.set_integration_lines("red", lines) == lines
            emulator.order(do="unplug")
            emulator.next("unplugged")
            with pytest.raises(DeviceAbsent):
                control.check()
            emulator.order(do="plug")
            emulator.next("plugged")
    finally:
        control.close()
    assert emulator.state()["ccds"]["red"]["lines"] == 701


def test_answers_take_as_long_as_their_bytes_at_9600_baud(emulator: EmulatorProcess, link: Path) -> None:
    control = control_of(link)
    control.open()
    began = time.monotonic()
    for _ in range(10):
        control.offset("green")
    took_s = time.monotonic() - began
    control.close()
    assert took_s >= 10 * (6 + 8) * 10 / 9600 * 0.95  # six bytes there and eight back, ten bits each


def test_port_of_another_rate_is_named(emulator: EmulatorProcess, link: Path) -> None:
    control = control_of(link, baud=19200, reply_timeout_s=0.2, retries=0)
    with pytest.raises(DeviceError, match="baud rate"):
        control.open()


@pytest.mark.parametrize("fault", ["drop", "garble", "junk", "late", "lose", "refuse"])
def test_ordered_fault_is_overcome(emulator: EmulatorProcess, link: Path, fault: str) -> None:
    control = control_of(link, reply_timeout_s=0.2)
    control.open()
    emulator.order(fault=fault)
    emulator.state()
    assert control.set_gain("green", 400) == 400
    control.close()
    assert emulator.state()["ccds"]["green"]["gain"] == 400


def test_cable_pulled_in_the_middle_of_an_answer(emulator: EmulatorProcess, link: Path) -> None:
    control = control_of(link)
    control.open()
    emulator.order(fault="unplug")
    emulator.state()
    with pytest.raises(DeviceAbsent, match="cannot be opened"):
        control.set_gain("green", 400)
    emulator.next("unplugged")
    assert not link.exists()
    emulator.order(do="plug")
    emulator.next("plugged")
    control.open()
    assert control.set_gain("green", 401) == 401
    control.close()


def test_unplugged_while_nothing_is_sent_is_noticed_by_a_check(emulator: EmulatorProcess, link: Path) -> None:
    control = control_of(link)
    control.open()
    control.check()
    emulator.order(do="unplug")
    emulator.next("unplugged")
    with pytest.raises(DeviceAbsent):
        control.check()
    control.close()


def test_plugged_again_between_two_commands_needs_no_hands(emulator: EmulatorProcess, link: Path) -> None:
    control = control_of(link)
    control.open()
    for order, event in (("unplug", "unplugged"), ("plug", "plugged")):
        emulator.order(do=order)
        emulator.next(event)
    assert control.set_gain("green", 402) == 402
    assert control.reopened == 1
    control.close()


def test_random_faults_over_the_terminal_end_right_or_named(tmp_path: Path) -> None:
    source, link = random.Random(3100), tmp_path / "ms3100"
    emulator, named = EmulatorProcess(link, "--no-pace", "--seed", "7"), 0
    control = control_of(link, reply_timeout_s=0.05)
    try:
        emulator.next("ready")
        control.open()
        for _ in range(40):
            if source.random() < 0.5:
                emulator.order(fault=source.choice(["drop", "garble", "junk", "lose", "refuse", "unplug", "late"]))
            colour, lines = source.choice(COLOURS), source.randint(*LINES)
            try:
                assert control.set_integration_lines(colour, lines) == lines
            except DeviceError as error:
                named += 1
                emulator.order(do="plug")
                emulator.next("plugged")
                control.close()
                _opened(control, error)
            else:
                assert emulator.state()["ccds"][colour]["lines"] == lines
    finally:
        control.close()
        emulator.close()
    assert named < 30
    assert not link.exists()


def _opened(control: DuncanTechControl, error: DeviceError) -> None:
    """Open again; an ordered fault may still strike that, too."""
    assert type(error) in (DeviceAbsent, DeviceStalled, ProtocolError)
    for _ in range(5):
        try:
            control.open()
        except DeviceError:
            continue
        return
    raise error


def test_wrong_orders_are_answered_and_harm_nothing(emulator: EmulatorProcess) -> None:
    assert emulator.process.stdin is not None
    for line in ("not json", '{"fault": "fire"}', '{"do": "dance"}', "[1]", '{"fault": "drop", "count": -1}'):
        emulator.process.stdin.write(line + "\n")
        emulator.process.stdin.flush()
        assert emulator.next("error")["message"]
    assert emulator.state()["counts"]["commands"] == 0


def test_quit_and_terminate_take_the_link_away(tmp_path: Path) -> None:
    for number, end in enumerate((lambda e: e.order(do="quit"), lambda e: e.process.terminate())):
        emulator = EmulatorProcess(tmp_path / f"port{number}")
        emulator.next("ready")
        end(emulator)
        assert emulator.process.wait(10) == 0
        emulator.close()
        assert list(tmp_path.iterdir()) == []


def test_taken_path_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    emulator = EmulatorProcess(tmp_path / "file")
    assert emulator.process.wait(10) != 0
    emulator.close()
    assert (tmp_path / "file").read_text() == "mine"


def test_published_bytes_get_the_published_answer() -> None:
    camera = EmulatedMs3100(UNVERIFIED)
    camera.ccds[3].offset = 77
    (answer,) = camera.feed(bytes.fromhex("02 02 00 05 03 F8"))
    body = bytes((0x05, 3, 77, 0))
    assert answer.data == bytes((0x02, 0x04, 0x00)) + body + bytes((checksum(body),))


def test_wrong_checksums_and_unknown_opcodes_are_counted_and_not_obeyed() -> None:
    camera = EmulatedMs3100(UNVERIFIED)
    spoiled = encode(SetGain(1, 400), UNVERIFIED)[:-1] + b"\x00"
    assert camera.feed(spoiled + encode(GetOffset(1), UNVERIFIED)) != []
    assert camera.feed(Frame(0x77, b"\x01").encode()) == []
    assert camera.ccds[1].gain == 256
    assert (camera.counts.bad_checksums, camera.counts.not_understood) == (1, 1)


def test_every_fault_looks_as_its_name_says() -> None:
    camera, asked = EmulatedMs3100(UNVERIFIED), encode(SetGain(1, 400), UNVERIFIED)
    (right,) = camera.feed(asked)
    expected = {"drop": 0, "lose": 0, "garble": 1, "junk": 1, "late": 1, "refuse": 1, "unplug": 1}
    for fault, answers in expected.items():
        camera.order(fault)
        found = camera.feed(asked)
        assert len(found) == answers, fault
        assert all(answer != right for answer in found)
        assert camera.feed(asked) == [right]
    assert decode_frame(right.data) == Frame(0x02, b"\x01\x90\x01\x00")
    with pytest.raises(UsageError, match="faults are drop"):
        camera.order("fire")
