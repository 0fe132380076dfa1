"""The USB3 Vision stream: golden bytes, blocks out of transfers, each way that a block can be incomplete, fuzzing."""

import io
import zipfile
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.errors import ProtocolError
from fringed.protocols import u3v_registers as registers
from fringed.protocols.u3v import (
    BlockAssembler,
    Leader,
    Trailer,
    decode_leader,
    decode_trailer,
    encode_leader,
    encode_trailer,
    plan_transfers,
)

LEADER = Leader(7, 0x1122334455667788, 0x01080001, 1392, 1040, 4, 2, 1)
LEADER_BYTES = bytes.fromhex(
    "5533564c 0000 3400 0700000000000000 0000 0100 8877665544332211 01000801"
    "70050000 10040000 04000000 02000000 0100 0000"
)
TRAILER = Trailer(7, 1447680, 1040, 0)
TRAILER_BYTES = bytes.fromhex("55335654 0000 2000 0700000000000000 0000 0000 0017160000000000 10040000")
PLAN = plan_transfers((52, 100, 32), 8, 40)
u32, u64 = st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1)
sides = st.integers(1, 1 << 16)


def transfers(block=0, picture=None, **trailer):
    payload = np.arange(100, dtype=np.uint8).tobytes() if picture is None else picture
    yield encode_leader(Leader(block, 1000 + block, 0x01080001, 10, 10))
    yield from (payload[:40], payload[40:80], payload[80:])
    yield encode_trailer(Trailer(block, trailer.get("valid_bytes", 100), 10, trailer.get("status", 0)))


def feed_all(assembler, sent):
    """Return the blocks and the errors, in order."""
    found = []
    for transfer in sent:
        try:
            block = assembler.feed(transfer)
        except ProtocolError as error:
            found.append(error.message)
        else:
            if block is not None:
                found.append(block.leader.block_id)
    return found


def test_leader_and_trailer_have_the_published_bytes():
    assert encode_leader(LEADER) == LEADER_BYTES
    assert decode_leader(LEADER_BYTES) == LEADER
    assert encode_trailer(TRAILER) == TRAILER_BYTES
    assert decode_trailer(TRAILER_BYTES) == TRAILER


@given(st.builds(Leader, u64, u64, u32, sides, sides, u32, u32, st.integers(0, 0xFFFF), st.sampled_from([1, 0x4001])))
def test_any_leader_survives(leader):
    assert decode_leader(encode_leader(leader)) == leader


@given(st.builds(Trailer, u64, u64, u32, st.integers(0, 0xFFFF)))
def test_any_trailer_survives(trailer):
    assert decode_trailer(encode_trailer(trailer)) == trailer


@pytest.mark.parametrize("cut", range(0, 52, 4))
def test_a_cut_leader_is_named(cut):
    with pytest.raises(ProtocolError, match=f"a transfer of {cut} bytes"):
        decode_leader(LEADER_BYTES[:cut])


@pytest.mark.parametrize(("at", "told"), [(18, "payload type 0x00FF"), (32, "255 x 1040|pixels")])
def test_a_leader_of_something_else_is_named(at, told):
    data = bytearray(LEADER_BYTES)
    data[at : at + 4] = b"\xff\0\xff\xff" if at == 32 else b"\xff\0\x88\x77"
    with pytest.raises(ProtocolError, match=told):
        decode_leader(bytes(data))


def test_the_plan_covers_the_payload_in_aligned_transfers():
    assert PLAN.payloads == (40, 40, 24)
    plan = plan_transfers((52, 1392 * 1040 * 3, 32), 1024, 1 << 20)
    assert (plan.leader, plan.trailer, plan.payload, plan.count) == (1024, 1024, 1 << 20, 4)
    assert sum(plan.payloads) - 1023 <= 1392 * 1040 * 3 <= sum(plan.payloads)
    assert all(size % 1024 == 0 for size in plan.payloads)


@pytest.mark.parametrize("payload", [0, 1 << 40])
def test_a_plan_for_an_impossible_payload_is_refused(payload):
    with pytest.raises(ProtocolError, match="width, height and pixel format"):
        plan_transfers((52, payload, 32), 8, 1 << 20)


def test_blocks_come_out_of_their_transfers():
    assembler, blocks = BlockAssembler(PLAN), []
    wanted = []
    for transfer in [*transfers(0), *transfers(1)]:
        wanted.append(assembler.wanted)
        if (block := assembler.feed(transfer)) is not None:
            blocks.append(block)
    assert wanted == [PLAN.leader, 40, 40, 24, PLAN.trailer] * 2
    assert [block.leader.block_id for block in blocks] == [0, 1]
    assert [block.leader.time_stamp for block in blocks] == [1000, 1001]
    assert all(block.payload.tolist() == list(range(100)) for block in blocks)


def test_padding_after_the_valid_bytes_is_dropped():
    sent = list(transfers())
    sent[3] += bytes(4)
    assembler = BlockAssembler(PLAN)
    blocks = [block for block in map(assembler.feed, sent) if block]
    assert len(blocks[0].payload) == 100


def test_a_picture_may_look_like_a_leader():
    picture = encode_leader(Leader(9, 0, 1, 1, 1))[:40] + encode_trailer(Trailer(0, 100, 10)) + bytes(28)
    assert feed_all(BlockAssembler(PLAN), transfers(picture=picture)) == [0]


@pytest.mark.parametrize("missing", range(5))
def test_one_lost_transfer_costs_one_block_and_is_named(missing):
    first = list(transfers(0))
    del first[missing]
    assembler = BlockAssembler(PLAN)
    found = feed_all(assembler, [*first, *transfers(1), *transfers(2)])
    assert found[-2:] == [1, 2]
    if missing == 0:
        assert assembler.skipped == 4 and len(found) == 2
    else:
        assert len(found) == 3 and "block 0 is incomplete" in found[0] and "check the USB cable" in found[0]


def test_a_short_payload_is_named():
    sent = list(transfers(0))
    sent[2] = sent[2][:-8]
    assert "92 of 104 bytes" in feed_all(BlockAssembler(PLAN), sent)[0]


def test_a_block_that_the_camera_discarded_is_named():
    found = feed_all(BlockAssembler(PLAN), transfers(3, status=0xA100))
    assert "block 3" in found[0] and "data discarded (0xA100)" in found[0]


def test_a_trailer_of_another_block_is_named():
    sent = [*list(transfers(3))[:-1], *list(transfers(4))[-1:]]
    assert "the trailer of block 4 came" in feed_all(BlockAssembler(PLAN), sent)[0]


def test_a_transfer_that_could_not_be_taken_ends_the_block():
    assembler = BlockAssembler(PLAN)
    with pytest.raises(ProtocolError, match="between two blocks"):
        assembler.lost("overflow")
    sent = list(transfers(0))
    assembler.feed(sent[0])
    with pytest.raises(ProtocolError, match=r"block 0 is incomplete.*overflow"):
        assembler.lost("overflow")
    assert feed_all(assembler, [*sent[1:], *transfers(1)]) == [1]


chunks = st.one_of(
    st.binary(max_size=60), st.just(LEADER_BYTES), st.just(TRAILER_BYTES), st.sampled_from(list(transfers(5)))
)


@settings(max_examples=300)
@given(st.lists(chunks, max_size=12))
def test_whatever_comes_only_protocol_errors_leave_and_the_next_block_is_read(sent):
    assembler = BlockAssembler(PLAN)
    feed_all(assembler, sent)
    found = feed_all(assembler, [*transfers(8), *transfers(9)])
    assert found[-1] == 9


def zipped(text, name="camera.xml"):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, text)
    return buffer.getvalue()


def test_a_manifest_entry_has_64_bytes_and_survives():
    entry = registers.ManifestEntry(0x10000, 5000, True, 0x01020003)
    raw = registers.encode_entry(entry, bytes(range(20)))
    assert raw[:24] == bytes.fromhex("03000201 00040000 0000010000000000 8813000000000000")
    assert len(raw) == 64 and registers.decode_entry(raw) == entry


@pytest.mark.parametrize("zip_it", [True, False])
def test_descriptions_are_read_plain_and_zipped(zip_it):
    raw = zipped("<a/>") if zip_it else b"\xef\xbb\xbf<a/>\0\0"
    assert registers.description_text(raw, zip_it) == "<a/>"


@settings(max_examples=200)
@given(st.binary(max_size=200), st.booleans())
def test_broken_descriptions_raise_only_protocol_errors(raw, zip_it):
    with suppress(ProtocolError):
        registers.description_text(raw, zip_it)


@settings(max_examples=200)
@given(st.integers(0, 150), st.binary(min_size=1, max_size=8))
def test_damaged_archives_raise_only_protocol_errors(at, damage):
    raw = bytearray(zipped("<a/>" * 20))
    raw[at : at + len(damage)] = damage
    with suppress(ProtocolError):
        registers.description_text(bytes(raw), True)


def test_an_archive_without_a_description_is_named():
    with pytest.raises(ProtocolError, match=r"readme\.txt"):
        registers.description_text(zipped("x", "readme.txt"), True)


@settings(max_examples=200)
@given(st.binary(min_size=60, max_size=66), u32)
def test_manifests_and_alignments_raise_only_protocol_errors(raw, info):
    for call, value in ((registers.decode_entry, raw), (registers.alignment_of, info)):
        with suppress(ProtocolError):
            call(value)


def test_strings_end_at_their_first_zero():
    assert registers.text_of(b"MS3100 \0junk") == "MS3100"
    assert registers.text_of(b"\xff\xfe\0") != ""
