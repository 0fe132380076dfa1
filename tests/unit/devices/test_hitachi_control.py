"""The HITACHI control against the emulated projector in virtual time."""

from __future__ import annotations

import random
from contextlib import nullcontext, suppress

import pytest
from hitachi_lab import Lab

from fringed.devices.projector.hitachi_control import ControlSettings
from fringed.devices.projector.hitachi_line import LineTimes
from fringed.devices.projector.hitachi_power import Lamp
from fringed.emulators.cpx260_conversation import Manner
from fringed.emulators.cpx260_model import Faults
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError
from fringed.protocols import hitachi_commands as codes

WRAPPED = Manner(0, wrapped=True, idle_s=30.0)


@pytest.mark.parametrize("while_warming", ["refuse", "silent", "on"])
def test_the_lamp_goes_through_warm_up_and_cool_down(while_warming):
    lab = Lab(while_warming=while_warming)
    assert lab.control.open() is Lamp.STANDBY
    lab.control.power_on()
    assert lab.control.look() is Lamp.WARMING
    assert "the lamp warms up, ready in about" in lab.control.state_text()
    with pytest.raises(DeviceError, match=r"warms up, ready in about .* it can be switched off then"):
        lab.control.power_off()
    lab.control.wait_for(Lamp.ON, 60)
    assert 29 < lab.clock.now() < 40
    lab.control.power_off()
    assert lab.control.look() is Lamp.COOLING
    with pytest.raises(DeviceError, match=r"cools down, ready in about .* switched on again then"):
        lab.control.power_on()
    lab.control.wait_for(Lamp.STANDBY, 120)
    lab.control.power_on()
    lab.control.wait_for(Lamp.ON, 60)
    assert lab.projector.counts["switched on"] == 2
    assert lab.projector.counts.get("early", 0) == 0


def test_a_projector_that_was_warming_when_we_came_is_seen_as_that():
    fresh = Lab()
    fresh.projector._until = ("WARMING", 10.0)
    assert fresh.control.open() is Lamp.WARMING
    fresh.control.wait_for(Lamp.ON, 30)


def test_switching_on_twice_switches_once_and_off_twice_once():
    lab = Lab().lit()
    lab.control.power_on()
    lab.control.power_off()
    lab.control.power_off()
    assert lab.projector.counts["switched on"] == lab.projector.counts["switched off"] == 1


@pytest.mark.parametrize("seed", range(20))
def test_noise_at_power_on_and_lamp_strike_harms_nothing(seed):
    lab = Lab(dice=random.Random(seed), warm_up_s=5.0).lit()
    assert lab.control.error().code == 0


def test_a_lamp_that_never_strikes_is_named():
    lab = Lab(warm_up_s=1e9)
    lab.control.open()
    lab.control.power_on()
    with pytest.raises(DeviceStalled, match="warming does not end; usual are about 30 s"):
        lab.control.wait_for(Lamp.ON, 1000)
    lab = Lab(warm_up_s=1e9)
    lab.control.open()
    lab.control.power_on()
    with pytest.raises(DeviceStalled, match=r"warms up.*; ON was awaited for 20 s"):
        lab.control.wait_for(Lamp.ON, 20)


def test_an_error_that_keeps_the_lamp_off_is_named():
    lab = Lab()
    lab.control.open()
    lab.projector.registers[codes.ERRORS] = 3
    with pytest.raises(DeviceError, match=r"refuses 'power on': the lamp has failed. Mend that first"):
        lab.control.power_on()


def test_settings_are_set_and_read_back():
    control = Lab().lit().control
    control.select_input("rgb2")
    assert control.input() == "rgb2"
    for on in (True, False):
        control.blank(on)
        control.freeze(on)
        assert control.blanked() is control.frozen() is on
    assert (control.lamp_hours(), control.filter_hours()) == (812, 90)
    control.auto_adjust()


def test_errors_have_their_published_texts():
    lab = Lab().lit()
    for code, text in codes.ERROR_TEXTS.items():
        lab.projector.registers[codes.ERRORS] = code
        assert lab.control.error().text == text
        assert lab.control.error().stops == (code not in (0, 6, 8))
    lab.projector.registers[codes.ERRORS] = 77
    assert lab.control.error().text == "a code that nobody published (77)"


def test_a_setting_that_does_not_take_is_an_error():
    lab = Lab().lit()
    lab.projector.registers[codes.BLANK] = 1
    original = lab.projector._register
    lab.projector._register = lambda command: b"\x06" if command.action == 1 else original(command)
    with pytest.raises(DeviceError, match="acknowledged 'blank off' and stays at 1; expected 0"):
        lab.control.blank(False)


def test_what_cannot_be_done_in_standby_says_why():
    lab = Lab()
    lab.control.open()
    with pytest.raises(DeviceError, match=r"cannot execute 'blank get' now \(1c 00 00\); the lamp is off"):
        lab.control.blanked()


def test_a_picture_that_is_not_neutral_names_every_setting_and_can_be_reset():
    lab = Lab().lit()
    assert lab.control.picture.problems() == []
    lab.projector.registers |= {
        codes.KEYSTONE: 12, codes.MAGNIFY: 7, codes.GAMMA: 0x11, codes.PICTURE_MODE: 4, codes.FRAME_LOCK_1: 0,
        codes.BRIGHTNESS: 3,
    }  # fmt: skip
    with pytest.raises(DeviceError) as caught:
        lab.control.picture.require()
    for told in (
        "picture mode is 4; expected 0", "gamma is 17; expected 32", "keystone is 12; expected 0 (resamples",
        "magnify is 7; expected 0", "frame lock is 0; expected 1", "reset_picture = true",
    ):  # fmt: skip
        assert told in caught.value.message
    lab.control.picture.reset()
    assert lab.control.picture.problems() == []
    assert lab.projector.registers[codes.BRIGHTNESS] == 50


def test_what_cannot_be_reset_or_read_is_named():
    lab = Lab().lit()
    lab.projector.registers[codes.KEYSTONE] = 5
    original = lab.projector._register
    lab.projector._register = lambda c: (
        b"\x06" if c.type == codes.KEYSTONE_RESET else b"\x1c\0\0" if c.type == codes.FRAME_LOCK_1 else original(c)
    )
    with pytest.raises(DeviceError, match=r"keystone is 5; expected 0.*frame lock cannot be read.*options.unchecked"):
        lab.control.picture.reset()


def test_a_laboratorys_own_neutral_numbers_and_exceptions_count():
    settings = ControlSettings(neutral={"keystone": 128}, unchecked=("frame lock", "magnify"))
    lab = Lab(settings=settings).lit()
    lab.projector.registers |= {codes.KEYSTONE: 128, codes.MAGNIFY: 3, codes.FRAME_LOCK_1: 0}
    lab.control.picture.require()


def test_commands_keep_40_ms_from_the_last_reply():
    lab = Lab().lit()
    for _ in range(20):
        lab.control.error()
    assert lab.projector.counts.get("early", 0) == 0
    hasty = Lab(times=LineTimes(gap_s=0.0))
    hasty.control.open()
    for _ in range(5):
        hasty.control.error()
    assert hasty.projector.counts["early"] > 0


@pytest.mark.parametrize("late_s", [0.3, 0.49, 0.51, 0.55, 0.62, 0.66, 0.7, 1.0, 1.2, 1.3, 2.0, 2.5])
def test_replies_that_come_at_any_later_time_are_never_anothers(late_s):
    lab = Lab(late_s=late_s).lit()
    for name, code in (("rgb2", 4), ("rgb1", 0)) * 3:
        with suppress(DeviceError) if late_s >= 2.0 else nullcontext():  # longer than all its attempts: an error
            for ask, right in ((lab.control.lamp_hours, 812), (lab.control.filter_hours, 90)):
                lab.projector.faults.late = 1
                assert ask() == right
            lab.projector.faults.late = 1
            lab.control.select_input(name)
            assert lab.projector.registers[codes.INPUT] == code
            assert lab.control.error().code == 0


@pytest.mark.parametrize("fault", ["drop", "nak", "junk"])
def test_lost_refused_and_noisy_replies_are_asked_again(fault):
    lab = Lab().lit()
    before = lab.line.resent
    setattr(lab.projector.faults, fault, 2)
    assert lab.control.lamp_hours() == 812
    assert lab.line.resent == before + 2


def test_every_retry_ends():
    lab = Lab().lit()
    lab.projector.faults = Faults(nak=99)
    with pytest.raises(ProtocolError, match=r"'error get' was sent 4 times; the last answer: NAK"):
        lab.control.error()
    lab.projector.faults = Faults(drop=99)
    with pytest.raises(DeviceStalled, match=r"the last answer: nothing within 0.5 s. Check mains, the cross cable"):
        lab.control.error()


def test_endless_noise_is_another_device_or_baud_rate():
    lab = Lab()

    def noisy(timeout_s):
        lab.clock.sleep(0.01)
        return b"\xf8\x00"

    lab.cable.read = noisy
    with pytest.raises(ProtocolError, match=r"never falls silent .f8 00 ….: another device or baud rate"):
        lab.control.open()


def test_a_late_reply_is_not_taken_for_the_next_ones():
    lab = Lab(times=LineTimes(reply_s=0.1)).lit()
    original, late = lab.cable.conversation._say, [0.25]

    def slow(data, from_s):
        original(data, from_s + (late.pop() if late else 0.0))

    lab.cable.conversation._say = slow
    assert lab.control.lamp_hours() == 812
    assert lab.control.filter_hours() == 90


def test_a_value_that_cannot_be_is_asked_again():
    lab = Lab().lit()
    original, wrong = lab.projector._register, [b"\x1d\x09\x00", b"\x06"]
    lab.projector._register = lambda command: wrong.pop() if wrong else original(command)
    assert lab.control.blanked() is False
    assert wrong == []


def test_a_value_with_noise_behind_it_was_noise_itself():
    lab = Lab().lit()
    original, wrong = lab.projector._register, [b"\x1d\x07\x00\xf8\x1d"]
    lab.projector._register = lambda command: (wrong.pop() if wrong else b"") + original(command)
    assert lab.control.lamp_hours() == 812


def test_an_unplugged_line_is_absent_and_comes_back_by_itself():
    lab = Lab().lit()
    lab.cable.plugged = False
    with pytest.raises(DeviceAbsent, match="there is no /dev/projector"):
        lab.control.keep_alive(10)
    with pytest.raises(DeviceAbsent, match="there is no /dev/projector"):
        lab.control.error()
    lab.cable.plugged = True
    assert lab.control.error().code == 0
    lab.control.close()
    with pytest.raises(DeviceAbsent, match="is closed: open it"):
        lab.control.error()


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("manner", [Manner(), WRAPPED], ids=["serial", "wrapped"])
def test_random_faults_never_give_a_wrong_value(seed, manner):
    lab = Lab(manner=manner, dice=random.Random(seed), warm_up_s=2.0, times=LineTimes(attempts=12)).lit()
    lab.projector.faults = Faults(chance=0.2)
    for _ in range(20):
        lab.control.select_input("rgb2")
        assert lab.control.input() == "rgb2"
        lab.control.blank(True)
        assert lab.projector.registers[codes.BLANK] == 1
        assert lab.projector.registers[codes.BLANK_COLOUR] == codes.COLOUR_BLACK
        lab.control.blank(False)
        lab.control.select_input("rgb1")
    assert lab.projector.registers[codes.BLANK] == 0
