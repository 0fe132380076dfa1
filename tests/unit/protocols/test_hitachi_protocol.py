"""HITACHI's frames against the published bytes, and its decoder against everything else."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.errors import ProtocolError, UsageError
from fringed.protocols import hitachi_commands as commands
from fringed.protocols.hitachi import (
    HEADER,
    Ack,
    AuthenticationError,
    CannotExecute,
    CommandReader,
    Data,
    Nak,
    ReplyDecoder,
    crc16,
    decode_command,
    encode_command,
    encode_named,
    encode_reply,
)
from fringed.protocols.hitachi_commands import TABLE, VERIFIED_ON_SIBLINGS, Action, Command

PUBLISHED = {
    "power off": "2AD3 0100 0060 0000",
    "power on": "BAD2 0100 0060 0100",
    "power get": "19D3 0200 0060 0000",
    "input rgb1": "FED2 0100 0020 0000",
    "input rgb2": "3ED0 0100 0020 0400",
    "input get": "CDD2 0200 0020 0000",
    "error get": "D9D8 0200 2060 0000",
    "blank on": "6BD9 0100 2030 0100",
    "blank off": "FBD8 0100 2030 0000",
    "blank get": "C8D8 0200 2030 0000",
    "blank colour black": "9BD0 0100 0030 0600",
    "blank colour get": "08D3 0200 0030 0000",
    "freeze on": "13D3 0100 0230 0100",
    "freeze off": "83D2 0100 0230 0000",
    "freeze get": "B0D2 0200 0230 0000",
    "brightness get": "89D2 0200 0320 0000",
    "brightness reset": "58D3 0600 0070 0000",
    "contrast get": "FDD3 0200 0420 0000",
    "contrast reset": "A4D2 0600 0170 0000",
    "gamma 1 default": "07E9 0100 A130 2000",
    "gamma get": "F4F0 0200 A130 0000",
    "picture mode normal": "23F6 0100 BA30 0000",
    "picture mode get": "10F6 0200 BA30 0000",
    "keystone get": "B9D3 0200 0720 0000",
    "keystone reset": "08D0 0600 0C70 0000",
    "magnify get": "7CD2 0200 0730 0000",
    "magnify decrement": "CBD3 0500 0730 0000",
    "frame lock rgb1 on": "ABC3 0100 5030 0100",
    "frame lock rgb1 get": "08C2 0200 5030 0000",
    "frame lock rgb2 on": "9BC2 0100 5430 0100",
    "frame lock rgb2 get": "38C3 0200 5430 0000",
    "auto adjust": "91D0 0600 0A20 0000",
    "lamp hours get": "C2FF 0200 9010 0000",
    "filter hours get": "C2F0 0200 A010 0000",
}
EVENTS = st.one_of(
    st.builds(Ack),
    st.builds(Nak),
    st.builds(CannotExecute),
    st.builds(AuthenticationError),
    st.builds(Data, st.integers(0, 0xFFFF)),
)
COMMANDS = st.builds(Command, *[st.integers(0, 0xFFFF)] * 3)


def drained(decoder):
    found = []
    while (event := decoder.next_event()) is not None:
        found.append(event)
    return found


def cut(data, sizes):
    while data:
        size = next(sizes)
        yield data[:size]
        data = data[size:]


def test_every_command_of_the_table_is_published_and_has_those_bytes():
    assert set(PUBLISHED) == set(TABLE)
    for name, body in PUBLISHED.items():
        assert encode_named(name) == HEADER + bytes.fromhex(body), name
        assert decode_command(encode_named(name)) == TABLE[name].command


def test_what_only_later_models_print_is_not_marked_as_verified_on_siblings():
    others = {name for name in TABLE if name not in VERIFIED_ON_SIBLINGS}
    assert others == {
        "picture mode get", "magnify decrement",
        "frame lock rgb1 on", "frame lock rgb1 get", "frame lock rgb2 on", "frame lock rgb2 get",
    }  # fmt: skip


def test_the_crc_is_modbus_with_the_high_byte_first():
    assert crc16(b"123456789") == 0x4B37
    assert encode_named("power on")[5:7] == bytes.fromhex("BAD2")


@pytest.mark.parametrize(
    ("reply", "event"),
    [
        ("06", Ack()),
        ("15", Nak()),
        ("1C0000", CannotExecute()),
        ("1D0200", Data(2)),
        ("1D3412", Data(0x1234)),
        ("1F0400", AuthenticationError()),
    ],
)
def test_each_reply_whole_byte_by_byte_and_with_the_next_behind_it(reply, event):
    raw = bytes.fromhex(reply)
    assert encode_reply(event) == raw
    whole = ReplyDecoder()
    whole.feed(raw)
    assert whole.next_event() == event
    assert whole.next_event() is None
    slow = ReplyDecoder()
    for byte in raw[:-1]:
        slow.feed(bytes([byte]))
        assert slow.next_event() is None
    slow.feed(raw[-1:])
    assert slow.next_event() == event
    trailing = ReplyDecoder()
    trailing.feed(raw + b"\x06\x1d")
    assert [trailing.next_event(), trailing.next_event(), trailing.next_event()] == [event, Ack(), None]
    assert trailing.pending == b"\x1d"


def test_noise_is_an_error_until_somebody_resynchronises():
    decoder = ReplyDecoder()
    decoder.feed(b"\x06\xff\x00\x1d\x01\x00")
    assert decoder.next_event() == Ack()
    for _ in range(2):
        with pytest.raises(ProtocolError, match=r"answered ff 00 1d 01 00; a reply begins with 06, 15"):
            decoder.next_event()
    assert decoder.resynchronise() == b"\xff\x00\x1d\x01\x00"
    assert decoder.next_event() is None
    decoder.feed(b"\x1d\x01\x00")
    assert decoder.next_event() == Data(1)


def test_half_a_reply_is_forgotten_by_resynchronise():
    decoder = ReplyDecoder()
    decoder.feed(b"\x1d\x01")
    assert decoder.next_event() is None
    assert decoder.resynchronise() == b"\x1d\x01"
    decoder.feed(b"\x06")
    assert decoder.next_event() == Ack()


@pytest.mark.parametrize("reply", ["1f0000", "1f0500", "1c0100", "00", "be"])
def test_busy_and_unknown_replies_are_protocol_errors(reply):
    decoder = ReplyDecoder()
    decoder.feed(bytes.fromhex(reply))
    with pytest.raises(ProtocolError):
        decoder.next_event()


@given(st.lists(EVENTS, max_size=12), st.lists(st.integers(1, 5), min_size=60, max_size=60))
def test_any_replies_survive_any_cutting(events, sizes):
    decoder, found = ReplyDecoder(), []
    for chunk in cut(b"".join(map(encode_reply, events)), iter(sizes)):
        decoder.feed(chunk)
        found += drained(decoder)
    assert found == events
    assert decoder.pending == b""


@given(COMMANDS)
def test_any_command_survives_its_frame(command):
    assert decode_command(encode_command(command)) == command


@given(st.lists(COMMANDS, max_size=5), st.lists(st.integers(1, 17), min_size=80, max_size=80), st.binary(max_size=6))
def test_the_projectors_side_finds_commands_behind_noise(wanted, sizes, noise):
    noise = noise.replace(HEADER[:1], b"")
    reader, found = CommandReader(), []
    for chunk in cut(noise + b"".join(encode_command(each) for each in wanted), iter(sizes)):
        reader.feed(chunk)
        while (command := reader.next_command()) is not None:
            found.append(command)
    assert found == wanted


@given(COMMANDS, st.integers(5, 12), st.integers(1, 255))
def test_any_damaged_byte_behind_the_header_is_seen(command, place, change):
    frame = bytearray(encode_command(command))
    frame[place] ^= change
    with pytest.raises(ProtocolError, match="the CRC of"):
        decode_command(bytes(frame))
    reader = CommandReader()
    reader.feed(bytes(frame) + encode_command(command))
    with pytest.raises(ProtocolError):
        reader.next_command()
    assert reader.next_command() == command


@settings(max_examples=300)
@given(st.lists(st.binary(max_size=20), max_size=8))
def test_fuzzed_replies_raise_only_protocol_errors(chunks):
    decoder = ReplyDecoder()
    for chunk in chunks:
        decoder.feed(chunk)
        try:
            drained(decoder)
        except ProtocolError:
            decoder.resynchronise()


def test_twenty_thousand_random_strings_raise_only_protocol_errors():
    dice, decoder, reader, errors = random.Random(260), ReplyDecoder(), CommandReader(), 0
    for _ in range(20_000):
        data = dice.randbytes(dice.randrange(1, 24))
        for target, read in ((decoder, decoder.next_event), (reader, reader.next_command)):
            target.feed(data)
            try:
                while read() is not None:
                    pass
            except ProtocolError:
                errors += 1
                decoder.resynchronise()
    assert errors > 10_000


def test_a_command_that_does_not_fit_or_does_not_exist_says_what_does():
    with pytest.raises(UsageError, match="the setting 65536 does not fit a HITACHI command; allowed is 0 to 65535"):
        encode_command(Command(1, 2, 65536))
    with pytest.raises(UsageError, match="have no command 'shutter'; there are: power off"):
        encode_named("shutter")
    with pytest.raises(ProtocolError, match="13 bytes from BE EF 03 06 00; seen 2: be ef"):
        decode_command(b"\xbe\xef")


def test_the_codes_of_the_table_are_those_of_its_names():
    for name, entry in TABLE.items():
        assert (entry.command.action == Action.GET) == name.endswith(" get")
        assert entry.allowed is None or entry.command.action == Action.GET
    assert commands.ERROR_TEXTS[0x0C] == "the lens door is closed"
