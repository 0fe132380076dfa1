"""Decoding while frames arrive: the sink of the sinusoidal decoders.

Owns what a run is made of once parameters and sequence are understood; the sums are in `phase.accumulate`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fringed.data import Array, FrameSet, PhaseKind, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context, FrameSetStart
from fringed_plugins.decoders.common import as_seen, known_noise, phase_map_of

if TYPE_CHECKING:
    from fringed_plugins.phase.decode import Keep
    from fringed_plugins.phase.decoded import Decoded, Thresholds
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group


@dataclass(frozen=True)
class Work:
    """What to decode: groups from coarse to fine, and the projector's size where the phase is absolute."""

    groups: tuple[Group, ...]
    thresholds: Thresholds
    size_px: int | None
    keep: Keep
    weighted: bool = False

    @property
    def kind(self) -> PhaseKind:
        """What the result's phase counts from."""
        return "wrapped" if self.size_px is None else "absolute"

    def weigh(self, decoded: Decoded, frame_set: FrameSet, noise: NoiseModel, threads: int) -> None:
        """Weigh the frames of the finest group by their noise, where that is wanted."""
        from fringed_plugins.phase.weighting import weigh

        if self.weighted:
            weigh(decoded.phase_rad, decoded.sigma_rad, frame_set.frames, self.groups[-1], noise, threads)


class SumsSink:
    """The state of one run that takes its frames while they arrive, in any order.

    What the frames have to show first, noise and the projector's gamma, one group shows; its frames are kept until
    it is complete.
    """

    def __init__(self, start: FrameSetStart, work: Work, context: Context) -> None:
        from fringed_plugins.phase.accumulate import Accumulator
        from fringed_plugins.phase.noise import noise_group

        self._work, self._known = work, known_noise(start.settings)
        self._settled = self._known is not None and work.thresholds.gamma <= 1
        try:
            self._sums = Accumulator(
                start.shape, start.dtype, work.groups, work.thresholds, work.size_px,
                noise=self._known if self._settled else None, keep=work.keep, threads=context.threads,
            )  # fmt: skip
        except ValueError as error:
            raise DataError(f"patterns of family {start.sequence.family!r} cannot be decoded: {error}") from error
        self._group = noise_group(work.groups)
        self._orientation = start.sequence.frames[self._group.frames[0]].orientation
        self._kept: dict[int, Array] = {}

    def add(self, index: int, image: Array) -> None:
        """Take frame `index`."""
        self._sums.add(index, image)
        if not self._settled and index in self._group.frames:
            self._kept[index] = image.copy()
            if len(self._kept) == len(self._group.frames):
                self._settle()

    def _settle(self) -> None:
        """Tell the sums what the group's frames show."""
        from fringed_plugins.phase.noise import estimate_noise

        stack = np.stack([self._kept[index] for index in self._group.frames])
        alone = replace(self._group, frames=tuple(range(len(stack))))
        noise = self._known if self._known is not None else estimate_noise(stack, alone, self._orientation)
        self._sums.settle(noise, as_seen(self._work.thresholds, stack, [alone]))
        self._settled, self._kept = True, {}

    def finish(self, frame_set: FrameSet, context: Context) -> PhaseMap:
        """Return the phase map of the finished set.

        Raises
        ------
        DataError
            frames that have not come.
        """
        context.check_cancelled()
        try:
            decoded = self._sums.finish(frame_set.frames)
        except ValueError as error:
            raise DataError(f"the set {frame_set.id or 'without id'} cannot be decoded: {error}") from error
        if self._sums.noise is not None:
            self._work.weigh(decoded, frame_set, self._sums.noise, context.threads)
        return phase_map_of(decoded, self._work.kind, self._work.groups[-1], frame_set)
