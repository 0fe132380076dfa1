"""Organised formats: TIFF of float32 XYZ, and NumPy's NPZ.

Owns the layout of their bytes.

References
----------
Adobe, TIFF revision 6.0; sample format 3 is IEEE floating point.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

_ASCII, _SHORT, _LONG = 2, 3, 4


def tiff(image: npt.NDArray[np.float32], description: str = "") -> bytes:
    """Return an uncompressed TIFF of `image` (height, width, samples) float32; samples keep their order.

    A `description` of printable ASCII becomes the tag ImageDescription.

    Raises
    ------
    ValueError
        an image that is not (height, width, samples), or nothing finite in it.
    """
    if image.ndim != 3:
        raise ValueError(f"an image of shape {image.shape}; expected (height, width, samples)")
    if not np.isfinite(image).any():
        raise ValueError("nothing is left to write: no point was kept; look at the masks of the earlier stages")
    height, width, samples = image.shape
    data = np.ascontiguousarray(image, "<f4").tobytes()
    after = 8 + len(data)  # header, pixels, then the arrays of tags, then the directory
    extra = struct.pack(f"<{samples}H", *[32] * samples) + struct.pack(f"<{samples}H", *[3] * samples)
    tags = [
        (256, _LONG, 1, width),
        (257, _LONG, 1, height),
        (258, _SHORT, samples, after),
        (259, _SHORT, 1, 1),  # no compression
        (262, _SHORT, 1, 2 if samples == 3 else 1),  # RGB or grey: what readers make of the samples
        (273, _LONG, 1, 8),
        (277, _SHORT, 1, samples),
        (278, _LONG, 1, height),
        (279, _LONG, 1, len(data)),
        (284, _SHORT, 1, 1),  # samples of a pixel side by side
        (339, _SHORT, samples, after + 2 * samples),
    ]
    if samples <= 2:  # two SHORTs fit into the entry itself
        tags[2], tags[10] = (258, _SHORT, samples, 32 | 32 << 16), (339, _SHORT, samples, 3 | 3 << 16)
    if description:
        words = description.encode("ascii", "replace").ljust(4, b" ") + b"\0"
        tags.insert(5, (270, _ASCII, len(words), after + len(extra)))
        extra += words + bytes(len(words) % 2)
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    return struct.pack("<2sHI", b"II", 42, after + len(extra)) + data + extra + directory


def npz(arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """Return an uncompressed NPZ; it holds no pickled objects and reads with allow_pickle=False.

    Raises
    ------
    ValueError
        an array of Python objects.
    """
    for name, array in arrays.items():
        if array.dtype.hasobject:
            raise ValueError(f"array {name!r} holds Python objects; only numbers and text can be written")
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()
