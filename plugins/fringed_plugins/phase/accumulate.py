"""Frames to phase while they arrive: sums of each group, each level as soon as it is complete.

Owns what is remembered between frames. After the last frame only the finest group's arctangent, its fringe order and
the neighbours' tests remain; the result is that of `decode.decode`, up to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.closed_forms import Sums
from fringed_plugins.phase.decode import STANDARD, Keep, cleaned, empty, new_state, no_sums, prepare, run
from fringed_plugins.phase.decode_kernel import Job, Part
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.level_kernel import BLOCK_PX
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import LANES, PLACES, Group, form_in_use, transform
from fringed_plugins.phase.sums import fold_blocks

Array = npt.NDArray[Any]
_UNKNOWN = NoiseModel(1.0, 0.0)
_NONE = np.empty((0, 0), np.float32)
_NOTHING = Decoded(_NONE, _NONE, _NONE, _NONE, _NONE, np.empty((0, 0), np.uint16))


class GroupFrames:
    """Frames of one group: all of them where a closed form takes them at once, otherwise sums and up to four.

    Bytes are smaller than sums of floats, so that up to six frames are quicker kept than added up.
    """

    def __init__(
        self, group: Group, shape: tuple[int, int], kind: np.dtype[Any], *, absolute: bool, threads: int
    ) -> None:
        closed = form_in_use(group.shifts_rad, absolute=absolute)
        self.closed = closed is not None
        order = closed[0] if closed is not None else range(len(group.frames))
        self._rank = {group.frames[i]: rank for rank, i in enumerate(order)}
        self._weights = transform(group.shifts_rad)[:3]
        self._missing = set(group.frames)
        self._threads = threads
        pixels = shape[0] * shape[1]
        self.frames = np.empty((len(group.frames) if self.closed else LANES, *shape), kind)
        self._waiting: list[int] = []
        nothing = np.empty(0, np.float32)
        self.sums = no_sums(kind)
        if not self.closed:
            light, cosine, sine, square, brightest = (np.empty(pixels, np.float32) for _ in range(5))
            self.sums = Sums(np.empty(pixels, kind), light, cosine, sine, square, brightest, nothing)
        self._begun = False

    @property
    def missing(self) -> list[int]:
        """The frames that are not there yet."""
        return sorted(self._missing)

    def add(self, index: int, frame: Array) -> None:
        """Take frame `index` of the set; raises ValueError where it is there already."""
        if index not in self._missing:
            raise ValueError(f"frame {index} came twice; each frame of a set counts once")
        self._missing.remove(index)
        if self.closed:
            self.frames[self._rank[index]] = frame
            return
        self.frames[len(self._waiting)] = frame
        self._waiting.append(self._rank[index])
        if len(self._waiting) == LANES or not self._missing:
            self._fold()

    def _fold(self) -> None:
        """Add what waits to the sums; the pivot, which adds nothing, stands for frames that there are too few of."""
        count = len(self._waiting)
        self.frames[count:] = self.sums.pivot.reshape(self.frames.shape[1:]) if self._begun else self.frames[0]
        weights = np.zeros((3, LANES), np.float32)
        weights[:, :count] = self._weights[:, self._waiting]
        flat = self.frames.reshape(LANES, -1)
        blocks = -(-flat.shape[1] // BLOCK_PX)
        run_rows(fold_blocks, blocks, flat, not self._begun, weights, self.sums, threads=self._threads)
        self._begun, self._waiting = True, []


class Accumulator:
    """One set of frames on its way to a phase; frames may come in any order.

    Parameters
    ----------
    shape, kind
        of every frame: (height, width), and uint8, uint16 or float32.
    groups, thresholds, size_px, keep, threads
        as `decode.decode` takes them.
    noise
        None where frames have to show it, or thresholds, first: levels wait for `settle`.

    Raises
    ------
    ValueError
        groups that cannot be decoded.

    Examples
    --------
    >>> steps = np.arange(4) * np.pi / 2
    >>> group = Group((0, 1, 2, 3), tuple(steps), 16.0)
    >>> limits, noise = Thresholds(similar_neighbours=0, border_glow=0.0), NoiseModel(1.0, 0.0)
    >>> sums = Accumulator((1, 2), np.float32, [group], limits, noise=noise)
    >>> for k in (2, 0, 3, 1):
    ...     sums.add(k, 100 + 50 * np.cos(np.array([[0.5, -1.0]]) + steps[k]))
    >>> sums.finish().phase_rad.round(5)
    array([[ 0.5, -1. ]], dtype=float32)
    """

    def __init__(
        self,
        shape: tuple[int, int],
        kind: npt.DTypeLike,
        groups: Sequence[Group],
        thresholds: Thresholds,
        size_px: int | None = None,
        *,
        noise: NoiseModel | None = None,
        keep: Keep = STANDARD,
        threads: int = 0,
    ) -> None:
        self.noise = noise
        self._groups, self._thresholds, self._size_px = tuple(groups), thresholds, size_px
        self._shape, self._keep, self._threads = shape, keep, threads
        prepare(self._groups, _UNKNOWN, thresholds, size_px)
        absolute = size_px is not None
        self._parts = [
            GroupFrames(group, shape, np.dtype(kind), absolute=absolute, threads=threads) for group in self._groups
        ]
        self._of_frame = {i: part for group, part in zip(groups, self._parts, strict=True) for i in group.frames}
        self._state = new_state(shape[0] * shape[1] if len(groups) > 1 else 0, keep.confidence and len(groups) > 1)
        self._done = 0  # levels that are in the state

    def add(self, index: int, frame: Array) -> None:
        """Take frame `index` of the set, (height, width); those of other groups are none of this one's business.

        Raises
        ------
        ValueError
            it came before, or has another shape.
        """
        part = self._of_frame.get(index)
        if part is None:
            return
        if frame.shape != self._shape:
            raise ValueError(f"frame {index} has shape {frame.shape}; the set's frames have {self._shape}")
        part.add(index, frame)
        self._advance()

    def settle(self, noise: NoiseModel, thresholds: Thresholds) -> None:
        """Tell what frames had to show first; before any level was taken."""
        self.noise, self._thresholds = noise, thresholds
        self._advance()

    def _advance(self) -> None:
        """Take the levels that are complete, but for the finest, into the state."""
        if self.noise is None:
            return
        while self._done < len(self._groups) - 1 and not self._parts[self._done].missing:
            self._level(self._done, self.noise, _NOTHING)
            self._done += 1

    def finish(self, frames: Array | None = None) -> Decoded:
        """Return what `decode.decode` returns for the set.

        With `frames`, the whole set, neighbours may settle doubtful fringe orders.

        Raises
        ------
        ValueError
            frames are missing, or nobody told the noise.
        """
        missing = [index for part in self._parts for index in part.missing]
        if missing:
            raise ValueError(f"frames {missing} have not come; a phase needs every frame of its groups")
        if self.noise is None:
            raise ValueError("the noise is unknown; tell it by `settle`")
        out = empty(self._shape, self._keep, absolute=self._size_px is not None)
        if out.rejected.size:
            self._level(len(self._groups) - 1, self.noise, out)
            cleaned(
                out, frames, self._groups, self.noise, self._thresholds, size_px=self._size_px, threads=self._threads
            )
        return out

    def _level(self, g: int, noise: NoiseModel, out: Decoded) -> None:
        """Take group `g` into the state, or the finest one into the maps."""
        layout, limits = prepare(self._groups, noise, self._thresholds, self._size_px)
        part = self._parts[g]
        frames = layout.frames.copy()
        frames[g, PLACES:] = np.arange(frames.shape[1] - PLACES)
        finest = g == len(self._groups) - 1
        step = Part(g, g + 1, finishes=finest, kept=len(self._groups) > 1, summed=not part.closed)
        job = Job(step, self._state, part.sums, limits, out)
        stack = part.frames.view()
        stack.flags.writeable = False
        run(stack, layout._replace(frames=frames), job, self._size_px is not None, self._threads)
