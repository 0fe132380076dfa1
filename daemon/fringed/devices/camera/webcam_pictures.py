"""What a webcam's picture is, as one channel or as three: arrays in, arrays out."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from fringed.data import Array
from fringed.errors import ProtocolError

LUMA_AT = {"YUYV": 0, "UYVY": 1, "GREY": 0}
"""Formats whose brightness is had without a conversion, and which byte of a pixel it is."""
PLANES = {"blue": 0, "green": 1, "red": 2}  # OpenCV's order


def wants_raw(fourcc: str, channel: str) -> bool:
    """Whether the driver's own bytes are read: the brightness of those formats needs no colour conversion."""
    return channel == "white" and fourcc in LUMA_AT


def picture_of(raw: Any, size_px: tuple[int, int], fourcc: str, channel: str) -> Array:
    """Return the frame `(height, width)` uint8, or `(height, width, 3)` in red, green, blue for channel "rgb".

    Raises
    ------
    ProtocolError
        `raw` is neither a picture of `size_px` in blue, green, red, nor one of the bytes of `fourcc`.
    """
    width, height = size_px
    if isinstance(raw, np.ndarray) and raw.dtype == np.uint8:
        if raw.shape == (height, width, 3):
            return _of_colours(raw, channel)
        if channel != "rgb" and raw.size == height * width:
            return np.ascontiguousarray(raw.reshape(height, width))
        if wants_raw(fourcc, channel) and raw.size == 2 * height * width:
            return np.ascontiguousarray(raw.reshape(height, width, 2)[:, :, LUMA_AT[fourcc]])
    seen = f"{raw.dtype} of {raw.shape}" if isinstance(raw, np.ndarray) else type(raw).__name__
    raise ProtocolError(
        f"the webcam delivered {seen}; expected uint8 of {(height, width, 3)} for {width} x {height} in {fourcc}: "
        "another program may have changed its mode; open it again, or set another mode"
    )


def _of_colours(raw: Array, channel: str) -> Array:
    if channel == "rgb":
        return np.ascontiguousarray(raw[:, :, ::-1])
    if channel == "white":
        return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BGR2GRAY))
    return np.ascontiguousarray(raw[:, :, PLANES[channel]])
