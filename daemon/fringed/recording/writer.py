"""Write a frame set while its frames arrive, so that little is left to do after the last one.

Owns which frame goes where, and that what is committed is what was written.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed.data import Array, FrameSet, PatternSequence
from fringed.errors import DataError
from fringed.recording.partial import Partial
from fringed.recording.preface import Summary
from fringed.wire import Encoded, checksum, prepare


class SetWriter:
    """One frame set being written. Use it from one thread at a time.

    Writing a frame again (a retake) replaces it. `Store.begin_set` makes these.
    """

    def __init__(
        self,
        root: Path,
        set_id: str,
        sequence: PatternSequence,
        shape: tuple[int, ...],
        dtype: npt.DTypeLike,
        on_commit: Callable[[Path, Summary], None],
    ) -> None:
        count = len(sequence.frames)
        if len(shape) not in (2, 3) or (len(shape) == 3 and shape[0] != count) or 0 in shape:
            raise DataError(f"frames of shape {shape}; expected (height, width) or ({count}, height, width)")
        self.shape = (count, *shape[-2:])
        self.dtype = np.dtype(dtype).newbyteorder("<")
        if self.dtype not in (np.uint8, np.uint16):
            raise DataError(f"frames of type {self.dtype}; expected uint8 or uint16")
        self._on_commit = on_commit
        self._written: list[str] = [""] * count
        patterns = prepare(sequence)
        headers: list[dict[str, Any]] = [{"path": "frames", "dtype": self.dtype.str, "shape": list(self.shape)}]
        headers += [{**header, "path": f"sequence/{header['path']}"} for header in patterns.headers]
        self._headers = headers
        self._partial = Partial(root, set_id, "FrameSet", headers)
        for header, pattern in zip(headers[1:], patterns.buffers, strict=True):
            self._partial.write(header["path"], pattern)

    def write(self, index: int, image: Array) -> None:
        """Write frame `index`, `(height, width)`, at once.

        Raises
        ------
        DataError
            an index, shape or dtype that the set does not have.
        StorageError
            the disk refuses; the set is given up.
        """
        if not 0 <= index < self.shape[0] or image.shape != self.shape[1:] or image.dtype != self.dtype:
            raise DataError(
                f"frame {index} of shape {image.shape} and type {image.dtype}; "
                f"expected 0 to {self.shape[0] - 1}, {self.shape[1:]}, {self.dtype}"
            )
        image = np.asarray(image, self.dtype, order="C")
        self._partial.write("frames", image, index * image.nbytes)
        self._written[index] = checksum(image)

    def commit(self, frame_set: FrameSet, encoded: Encoded | None = None) -> Path:
        """Make the set lasting and visible; return its path. Give `encoded` if it is at hand.

        Frames that were not written, or differ from those that were, are written now.

        Raises
        ------
        DataError
            the set is of another id, size or sequence than the one begun with; the file is removed.
        StorageError
            the disk refuses; nothing stays visible.
        """
        try:
            encoded = encoded or prepare(frame_set)
            self._check(frame_set, encoded)
        except DataError:
            self.abort()
            raise
        for index, frame in enumerate(frame_set.frames):
            if checksum(frame) != self._written[index]:
                self.write(index, frame)
        summary = self._partial.commit(encoded)
        self._on_commit(self._partial.path, summary)
        return self._partial.path

    def abort(self) -> None:
        """Remove what was written; harmless when committed or aborted already."""
        self._partial.abort()

    def _check(self, frame_set: FrameSet, encoded: Encoded) -> None:
        if frame_set.id != self._partial.record_id:
            raise DataError(f"the set is called {frame_set.id!r}; writing began as {self._partial.record_id!r}")
        if len(encoded.headers) != len(self._headers):
            raise DataError(f"the set has {len(encoded.headers)} arrays; writing began with {len(self._headers)}")
        for begun, now in zip(self._headers, encoded.headers, strict=True):
            different = [key for key, value in begun.items() if now[key] != value]
            if different:
                raise DataError(f"{now['path']} is not what writing began with: {', '.join(different)} differ")
