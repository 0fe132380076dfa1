"""Decoding while frames arrive: the sink of the sinusoidal decoders.

Owns what a run is made of once parameters and sequence are understood; the sums are in `phase.accumulate`.
"""

from __future__ import annotations

from dataclasses import dataclass
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

    Where the camera's settings do not tell the noise, some pixels of a group are kept until it is complete.
    """

    def __init__(self, start: FrameSetStart, work: Work, context: Context) -> None:
        from fringed_plugins.phase.accumulate import Accumulator
        from fringed_plugins.phase.noise import noise_group, places

        self._work = work
        try:
            self._sums = Accumulator(
                start.shape, start.dtype, work.groups, work.thresholds, work.size_px,
                keep=work.keep, threads=context.threads,
            )  # fmt: skip
        except ValueError as error:
            raise DataError(f"patterns of family {start.sequence.family!r} cannot be decoded: {error}") from error
        self._noise = known_noise(start.settings)
        self._group = noise_group(work.groups)
        self._places = places(start.shape, start.sequence.frames[self._group.frames[0]].orientation)
        self._samples: dict[int, Array] = {}

    def add(self, index: int, image: Array) -> None:
        """Take frame `index`."""
        self._sums.add(index, image)
        if self._noise is None and self._places is not None and index in self._group.frames:
            self._samples[index] = self._places.of(image)
            if len(self._samples) == len(self._group.frames):
                self._noise = self._estimated()

    def _estimated(self) -> NoiseModel:
        from fringed_plugins.phase.noise import noise_of

        return noise_of(np.stack([self._samples[i] for i in self._group.frames]), self._group)

    def finish(self, frame_set: FrameSet, context: Context) -> PhaseMap:
        """Return the phase map of the finished set.

        Raises
        ------
        DataError
            frames that have not come.
        """
        from fringed_plugins.phase.noise import NoiseModel

        context.check_cancelled()
        noise = self._noise or NoiseModel(1.0, 0.0)
        try:
            limits = as_seen(self._work.thresholds, frame_set.frames, self._work.groups)
            decoded = self._sums.finish(noise, frame_set.frames, limits)
        except ValueError as error:
            raise DataError(f"the set {frame_set.id or 'without id'} cannot be decoded: {error}") from error
        self._work.weigh(decoded, frame_set, noise, context.threads)
        return phase_map_of(decoded, self._work.kind, self._work.groups[-1], frame_set)
