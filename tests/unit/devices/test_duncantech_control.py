"""The MS3100's control: units, limits, read-back, repeats, and an end to every wait, whatever goes wrong."""

from __future__ import annotations

import os
import random
import threading
from collections.abc import Callable

import pytest
from duncantech_lines import PATIENCE_S, MemoryLine, memory_control

from fringed.devices.camera.duncantech_control import COLOURS, ControlSettings, DuncanTechControl
from fringed.emulators.ms3100_camera import FAULTS, EmulatedMs3100
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError
from fringed.protocols.duncantech import LINES, OFFSETS, Dialect
from fringed.transports.loopback import Loopback

ROUNDS = int(os.environ.get("FRINGED_FAULT_ROUNDS", "80"))


def test_each_ccd_has_gain_offset_and_integration_of_its_own() -> None:
    control, line = memory_control()
    for number, colour in enumerate(COLOURS):
        assert control.set_gain(colour, 100 + number) == 100 + number
        assert control.set_offset(colour, 20 + number) == 20 + number
        assert control.set_integration_lines(colour, 500 + number) == 500 + number
    assert line.camera.settings() == {
        colour: {"gain": 100 + n, "offset": 20 + n, "lines": 500 + n} for n, colour in enumerate(COLOURS)
    }
    assert [control.gain(c) for c in COLOURS] == [100, 101, 102]
    assert [control.offset(c) for c in COLOURS] == [20, 21, 22]
    assert [control.integration_lines(c) for c in COLOURS] == [500, 501, 502]


def test_channel_of_each_ccd_is_a_setting() -> None:
    control, line = memory_control(channels={"red": 3, "green": 2, "blue": 1})
    control.set_gain("red", 7)
    assert line.camera.ccds[3].gain == 7


def test_seconds_and_lines_convert_both_ways() -> None:
    control, line = memory_control()
    assert control.set_integration_s("green", 8333.333e-6) == pytest.approx(67 * 125e-6)
    assert line.camera.ccds[1].lines == 67
    for lines in (LINES[0], 67, LINES[1]):
        assert control.lines_of(control.seconds_of(lines)) == lines


@pytest.mark.parametrize("seconds", [0.0, 60e-6, 0.1309, 1.0, -1.0, float("nan"), float("inf")])
def test_integration_times_beyond_the_limits_are_refused_with_the_limits(seconds: float) -> None:
    control, line = memory_control()
    before = bytes(line.sent)
    with pytest.raises(UsageError, match="125 to 130750 us"):
        control.set_integration_s("green", seconds)
    assert bytes(line.sent) == before


@pytest.mark.parametrize(
    ("action", "why"),
    [
        (lambda c: c.set_gain("green", 1024), "gain_max"),
        (lambda c: c.set_gain("green", -1), "0 to 1023"),
        (lambda c: c.set_offset("green", 128), "0 to 127"),
        (lambda c: c.set_integration_lines("green", 1047), "1 to 1046"),
        (lambda c: c.gain("infrared"), "red, green, blue"),
        (lambda c: c.set_trigger_mode("hardware"), "trigger mode 'hardware'.*not known.*trigger_mode"),
        (lambda c: c.set_output_mode("mono"), "output mode 'mono'.*not known.*maker's software"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_a_byte_is_sent(
    action: Callable[[DuncanTechControl], object], why: str
) -> None:
    control, line = memory_control()
    before = bytes(line.sent)
    with pytest.raises(UsageError, match=why):
        action(control)
    assert bytes(line.sent) == before


def test_without_unverified_commands_only_verified_opcodes_reach_the_line() -> None:
    control, line = memory_control(unverified=False)
    control.set_gain("red", 300)
    control.set_integration_lines("blue", 30)
    assert control.set_offset("green", 10) == 10  # so it is already: nothing has to be set
    for action in (lambda: control.gain("red"), lambda: control.integration_lines("red")):
        with pytest.raises(UsageError, match="enable_unverified"):
            action()
    with pytest.raises(UsageError, match="enable_unverified"):
        control.set_offset("green", 11)
    assert {line.sent[i + 3] for i in range(len(line.sent) - 3) if line.sent[i : i + 3] in (b"\2\4\0", b"\2\2\0")} == {
        0x02,
        0x05,
        0x14,
    }
    assert (line.camera.ccds[2].gain, line.camera.ccds[3].lines) == (300, 30)


def test_table_of_parameters_says_which_bytes_are_verified() -> None:
    control, _ = memory_control()
    table = {p.name: p for p in control.parameters()}
    assert table["integration"].verified == (False, True)
    assert table["offset"].verified == (True, False)
    assert (table["integration"].low, table["integration"].high) == LINES
    assert "125 us" in table["integration"].units


@pytest.mark.parametrize("fault", ["drop", "garble", "lose", "refuse", "late", "junk"])
def test_one_fault_is_repaired_by_sending_again(fault: str) -> None:
    control, line = memory_control()
    line.camera.order(fault, 1)
    assert control.set_gain("green", 400) == 400
    assert control.gain("green") == line.camera.ccds[1].gain == 400


def test_silence_ends_and_says_what_to_check() -> None:
    control, line = memory_control()
    line.camera.order("drop", 100)
    with pytest.raises(DeviceStalled, match=r"within 0.03 s: check that the camera has power.*sent 3 times"):
        control.set_gain("green", 400)


def test_status_of_failure_is_named_with_its_value() -> None:
    control, line = memory_control()
    line.camera.order("refuse", 100)
    with pytest.raises(ProtocolError, match=r"status 0x01.*status_ok"):
        control.set_gain("green", 400)


def test_noise_alone_points_to_the_baud_rate() -> None:
    control, line = memory_control()
    line.camera.order("garble", 100)
    with pytest.raises(ProtocolError, match="bytes that are none: check the baud rate"):
        control.offset("green")


def test_camera_that_keeps_another_value_is_an_error() -> None:
    control, line = memory_control()
    line.camera.changed = lambda camera: setattr(camera.ccds[1], "gain", 5)
    with pytest.raises(ProtocolError, match="reads 5"):
        control.set_gain("green", 400)


def test_camera_that_answers_no_set_is_configured_and_still_noticed_when_gone() -> None:
    control, line = memory_control(unverified=False, set_answer="none")
    assert control.set_gain("green", 400) == line.camera.ccds[1].gain == 400
    line.camera.order("drop", 100)
    with pytest.raises(DeviceStalled):
        control.set_gain("green", 401)


def test_late_answer_is_not_taken_for_the_next_ones() -> None:
    control, line = memory_control(unverified=False)
    line.camera.order("late", 1)
    assert control.set_gain("green", 400) == 400
    line.camera.order("lose", 100)
    with pytest.raises(DeviceStalled):
        control.set_gain("green", 400)


def test_replugged_port_is_opened_again_within_the_command() -> None:
    control, line = memory_control()
    line.unplug(comes_back=True)
    assert control.set_gain("green", 400) == 400
    assert (line.opens, control.reopened) == (2, 1)


def test_port_that_stays_away_is_absent_and_comes_back_by_open() -> None:
    control, line = memory_control()
    line.unplug(comes_back=False)
    with pytest.raises(DeviceAbsent, match="vanished"):
        control.check()
    with pytest.raises(DeviceAbsent, match="no such port"):
        control.set_gain("green", 400)
    with pytest.raises(DeviceAbsent, match="open it"):
        control.offset("green")
    line.plugged = True
    assert "MS3100 on memory" in control.open()
    assert control.set_gain("green", 400) == 400


def test_closed_control_is_not_opened_by_a_command() -> None:
    control, line = memory_control()
    control.close()
    control.close()
    with pytest.raises(DeviceAbsent, match="open it"):
        control.offset("red")
    assert line.opens == 1


def test_opening_where_nothing_answers_leaves_the_port_closed() -> None:
    line = MemoryLine(EmulatedMs3100())
    line.camera.order("drop", 100)
    with pytest.raises(DeviceStalled):
        DuncanTechControl(line, ControlSettings(reply_timeout_s=PATIENCE_S)).open()
    assert not line.opened


@pytest.mark.parametrize("unverified", [True, False])
def test_under_random_faults_every_command_ends_right_or_named(unverified: bool) -> None:
    source = random.Random(f"faults {unverified}")
    control, line = memory_control(unverified)
    named: list[DeviceError] = []
    for _ in range(ROUNDS):
        for fault in FAULTS:
            line.camera.order(fault, source.choice((1, 1, 1, 2, 5)) if source.random() < 0.12 else 0)
        colour, lines = source.choice(COLOURS), source.randint(*LINES)
        ccd = line.camera.ccds[control.settings.dialect.channels[colour]]
        named_before = len(named)
        try:
            if unverified and source.random() < 0.3:
                assert control.set_offset(colour, value := source.randint(*OFFSETS)) == ccd.offset == value
            elif source.random() < 0.5:
                assert control.set_integration_lines(colour, lines) == ccd.lines == lines
            else:
                assert control.offset(colour) == ccd.offset
        except DeviceError as error:
            named.append(error)
        if len(named) > named_before and isinstance(named[-1], DeviceAbsent):
            line.camera.faults = dict.fromkeys(FAULTS, 0)
            control.open()
    assert {type(error) for error in named} <= {DeviceAbsent, DeviceStalled, ProtocolError}
    assert all("memory" in error.message and len(error.message) > 40 for error in named)
    assert 0 < len(named) < ROUNDS / 2
    print(f"{ROUNDS} commands: {ROUNDS - len(named)} right, {len(named)} named, {control.retried} sent again")
    assert control.retried > 5 and control.reopened > 0


def test_over_a_loopback_with_the_camera_in_a_thread() -> None:
    near, far = Loopback.pair("cable")
    camera, done = EmulatedMs3100(Dialect(unverified=True)), threading.Event()

    def serve() -> None:
        far.open()
        while not done.is_set():
            for answer in camera.feed(far.read(0.02)):
                far.write(answer.data)

    thread = threading.Thread(target=serve, name="camera")
    thread.start()
    control = DuncanTechControl(near, ControlSettings(Dialect(unverified=True), reply_timeout_s=5.0))
    try:
        assert "cable" in control.open()
        assert control.set_integration_lines("blue", 900) == camera.ccds[3].lines == 900
    finally:
        control.close()
        done.set()
        thread.join(10)
