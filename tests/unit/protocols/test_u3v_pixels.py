"""Pixel formats: golden bytes of each packing, round trips of all of them, what is too short or unknown."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fringed.errors import ProtocolError
from fringed.protocols.u3v_pixels import BY_NAME, FORMATS, decode_image, encode_image, format_of

GOLDEN = {  # name: (bytes, pixels of one line)
    "Mono8": ("01 02 ff", [1, 2, 255]),
    "Mono10": ("ff 03 01 00", [1023, 1]),
    "Mono12": ("ff 0f bc 0a", [4095, 0xABC]),
    "Mono16": ("34 12", [0x1234]),
    "Mono12p": ("bc 3a 12", [0xABC, 0x123]),
    "Mono12Packed": ("ab 3c 12", [0xABC, 0x123]),
    "Mono10Packed": ("ff 12 80", [0x3FE, 0x201]),
    "RGB8": ("01 02 03", [[1, 2, 3]]),
    "BGR8": ("01 02 03", [[3, 2, 1]]),
    "RGB10": ("01 00 02 00 ff 03", [[1, 2, 1023]]),
}


@pytest.mark.parametrize("name", GOLDEN)
def test_bytes_are_read_as_the_pfnc_says(name):
    data, line = GOLDEN[name]
    raw = np.frombuffer(bytes.fromhex(data), np.uint8)
    image = decode_image(raw, BY_NAME[name], (len(line), 1))
    assert image[0].tolist() == line
    assert encode_image(image, BY_NAME[name]).tobytes() == raw.tobytes()


def test_mono10p_begins_with_the_least_significant_bit():
    values = [0x155, 0x2AA, 0x001, 0x3FE]
    number = sum(value << 10 * index for index, value in enumerate(values))
    raw = np.frombuffer(number.to_bytes(5, "little"), np.uint8)
    assert decode_image(raw, BY_NAME["Mono10p"], (4, 1))[0].tolist() == values


@given(st.sampled_from(FORMATS), st.integers(1, 9), st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_every_format_survives_its_bytes(pixels, width, height, seed):
    shape = (height, width) if pixels.channels == 1 else (height, width, 3)
    dtype = np.uint8 if pixels.bits <= 8 else np.uint16
    image = np.random.default_rng(seed).integers(0, 2**pixels.bits, shape).astype(dtype)
    raw = encode_image(image, pixels)
    assert len(raw) == pixels.payload_bytes(width, height)
    back = decode_image(raw, pixels, (width, height))
    assert back.dtype == dtype and np.array_equal(back, image)
    with pytest.raises(ProtocolError, match=f"{width} x {height} pixels of {pixels.name}"):
        decode_image(raw[:-1], pixels, (width, height))


def test_codes_and_depths_agree():
    for pixels in FORMATS:
        stored = {"none": 8 if pixels.bits == 8 else 16, "lsb": pixels.bits, "gev": 12}[pixels.packing]
        assert pixels.bits_per_pixel == stored * pixels.channels
        assert format_of(pixels.code) is pixels


def test_lines_with_padding_lose_it():
    raw = np.arange(12, dtype=np.uint8)
    assert decode_image(raw, BY_NAME["Mono8"], (2, 3), padding=2).tolist() == [[0, 1], [4, 5], [8, 9]]


def test_an_unknown_format_is_named_with_those_that_can_be_read():
    with pytest.raises(ProtocolError, match=r"0x01080009.*Mono8.*RGB12p"):
        format_of(0x01080009)
