"""What an X server scans out: the frame buffer of `Xvfb -fbdir`, mapped. An ideal video cable.

Owns the file's layout (an XWD header, then lines of 32-bit pixels).
"""

from __future__ import annotations

import mmap
from pathlib import Path

import numpy as np

from fringed.data import Array, UInt8Array
from fringed.errors import DataError

_HEADER = 100  # bytes of an XWDFileHeader; a name follows
_NUMBERS = 25
_MASKS = (0xFF0000, 0xFF00, 0xFF)
_SPARSE = 61  # bytes between two that are compared: no divisor of a line, so that every column is met


class FrameBuffer:
    """A mapped frame buffer of 24-bit colour; the server may end, the map stays.

    Raises
    ------
    DataError
        the file is missing, or of another depth or order.
    """

    def __init__(self, path: Path) -> None:
        try:
            with path.open("rb") as file:
                self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise DataError(f"{path} is no frame buffer: {error}; start Xvfb with -fbdir") from error
        header = np.frombuffer(self._memory[:_HEADER], ">u4", _NUMBERS).astype(int)
        self.size_px = (int(header[4]), int(header[5]))
        bits, masks = int(header[11]), tuple(int(mask) for mask in header[14:17])
        if bits != 32 or masks != _MASKS or header[7]:
            raise DataError(f"{path} has {bits} bits a pixel and masks {masks}; expected 32 and {_MASKS}: -screen 24")
        self._start, self._line_bytes = int(header[0]) + 12 * int(header[19]), int(header[12])

    def picture(self) -> UInt8Array:
        """Return a copy of what is scanned out now, (height, width, 3) red, green, blue."""
        width, height = self.size_px
        lines = self._bytes().reshape(height, self._line_bytes)
        return lines[:, : 4 * width].reshape(height, width, 4)[..., 2::-1].copy()

    def sample(self) -> UInt8Array:
        """Return a sparse copy: another one where the picture is another one."""
        return self._bytes()[::_SPARSE].copy()

    def close(self) -> None:
        """Unmap it."""
        self._memory.close()

    def _bytes(self) -> UInt8Array:
        return np.frombuffer(self._memory, np.uint8, self.size_px[1] * self._line_bytes, self._start)


def reduced(picture: Array) -> UInt8Array:
    """Return a picture as the pattern that it shows: one row, one column or one channel where all are alike."""
    grey = bool((picture == picture[..., :1]).all())
    pattern = picture[..., :1] if grey else picture
    if bool((pattern == pattern[:1]).all()):
        pattern = pattern[:1]
    if bool((pattern == pattern[:, :1]).all()):
        pattern = pattern[:, :1]
    return np.ascontiguousarray(pattern)
