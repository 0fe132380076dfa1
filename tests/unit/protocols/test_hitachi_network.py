"""HITACHI's framing on TCP 9715, and its authentication."""

from __future__ import annotations

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fringed.errors import ProtocolError, UsageError
from fringed.protocols.hitachi import Ack, AuthenticationError, Data, encode_reply
from fringed.protocols.hitachi_commands import TABLE, Command
from fringed.protocols.hitachi_network import (
    NetworkDecoder,
    Reply,
    answer_nonce,
    unwrap_command,
    wrap_command,
)

COMMANDS = st.builds(Command, *[st.integers(0, 0xFFFF)] * 3)


def test_a_wrapped_command_has_length_checksum_and_id():
    wrapped = wrap_command(TABLE["power get"].command, 0x5A)
    assert wrapped[:-2] == bytes.fromhex("020D BEEF030600 19D3 0200 0060 0000")
    assert sum(wrapped[:-1]) % 256 == 0
    assert wrapped[-1] == 0x5A
    assert len(wrapped) == 17


@given(COMMANDS, st.integers(0, 255))
def test_any_command_survives_wrapping(command, id):
    assert unwrap_command(wrap_command(command, id)) == (command, id)


@given(COMMANDS, st.integers(0, 15), st.integers(1, 255))
def test_any_damaged_byte_is_seen(command, place, change):
    data = bytearray(wrap_command(command, 7))
    data[place] ^= change
    with pytest.raises(ProtocolError):
        unwrap_command(bytes(data))


@pytest.mark.parametrize("event", [Ack(), Data(0x1D06), AuthenticationError()])
def test_each_reply_carries_its_id_byte_by_byte(event):
    decoder, raw = NetworkDecoder(), encode_reply(event) + b"\x15"
    for byte in raw[:-1]:
        decoder.feed(bytes([byte]))
        assert decoder.next_reply() is None
    decoder.feed(raw[-1:] + b"\x06\x01")
    assert decoder.next_reply() == Reply(event, 0x15)
    assert decoder.next_reply() == Reply(Ack(), 1)


@given(st.lists(st.binary(max_size=12), max_size=6))
def test_fuzzed_replies_raise_only_protocol_errors(chunks):
    decoder = NetworkDecoder()
    for chunk in chunks:
        decoder.feed(chunk)
        try:
            while decoder.next_reply() is not None:
                pass
        except ProtocolError:
            decoder.resynchronise()


def test_the_answer_to_a_nonce_is_the_md5_of_nonce_and_password():
    nonce = bytes.fromhex("a572f60c0102fffe")
    assert answer_nonce(nonce, "fringe") == hashlib.md5(nonce + b"fringe").hexdigest().encode()
    # the example that projectors' network guides print
    assert answer_nonce(b"a572f60c", "password") == b"e3d97429adffa11bce1f7275813d4bde"


def test_wrong_nonces_passwords_and_ids_are_named():
    with pytest.raises(ProtocolError, match="nonce has 3 bytes; expected 8"):
        answer_nonce(b"abc", "x")
    with pytest.raises(UsageError, match="beyond ASCII"):
        answer_nonce(b"abcdefgh", "pässword")
    with pytest.raises(UsageError, match="id 256 does not fit"):
        wrap_command(Command(1, 2, 3), 256)
