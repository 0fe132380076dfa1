"""The station's own check of a frame set, before it is announced.

Owns the verdict and its words. Pure: arrays in, a CheckReport out. `SetCheck` takes each frame when it
arrives, so that only the judging is left after the last one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fringed.acquisition.lighting import light_findings, lit_fraction, saturated_fraction
from fringed.acquisition.pictures import Pictures, fit_frames, picture_findings, share_tone
from fringed.acquisition.sampling import full_scale, grid_step, noise_of, sample
from fringed.acquisition.siblings import Repeats
from fringed.acquisition.sinusoids import GroupFit, tone_of
from fringed.acquisition.styles import judged_groups
from fringed.acquisition.times import timing_findings
from fringed.config import CheckConfig
from fringed.data import Array, CameraSettings, CheckFinding, CheckReport, Float32Array, FrameStamp, PatternSequence
from fringed.errors import DataError


class SetCheck:
    """Judge one set: `add` each frame, then `finish`."""

    def __init__(self, sequence: PatternSequence, settings: CameraSettings, limits: CheckConfig) -> None:
        self._sequence, self._settings, self._limits = sequence, settings, limits
        self._grid: Float32Array | None = None
        self._have = np.zeros(len(sequence.frames), bool)
        self._step = 1
        self._pictures: Pictures | None = None
        self._fits: dict[tuple[int, ...], GroupFit] = {}
        self._tones: list[tuple[float, ...] | None] = []
        self._repeats = Repeats(sequence)
        self._repeated: dict[int, int] = {}

    def add(self, index: int, image: Array) -> None:
        """Take frame `index`, `(height, width)`; frames come in order."""
        pictures = self._pictures or self._begin(image)
        pictures.grid[index] = sample(image, self._step)
        self._have[index] = True
        earlier = self._repeats.find(pictures.grid, index)
        if earlier is not None:
            self._repeated[index] = earlier
        for indices in judged_groups(self._sequence):
            if index == indices[-1] and self._have[list(indices)].all():
                self._fits[indices] = fit = fit_frames(pictures, indices)
                self._tones.append(tone_of(fit))

    def _begin(self, image: Array) -> Pictures:
        self._step = grid_step(image.shape, self._limits.grid_px)
        top = full_scale(self._settings, image.dtype)
        grid = np.zeros((len(self._have), *sample(image, self._step).shape), np.float32)
        self._pictures = Pictures(
            grid, self._sequence, noise_of(self._settings, top), top, self._limits.residual_max
        )  # fmt: skip
        return self._pictures

    def finish(
        self, stamps: tuple[FrameStamp, ...], skipped: Mapping[int, int] | None = None, delay_s: float = 0.0
    ) -> CheckReport:
        """Return the verdict; `skipped` counts frames that the camera lost, `delay_s` is latency + settling."""
        skipped = skipped or {}
        lost = sum(skipped.values())
        findings = [*timing_findings(stamps, self._sequence.exposures(), delay_s), *_dropped(skipped)]
        if self._pictures is None or not self._have.all():
            missing = tuple(int(i) for i in np.flatnonzero(~self._have))
            findings.insert(0, CheckFinding("count", f"no frame came for patterns {missing}", missing))
            return CheckReport(False, tuple(findings), counters_skipped=lost)
        fits = share_tone(self._sequence, list(self._fits.values()), self._tones)
        grid, top = self._pictures.grid, self._pictures.top
        saturated = saturated_fraction(grid, self._sequence, top)
        lit = lit_fraction(grid, self._sequence, fits, top)
        wrong, residual = picture_findings(self._pictures, fits, self._repeated)
        findings += [*light_findings(grid, self._sequence, (saturated, lit), top, self._limits), *wrong]
        return CheckReport(not findings, tuple(findings), residual, saturated, lit, lost)


def check_frames(
    frames: Array,
    sequence: PatternSequence,
    settings: CameraSettings,
    limits: CheckConfig,
    stamps: tuple[FrameStamp, ...] = (),
) -> CheckReport:
    """Judge a whole set `(n, height, width)` at once; without `stamps` its times are not judged.

    Raises
    ------
    DataError
        the frames are no stack with one frame for each pattern.
    """
    if frames.ndim != 3 or len(frames) != len(sequence.frames):
        raise DataError(f"frames have shape {frames.shape}; expected ({len(sequence.frames)}, height, width)")
    check = SetCheck(sequence, settings, limits)
    for index, image in enumerate(frames):
        check.add(index, image)
    return check.finish(stamps)


def _dropped(skipped: Mapping[int, int]) -> list[CheckFinding]:
    return [
        CheckFinding("dropped", f"the camera's counter skipped {count} before frame {index}", (index,))
        for index, count in sorted(skipped.items())
        if count
    ]
