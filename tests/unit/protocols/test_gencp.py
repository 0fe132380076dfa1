"""GenCP: golden bytes, any chunks, noise, round trips, fuzzing; and a conversation's answers and refusals."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.errors import ProtocolError
from fringed.protocols import gencp
from fringed.protocols.gencp import (
    AcknowledgeDecoder,
    Pending,
    ReadDone,
    ReadRequest,
    Refusal,
    RequestDecoder,
    WriteDone,
    WriteRequest,
    encode_acknowledge,
    encode_request,
)
from fringed.protocols.gencp_conversation import Conversation

REQUESTS = {
    ReadRequest(1, 0x1D8, 8): "55335643 0040 0008 0c00 0100 d801000000000000 0000 0800",
    WriteRequest(2, 0x20004, b"\x01\0\0\0"): "55335643 0040 0208 0c00 0200 0400020000000000 01000000",
}
ACKNOWLEDGES = {
    ReadDone(1, b"\0\0\1\0\0\0\0\0"): "55335643 0000 0108 0800 0100 0000010000000000",
    WriteDone(2, 4): "55335643 0000 0308 0400 0200 0000 0400",
    WriteDone(2, None): "55335643 0000 0308 0000 0200",
    Pending(3, 500): "55335643 0000 0508 0400 0300 0000 f401",
    Refusal(4, 0x0800, 0x8003): "55335643 0380 0108 0000 0400",
}
ids = st.integers(0, 0xFFFF)
addresses = st.integers(0, 2**64 - 1)
requests = st.one_of(
    st.builds(ReadRequest, ids, addresses, st.integers(1, 0xFFFF)),
    st.builds(WriteRequest, ids, addresses, st.binary(min_size=1, max_size=64)),
)
acknowledges = st.one_of(
    st.builds(ReadDone, ids, st.binary(max_size=64)),
    st.builds(WriteDone, ids, st.one_of(st.none(), st.integers(0, 0xFFFF))),
    st.builds(Pending, ids, st.integers(0, 0xFFFF)),
    st.builds(Refusal, ids, st.sampled_from([0x0800, 0x0802]), st.integers(1, 0xFFFF)),
)


@pytest.mark.parametrize(("request_", "golden"), REQUESTS.items(), ids=lambda value: type(value).__name__)
def test_requests_have_the_published_bytes(request_, golden):
    assert encode_request(request_) == bytes.fromhex(golden)
    assert RequestDecoder().feed(bytes.fromhex(golden)) == [request_]


@pytest.mark.parametrize(("acknowledge", "golden"), ACKNOWLEDGES.items(), ids=lambda value: type(value).__name__)
def test_acknowledges_have_the_published_bytes(acknowledge, golden):
    assert encode_acknowledge(acknowledge) == bytes.fromhex(golden)
    assert AcknowledgeDecoder().feed(bytes.fromhex(golden)) == [acknowledge]


def test_acknowledges_come_byte_by_byte_with_noise_between_them():
    decoder, found = AcknowledgeDecoder(), []
    data = b"\xffU3" + b"U3VX".join(encode_acknowledge(one) for one in ACKNOWLEDGES)
    for byte in data:
        found += decoder.feed(bytes([byte]))
    assert found == list(ACKNOWLEDGES)
    assert decoder.discarded == 3 + 4 * (len(ACKNOWLEDGES) - 1)


@given(st.lists(requests, max_size=4), st.integers(1, 40))
def test_requests_survive_any_cut(sent, size):
    data, decoder, found = b"".join(map(encode_request, sent)), RequestDecoder(), []
    for at in range(0, len(data), size):
        found += decoder.feed(data[at : at + size])
    assert found == sent


@given(st.lists(acknowledges, max_size=4), st.integers(1, 40))
def test_acknowledges_survive_any_cut(sent, size):
    data, decoder, found = b"".join(map(encode_acknowledge, sent)), AcknowledgeDecoder(), []
    for at in range(0, len(data), size):
        found += decoder.feed(data[at : at + size])
    assert found == sent


@settings(max_examples=300)
@given(st.lists(st.one_of(st.binary(max_size=40), st.just(b"U3VC"), st.binary(max_size=20).map(lambda b: b"U3VC" + b))))
def test_whatever_comes_only_protocol_errors_leave(chunks):
    conversation = Conversation()
    conversation.read(0, 8)
    for decoder in (AcknowledgeDecoder(), RequestDecoder(), conversation):
        for chunk in chunks:
            with suppress(ProtocolError):
                decoder.feed(chunk)


def test_many_random_strings_raise_only_protocol_errors():
    random, decoder, refused = np.random.default_rng(6), AcknowledgeDecoder(), 0
    for _ in range(20_000):
        length = int(random.integers(0, 24))
        data = b"U3VC" + random.bytes(4) + bytes([length, 0]) + random.bytes(length + 2)
        try:
            decoder.feed(data)
        except ProtocolError:
            refused += 1
        decoder.reset()
    assert refused


@pytest.mark.parametrize(
    ("request_", "told"),
    [
        (ReadRequest(1, -1, 4), "address"),
        (ReadRequest(1, 0, 0), "1 to 65535"),
        (WriteRequest(1, 0, bytes(70000)), "65535"),
    ],
)
def test_what_a_command_cannot_carry_is_refused(request_, told):
    with pytest.raises(ProtocolError, match=told):
        encode_request(request_)


def test_a_conversation_reads_and_writes():
    conversation = Conversation()
    assert conversation.read(0x1D8, 8) == bytes.fromhex(REQUESTS[ReadRequest(1, 0x1D8, 8)])
    answer = encode_acknowledge(ReadDone(1, bytes(8)))
    assert conversation.feed(answer[:15]) is None
    assert conversation.feed(answer[15:]) == bytes(8)
    conversation.write(4, b"abcd")
    assert conversation.feed(encode_acknowledge(WriteDone(2, 4))) == b""


def test_a_pending_device_is_waited_for():
    conversation = Conversation()
    conversation.write(4, b"abcd")
    assert conversation.feed(encode_acknowledge(Pending(1, 700))) is None
    assert conversation.pending_ms == 700
    assert conversation.feed(encode_acknowledge(WriteDone(1, None))) == b""
    assert conversation.pending_ms == 0


def test_a_late_answer_is_not_taken_for_the_next():
    conversation = Conversation()
    conversation.read(0, 4)
    conversation.give_up()
    conversation.read(0, 4)
    assert conversation.feed(encode_acknowledge(ReadDone(1, b"late"))) is None
    assert conversation.stale == 1
    assert conversation.feed(encode_acknowledge(ReadDone(2, b"here"))) == b"here"


@pytest.mark.parametrize("status", [*sorted(set(gencp.STATUS) - {0}), 0x8099])
def test_a_refusal_is_named_with_its_address(status):
    conversation = Conversation()
    conversation.read(0x1234, 4)
    with pytest.raises(ProtocolError, match=rf"read 4 bytes at 0x1234: .*0x{status:04X}"):
        conversation.feed(encode_acknowledge(Refusal(1, 0x0800, status)))


@pytest.mark.parametrize(
    ("answer", "told"),
    [(ReadDone(1, b"abc"), "sent 3"), (WriteDone(1, 4), "WriteDone")],
)
def test_another_answer_than_was_asked_is_refused(answer, told):
    conversation = Conversation()
    conversation.read(0, 4)
    with pytest.raises(ProtocolError, match=told):
        conversation.feed(encode_acknowledge(answer))
    conversation.read(0, 4)  # and the next one may be asked


def test_half_a_write_is_refused():
    conversation = Conversation()
    conversation.write(0, b"abcd")
    with pytest.raises(ProtocolError, match="wrote 2"):
        conversation.feed(encode_acknowledge(WriteDone(1, 2)))


def test_a_second_request_before_the_answer_is_refused():
    conversation = Conversation()
    conversation.read(0, 4)
    with pytest.raises(ProtocolError, match="give that up"):
        conversation.read(0, 4)


def test_request_ids_never_are_zero():
    conversation = Conversation()
    for _ in range(0xFFFF + 2):
        data = conversation.read(0, 1)
        conversation.give_up()
        assert data[10:12] != b"\0\0"


def test_long_reads_come_in_pieces():
    assert list(gencp.pieces(1000, 512)) == [(0, 512), (512, 488)]
    with pytest.raises(ProtocolError, match="takes 0 bytes"):
        list(gencp.pieces(10, 0))
