"""The MS3100's bytes: published frames, any chunks, noise, round trips, and nothing unverified by accident."""

from __future__ import annotations

import os
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fringed.errors import ProtocolError, UsageError
from fringed.protocols.duncantech import (
    COMMANDS,
    LINES,
    OFFSETS,
    UNKNOWN,
    UNVERIFIED,
    VERIFIED,
    Command,
    Dialect,
    Done,
    GetGain,
    GetIntegration,
    GetOffset,
    SetGain,
    SetIntegration,
    SetOffset,
    Value,
    answers,
    decode_command,
    encode,
    parse_answer,
)
from fringed.protocols.duncantech_frames import MAX_SIZE, Frame, FrameDecoder, checksum, decode_frame

PUBLISHED = {
    SetGain(1, 256): "02 04 00 02 01 00 01 FC",
    SetIntegration(2, 500): "02 04 00 14 02 F4 01 F5",
    GetOffset(3): "02 02 00 05 03 F8",
}
SAFE, ALL = Dialect(), Dialect(unverified=True)
FUZZ_ROUNDS = int(os.environ.get("FRINGED_FUZZ_ROUNDS", "3000"))

channels = st.integers(1, 3)
commands = st.one_of(
    st.builds(SetGain, channels, st.integers(0, 0xFFFF)),
    st.builds(SetOffset, channels, st.integers(*OFFSETS)),
    st.builds(SetIntegration, channels, st.integers(*LINES)),
    *(st.builds(cls, channels) for cls in (GetGain, GetOffset, GetIntegration)),
)
frames = st.builds(Frame, st.integers(0, 255), st.binary(max_size=MAX_SIZE - 1))


@pytest.mark.parametrize(("command", "published"), PUBLISHED.items())
def test_published_frames_are_made_and_read(command: Command, published: str) -> None:
    data = bytes.fromhex(published)
    assert encode(command, SAFE) == data
    assert decode_command(decode_frame(data), SAFE) == command


def test_published_answer_of_get_offset_is_read() -> None:
    body = bytes((0x05, 3, 77, 0))
    answer = decode_frame(bytes((0x02, 0x04, 0x00)) + body + bytes((checksum(body),)))
    assert parse_answer(answer, GetOffset(3), SAFE) == Value(3, 77, 0)


@pytest.mark.parametrize("published", PUBLISHED.values())
def test_frames_are_found_byte_by_byte_and_with_trailing_bytes(published: str) -> None:
    decoder, data = FrameDecoder(), bytes.fromhex(published)
    found = [decoder.feed(data[i : i + 1]) for i in range(len(data))]
    assert found == [()] * (len(data) - 1) + [(decode_frame(data),)]
    assert decoder.feed(data + b"\x02\x04") == (decode_frame(data),)
    assert (decoder.pending, decoder.discarded) == (2, 0)


def test_every_table_is_complete_and_no_opcode_is_in_two() -> None:
    assert {cls.name for cls in COMMANDS} == set(VERIFIED) | set(UNVERIFIED)
    assert not set(VERIFIED.values()) & set(UNVERIFIED.values())
    assert not set(UNKNOWN) & (set(VERIFIED) | set(UNVERIFIED))


@pytest.mark.parametrize("command", [GetGain(1), SetOffset(2, 5), GetIntegration(3)])
def test_unverified_commands_are_refused_until_enabled(command: Command) -> None:
    with pytest.raises(UsageError, match=r"enable_unverified = true"):
        encode(command, SAFE)
    assert encode(command, ALL)[3] == UNVERIFIED[command.name]


def test_an_assumed_opcode_is_corrected_in_the_dialect() -> None:
    dialect = Dialect(unverified=True, opcodes={**UNVERIFIED, "get_gain": 0x42})
    assert encode(GetGain(1), dialect)[3] == 0x42
    assert decode_command(decode_frame(encode(GetGain(1), dialect)), dialect) == GetGain(1)


@pytest.mark.parametrize("opcodes", [{}, {**UNVERIFIED, "get_gain": 0x05}, {**UNVERIFIED, "get_gain": 300}])
def test_dialect_refuses_opcodes_that_confuse(opcodes: dict[str, int]) -> None:
    with pytest.raises(UsageError, match="none of them twice"):
        Dialect(opcodes=opcodes)


def test_dialect_refuses_two_ccds_on_one_channel() -> None:
    with pytest.raises(UsageError, match="need 1, 2 and 3"):
        Dialect(channels={"red": 1, "green": 1, "blue": 3})


@pytest.mark.parametrize(
    ("command", "allowed"),
    [
        (SetIntegration(1, 0), "1 to 1046"),
        (SetIntegration(1, 1047), "1 to 1046"),
        (SetGain(0, 1), "1 to 3"),
        (SetGain(1, 65536), "0 to 65535"),
        (SetOffset(1, 128), "0 to 127"),
        (GetOffset(4), "1 to 3"),
    ],
)
def test_numbers_beyond_their_limits_are_refused_with_the_limits(command: Command, allowed: str) -> None:
    with pytest.raises(UsageError, match=allowed):
        encode(command, ALL)


@given(commands)
def test_commands_survive_the_round_trip(command: Command) -> None:
    assert decode_command(decode_frame(encode(command, ALL)), ALL) == command


@given(st.lists(frames, max_size=5), st.data())
def test_frames_survive_any_chunks(sent: list[Frame], data: st.DataObject) -> None:
    stream, decoder, found = b"".join(f.encode() for f in sent), FrameDecoder(), []
    while stream:
        count = data.draw(st.integers(1, len(stream)))
        found += decoder.feed(stream[:count])
        stream = stream[count:]
    assert found == sent
    assert (decoder.pending, decoder.discarded, decoder.mismatches) == (0, 0, 0)


@given(frames, st.binary(max_size=40).filter(lambda b: 2 not in b), st.binary(max_size=40).filter(lambda b: 2 not in b))
def test_noise_around_a_frame_is_skipped_and_counted(frame: Frame, before: bytes, after: bytes) -> None:
    decoder = FrameDecoder()
    assert decoder.feed(before + frame.encode() + after) == (frame,)
    assert decoder.discarded == len(before) + len(after)


@given(frames, st.binary(min_size=1, max_size=30))
def test_no_noise_before_a_frame_hides_it_for_good(frame: Frame, noise: bytes) -> None:
    decoder = FrameDecoder()
    found = decoder.feed(noise + frame.encode()) + decoder.finish()
    # Noise may happen to be a frame itself; unless it swallowed bytes that way, the frame is there.
    assert frame in found or any(f != frame for f in found)
    assert decoder.pending == 0


def test_cut_off_frame_is_given_up_and_the_one_behind_it_found() -> None:
    decoder, whole = FrameDecoder(), bytes.fromhex("02 02 00 05 03 F8")
    assert decoder.feed(b"\x02\x40\x00\x05" + whole) == ()
    assert decoder.finish() == (decode_frame(whole),)


@given(frames, st.data())
def test_any_single_wrong_byte_is_noticed(frame: Frame, data: st.DataObject) -> None:
    raw = bytearray(frame.encode())
    place = data.draw(st.integers(0, len(raw) - 1))
    raw[place] ^= data.draw(st.integers(1, 255))
    with pytest.raises(ProtocolError):
        decode_frame(bytes(raw))


@pytest.mark.parametrize(
    "data",
    [b"", b"\x05", b"\x02\x00\x00\x00", b"\x03\x01\x00\x05\xfb", b"\x02\x02\x00\x05\xfb", b"\x02\xff\xff\x05\xfb"],
)
def test_what_is_no_frame_is_a_protocol_error(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_frame(data)


@pytest.mark.parametrize(
    ("data", "answer"),
    [(b"", Done()), (b"\x00", Done(0)), (b"\x01\x00\x01", Done()), (b"\x01\x00\x01\x00", Done(0))],
)
def test_a_set_is_answered_by_a_status_with_or_without_its_arguments(data: bytes, answer: Done) -> None:
    assert parse_answer(Frame(0x02, data), SetGain(1, 256), SAFE) == answer


@pytest.mark.parametrize(
    ("frame", "command", "why"),
    [
        (Frame(0x05, b"\x03\x4d\x01"), GetOffset(3), "status 0x01"),
        (Frame(0x05, b"\x02\x4d\x00"), GetOffset(3), "expected command 0x05"),
        (Frame(0x05, b"\x03\x4d"), GetOffset(3), "expected 3"),
        (Frame(0x03, b"\x03\x4d\x00"), GetOffset(3), "expected command 0x05"),
        (Frame(0x02, b"\x01\x00\x01\x07"), SetGain(1, 256), "status 0x07"),
        (Frame(0x02, b"\x01\x01\x01\x00"), SetGain(1, 256), "expected command 0x02 with 01 00 01"),
        (Frame(0x02, b"\x01\x00\x01\x00\x00"), SetGain(1, 256), "expected a status"),
    ],
)
def test_wrong_answers_say_what_came_and_what_is_right(frame: Frame, command: Command, why: str) -> None:
    with pytest.raises(ProtocolError, match=why):
        parse_answer(frame, command, SAFE)


def test_status_of_another_camera_is_a_setting() -> None:
    assert parse_answer(Frame(0x05, b"\x03\x4d\x06"), GetOffset(3), Dialect(status_ok=6)) == Value(3, 77, 6)
    assert parse_answer(Frame(0x02, b"\x09"), SetGain(1, 256), Dialect(set_answer="any")) == Done()


def test_a_frame_is_matched_with_its_command() -> None:
    assert answers(Frame(0x05, b"\x03\x4d\x00"), GetOffset(3), SAFE)
    assert not answers(Frame(0x05, b"\x01\x4d\x00"), GetOffset(3), SAFE)
    assert not answers(Frame(0x02, b"\x01\x02\x01\x00"), SetGain(1, 256), SAFE)


def test_random_bytes_raise_nothing_but_protocol_errors() -> None:
    source, decoder = random.Random(3100), FrameDecoder()
    for _ in range(FUZZ_ROUNDS):
        data = source.randbytes(source.randrange(24))
        if source.random() < 0.5:  # a valid frame around random data reaches the parsers
            data = Frame(source.choice([0x02, 0x03, 0x04, 0x05, 0x14, 0x15, source.randrange(256)]), data).encode()
        for frame in decoder.feed(data):
            for step in (
                lambda frame=frame: decode_command(frame, ALL),
                lambda frame=frame: parse_answer(frame, source.choice([GetOffset(1), SetGain(2, 3), GetGain(3)]), ALL),
            ):
                try:
                    step()
                except ProtocolError:
                    continue
        try:
            decode_frame(data)
        except ProtocolError:
            continue
    assert decoder.pending <= MAX_SIZE + 4
