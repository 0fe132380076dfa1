"""The HITACHI driver against the emulator's process: a pseudo-terminal and TCP in real time, with faults."""

from __future__ import annotations

import random
import socket
from contextlib import contextmanager

import pytest
from hitachi_lab import PATIENCE_S, emulator

from fringed.devices.camera.base import MachineClock
from fringed.devices.projector.hitachi_options import HitachiOptions, control_of, transport_of
from fringed.devices.projector.hitachi_power import Lamp
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError
from fringed.protocols.hitachi import Data, Nak, ReplyDecoder, encode_named

QUICK = ("--warm-up", 0.4, "--cool-down", 0.4)


@contextmanager
def bench(way, folder, **options):
    """Run an emulator with one port and yield it with an open control that is on."""
    link = folder / "projector"
    network = ("--password", "fringe") if way == "password" else ()
    port = {"serial": ("--pty", link), "plain": ("--tcp", 0)}.get(way, ("--wrapped", 0))
    with emulator(*port, *network, *QUICK) as lab:
        address = {"port": str(link)}
        if way != "serial":
            address = {"host": "127.0.0.1", "tcp_port": int(lab.ports[0].rpartition(":")[2])}
            address |= {"framing": "plain" if way == "plain" else "wrapped", "password": "fringe" * (way == "password")}
        chosen = HitachiOptions(**address, reply_timeout_s=0.2, warm_up_s=10, cool_down_s=10, attempts=8, **options)
        control = control_of(chosen, transport_of(chosen), MachineClock())
        control.open()
        try:
            control.power_on()
            control.wait_for(Lamp.ON, PATIENCE_S)
            yield lab, control
        finally:
            control.close()


@pytest.mark.parametrize("way", ["serial", "plain", "password"])
def test_the_whole_control(way, tmp_path):
    with bench(way, tmp_path) as (lab, control):
        control.select_input("rgb2")
        control.blank(True)
        control.freeze(True)
        assert control.input() == "rgb2" and control.blanked() and control.frozen()
        assert (control.error().code, control.lamp_hours(), control.filter_hours()) == (0, 812, 90)
        lab("set", keystone=3, magnify=2)
        assert [each.partition(" is ")[0] for each in control.picture.problems()] == ["keystone", "magnify"]
        control.picture.reset()
        state = lab("state")
        assert (state["keystone"], state["magnify"], state["lamp"]) == (0, 0, "ON")
        control.power_off()
        control.wait_for(Lamp.STANDBY, PATIENCE_S)
        counts = lab("state")["counts"]
        assert counts["switched on"] == counts["switched off"] == 1
        assert counts.get("bad crc", 0) == 0


@pytest.mark.parametrize("way", ["serial", "wrapped"])
def test_random_faults_and_unplugging_are_survived_or_named(way, tmp_path):
    dice, named = random.Random(7), 0
    with bench(way, tmp_path) as (lab, control):
        lab("chance", value=0.15)
        for round_ in range(12):
            if round_ % 4 == 3:
                lab("unplug", seconds=0.05 * dice.random())
            wanted = dice.choice(("rgb1", "rgb2"))
            try:
                control.select_input(wanted)
                assert control.input() == wanted
            except (DeviceAbsent, DeviceStalled, ProtocolError):
                named += 1
        lab("chance", value=0.0)
        lab("plug")
        control.close()
        control.open()
        control.select_input("rgb1")
        assert control.input() == "rgb1"
    assert named < 12


@pytest.mark.parametrize("way", ["serial", "wrapped"])
def test_unplugged_is_seen_and_replugged_is_ready(way, tmp_path):
    with bench(way, tmp_path) as (lab, control):
        lab("unplug")
        with pytest.raises(DeviceAbsent, match=r"there is no |nobody listens"):
            control.keep_alive(10)
        lab("plug")
        control.keep_alive(10)
        assert control.look() is Lamp.ON


def test_a_network_port_that_hung_up_is_opened_again(tmp_path):
    with bench("wrapped", tmp_path) as (lab, control):
        lab("hang-up")
        assert control.lamp_hours() == 812
        lab("hang-up")
        control.keep_alive(0)


def test_noise_unasked_harms_nothing(tmp_path):
    with bench("serial", tmp_path) as (lab, control):
        for _ in range(5):
            lab("noise", size=40)
            assert control.lamp_hours() == 812


def test_another_device_on_the_port_is_named(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        options = HitachiOptions(host="127.0.0.1", tcp_port=server.getsockname()[1], reply_timeout_s=0.1, attempts=2)
        control = control_of(options, transport_of(options), MachineClock())
        with pytest.raises(DeviceStalled, match="'power get' was sent 2 times; the last answer: nothing within"):
            control.open()
        control.close()
        with pytest.raises(DeviceError):
            control.look()


def conversation(number):
    peer = socket.create_connection(("127.0.0.1", number), PATIENCE_S)
    peer.settimeout(PATIENCE_S)
    return peer


def replies(peer, count):
    decoder, found = ReplyDecoder(), []
    while len(found) < count:
        decoder.feed(peer.recv(100))
        while (event := decoder.next_event()) is not None:
            found.append(event)
    return found


def test_the_emulator_checks_the_crc_and_drops_what_comes_too_early():
    with emulator("--tcp", 0) as lab, conversation(int(lab.ports[0].rpartition(":")[2])) as peer:
        damaged = bytearray(encode_named("power get"))
        damaged[5] ^= 1
        peer.sendall(damaged)
        assert replies(peer, 1) == [Nak()]
        peer.sendall(encode_named("power get"))  # within 40 ms of that reply, unless this machine was slow
        peer.settimeout(0.3)
        try:
            early = peer.recv(10)
        except TimeoutError:
            early = b""
        peer.settimeout(PATIENCE_S)
        peer.sendall(encode_named("lamp hours get"))
        assert replies(peer, 1) == [Data(812)]
        counts = lab("state")["counts"]
        assert (early == b"") == (counts.get("early", 0) == 1)
        assert counts["bad crc"] == 1


def test_the_emulator_acknowledges_power_on_and_then_emits_noise():
    with emulator("--tcp", 0, "--warm-up", 60) as lab, conversation(int(lab.ports[0].rpartition(":")[2])) as peer:
        peer.sendall(encode_named("power on"))
        got = b""
        while len(got) < 20:
            got += peer.recv(100)
        assert got[:1] == bytes([6])
        assert lab("state")["lamp"] == "WARMING"


def test_the_emulator_says_what_is_wrong_with_an_order():
    with emulator("--tcp", 0) as lab:
        with pytest.raises(AssertionError, match="there is no setting 'colour'; there are input, error"):
            lab("set", colour=1)
        with pytest.raises(AssertionError, match="no control line does 'dance'"):
            lab("dance")
        lab("quit")
