"""The HITACHI line on a network port: ids, hanging up, passwords; in virtual time."""

from __future__ import annotations

import pytest
from hitachi_lab import Lab

from fringed.devices.projector.hitachi_power import Lamp
from fringed.emulators.cpx260_conversation import Manner
from fringed.errors import DeviceError
from fringed.protocols.hitachi import decode_command, encode_named

WRAPPED = Manner(0, wrapped=True, idle_s=30.0)


def test_the_network_port_hangs_up_and_is_kept_alive():
    lab = Lab(manner=WRAPPED).lit()
    openings = lab.cable.openings
    for _ in range(100):
        lab.clock.sleep(1.0)
        lab.control.keep_alive(10)
    assert lab.cable.openings == openings
    lab.clock.sleep(31)
    assert lab.control.lamp_hours() == 812
    assert lab.cable.openings == openings + 1


def test_the_network_drops_replies_to_earlier_commands():
    lab = Lab(manner=WRAPPED).lit()
    lab.cable.conversation.emit(b"\x1d\x07\x07\xee", lab.clock.now() + 0.001)
    original = lab.cable.conversation._commands

    def preceded(now_s):
        lab.cable.conversation.emit(b"\x1d\x07\x07\xee", now_s)
        original(now_s)

    lab.cable.conversation._commands = preceded
    assert lab.control.lamp_hours() == 812


@pytest.mark.parametrize("wrapped", [False, True])
def test_passwords(wrapped):
    locked = Manner(0, wrapped=wrapped, password="fringe")
    lab = Lab(manner=locked, password="fringe").lit()
    lab.control.close()
    assert lab.control.open() is Lamp.ON
    with pytest.raises(DeviceError, match=r"wants a password .1f 04 00.: set projector.options.password"):
        Lab(manner=locked).control.open()
    with pytest.raises(DeviceError, match="refuses the password"):
        Lab(manner=locked, password="Fringe").control.open()
    with pytest.raises(DeviceError, match=r"asked for no password \(0 of 8 bytes came\)"):
        Lab(manner=Manner(0, wrapped=wrapped), password="fringe").control.open()


def test_the_password_precedes_the_first_frame_only():
    lab = Lab(manner=Manner(0, password="fringe"), password="fringe")
    lab.control.open()
    lab.control.look()
    assert [len(each) for each in lab.cable.sent] == [32 + 13, 13]
    assert decode_command(lab.cable.sent[0][32:]) == decode_command(encode_named("power get"))
