"""What the daemon and the display process say: framing, packing, pixels."""

from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fringed.display.messages import (
    LONGEST,
    Decoder,
    Done,
    Gone,
    Idle,
    Load,
    Ping,
    Quit,
    Ready,
    Refused,
    Show,
    encode,
)
from fringed.display.patterns import packed, pixels, unpacked
from fringed.display.picture import BRIGHT, DIM, grid, with_text
from fringed.errors import DataError, ProtocolError

MESSAGES = (
    Load(1, 12, ((0, (1, 4, 3)),)),
    Show(2, 11),
    Idle(3),
    Ping(4),
    Quit(),
    Ready("x11", 0, "HDMI-1", "opengl", 1 / 60, 1 / 60, 1e-5, 1, "card0-HDMI-A-1", ("careful",)),
    Done(5, 12.25),
    Refused(6, "no"),
    Gone("unplugged"),
)
STREAM = b"".join(encode(message) for message in MESSAGES)


def test_every_message_survives_byte_by_byte():
    decoder = Decoder()
    found = [message for k in range(len(STREAM)) for message in decoder.feed(STREAM[k : k + 1])]
    assert tuple(found) == MESSAGES


@given(st.lists(st.integers(0, len(STREAM)), max_size=8))
def test_pieces_of_any_size_give_the_same_messages(cuts):
    places = [0, *sorted(cuts), len(STREAM)]
    decoder = Decoder()
    found = [m for a, b in pairwise(places) for m in decoder.feed(STREAM[a:b])]
    assert tuple(found) == MESSAGES


@given(st.binary(max_size=200))
def test_noise_is_refused_or_waited_for_and_nothing_else(data):
    with suppress(ProtocolError):
        Decoder().feed(data)


def test_too_long_a_message_is_refused_by_both_sides():
    with pytest.raises(ProtocolError, match="at most"):
        encode(Gone("x" * (LONGEST + 1)))
    with pytest.raises(ProtocolError, match=f"at most {LONGEST}"):
        Decoder().feed((LONGEST + 1).to_bytes(4, "little"))


@pytest.mark.parametrize("shape", [(1, 8, 1), (6, 1, 1), (1, 1, 3), (6, 8, 3), (6, 1, 3)])
def test_patterns_come_out_of_shared_memory_as_they_went_in(shape):
    patterns = [np.random.default_rng(k).integers(0, 256, shape).astype(np.uint8) for k in range(3)]
    data, table = packed(patterns)
    assert len(data) == 3 * np.prod(shape)  # a row stays a row
    for seen, wanted in zip(unpacked(data, table, (8, 6)), patterns, strict=True):
        assert np.array_equal(seen, wanted)


@pytest.mark.parametrize(
    ("table", "text"), [(((0, (2, 8, 1)),), "expected"), (((0, (6, 8, 3)),), "memory"), (((-1, (1, 1, 1)),), "memory")]
)
def test_a_table_that_does_not_fit_is_refused(table, text):
    with pytest.raises(DataError, match=text):
        unpacked(bytes(8), table, (8, 6))


@pytest.mark.parametrize("shifts", [(16, 8, 0), (0, 8, 16)])
def test_all_levels_of_each_channel_keep_their_value(shifts):
    levels = np.arange(256, dtype=np.uint8)
    for channel in range(3):
        pattern = np.zeros((1, 256, 3), np.uint8)
        pattern[0, :, channel] = levels
        assert np.array_equal(pixels(pattern, shifts)[0], levels.astype(np.uint32) << shifts[channel])
    grey = pixels(levels.reshape(1, 256, 1), shifts)[0]
    assert np.array_equal(grey, levels.astype(np.uint32) * 0x10101)


def test_the_idle_picture_is_dim_and_framed_and_text_fits():
    picture = with_text(grid((200, 150)), [np.ones((10, 300), np.uint8), np.ones((80, 20), np.uint8)])
    assert picture.shape == (150, 200, 1)
    assert set(np.unique(picture)) == {0, DIM, BRIGHT}
    assert (picture[[0, -1]] == BRIGHT).all() and (picture[:, [0, -1]] == BRIGHT).all()
