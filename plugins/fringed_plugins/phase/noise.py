"""The sensor's noise: from its data sheet's numbers, or estimated from the frames themselves.

Owns the model variance(I) = constant + slope * I, in grey levels; knows nothing of devices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.phase.shifts import Group, transform

_QUANTISATION_DN2 = 1 / 12
_BINS = 8
_FEWEST = 20  # places in a bin
_COLUMNS = 384


@dataclass(frozen=True)
class NoiseModel:
    """Variance of one frame at grey level I: `constant_dn2 + slope_dn * I`."""

    constant_dn2: float
    slope_dn: float

    @classmethod
    def from_sensor(cls, electrons_per_dn: float, read_noise_electrons: float) -> NoiseModel:
        """Return shot, read and quantisation noise; the black level counts as light, a little too much.

        References
        ----------
        EMVA 1288, release 4.0, equation 9.
        """
        return cls((read_noise_electrons / electrons_per_dn) ** 2 + _QUANTISATION_DN2, 1 / electrons_per_dn)


class Places(NamedTuple):
    """Where the noise is looked for: lines of three neighbours along the fringes, at some places of each."""

    lines: npt.NDArray[np.intp]  # (lines, 3)
    columns: npt.NDArray[np.intp]
    along_rows: bool  # fringes along rows: lines are columns of the picture

    def of(self, frame: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Return (lines, 3, columns) of one frame (height, width)."""
        picture = frame.T if self.along_rows else frame
        return np.asarray(picture[self.lines[:, :, None], self.columns], np.float32)


def places(shape: tuple[int, int], orientation: str, lines: int = 64) -> Places | None:
    """Return about `lines` x 384 places of frames of `shape`, or None where there are no three lines."""
    height, width = shape if orientation == "columns" else shape[::-1]
    if height < 3 or width < 1:
        return None
    middle = np.unique(np.linspace(1, height - 2, min(lines, height - 2)).astype(np.intp))
    columns = np.unique(np.linspace(0, width - 1, min(width, _COLUMNS)).astype(np.intp))
    return Places(middle[:, None] + np.array([-1, 0, 1]), columns, orientation == "rows")


def noise_group(groups: Sequence[Group]) -> Group:
    """Return the group to estimate noise from: the first, coarse to fine, whose fit leaves a residual."""
    return next((group for group in groups if len(group.frames) > 3), groups[0])


def estimate_noise(frames: npt.NDArray[Any], group: Group, orientation: str) -> NoiseModel:
    """Estimate the noise from how frames of one group misfit a sinusoid, at some 25 thousand places.

    With four frames and more, one component of the residual is used; second differences along the
    fringes take out what is smooth there, such as the projector's harmonics. With three frames, which
    fit any sinusoid, the frames themselves are used instead: the sensor's fixed pattern then counts as noise.
    """
    where = places((frames.shape[1], frames.shape[2]), orientation)
    if where is None:
        return NoiseModel(1.0, 0.0)
    return noise_of(np.stack([where.of(frames[i]) for i in group.frames]), group)


def noise_of(samples: npt.NDArray[np.float32], group: Group) -> NoiseModel:
    """Return the noise that `samples` (n, lines, 3, columns) of a group's frames show."""
    matrix = transform(group.shifts_rad).astype(np.float32)
    plenty = len(group.frames) > 3
    light, quantity = (np.tensordot(matrix[i], samples, 1) if plenty else samples[0] for i in (0, 3))
    second = quantity[:, 0] - 2 * quantity[:, 1] + quantity[:, 2]
    return _line(light.mean(axis=1).ravel(), np.abs(second.ravel()) / np.float32(np.sqrt(6)))


def _line(light: npt.NDArray[np.float32], noise: npt.NDArray[np.float32]) -> NoiseModel:
    """Fit variance against light, robustly: medians of absolute values in bins of as many places each."""
    finite = np.isfinite(light) & np.isfinite(noise)
    light, noise = light[finite], noise[finite]
    edges = [light.size * i // _BINS for i in range(1, _BINS)]
    order = np.argpartition(light, edges) if light.size >= _BINS * _FEWEST else np.arange(light.size)
    levels, variances = [], []
    for bin_ in np.split(order, edges) if light.size >= _BINS * _FEWEST else [order]:
        if bin_.size >= _FEWEST:
            levels.append(float(np.median(light[bin_])))
            variances.append(float((np.median(noise[bin_]) / 0.6745) ** 2))
    return _non_negative(levels, variances)


def _non_negative(levels: Sequence[float], variances: Sequence[float]) -> NoiseModel:
    if not levels:
        return NoiseModel(1.0, 0.0)
    if len(levels) < 2 or max(levels) - min(levels) < 1e-3:
        return NoiseModel(max(float(np.mean(variances)), _QUANTISATION_DN2), 0.0)
    slope, constant = np.polyfit(levels, variances, 1)
    if slope < 0:
        slope, constant = 0.0, float(np.mean(variances))
    if constant < _QUANTISATION_DN2:
        constant = _QUANTISATION_DN2
        weights = np.asarray(levels)
        slope = max(float(weights @ (np.asarray(variances) - constant) / max(weights @ weights, 1e-9)), 0.0)
    return NoiseModel(float(constant), float(slope))
