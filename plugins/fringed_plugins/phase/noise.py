"""The sensor's noise: from its data sheet's numbers, or estimated from the frames themselves.

Owns the model variance(I) = constant + slope * I, in grey levels; knows nothing of devices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.phase.shifts import Group, transform

_QUANTISATION_DN2 = 1 / 12
_BINS = 8


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


def estimate_noise(frames: npt.NDArray[Any], group: Group, orientation: str, rows: int = 96) -> NoiseModel:
    """Estimate the noise from how frames of one group misfit a sinusoid, on about `rows` lines.

    With four frames and more, one component of the residual is used; second differences along the
    fringes take out what is smooth there, such as the projector's harmonics. With three frames, which
    fit any sinusoid, the frames themselves are used instead: the sensor's fixed pattern then counts as noise.
    """
    if orientation == "rows":
        frames = frames.transpose(0, 2, 1)
    height = frames.shape[1]
    if height < 3:
        return NoiseModel(1.0, 0.0)
    middle = np.unique(np.linspace(1, height - 2, min(rows, height - 2)).astype(int))
    chosen = np.array(group.frames)[:, None, None]
    lines = frames[chosen, middle[:, None] + np.array([-1, 0, 1])].astype(np.float32)  # (n, lines, 3, width)
    matrix = transform(group.shifts_rad)
    plenty = len(group.frames) > 3
    light, quantity = (np.tensordot(matrix[i], lines, 1) if plenty else lines[0] for i in (0, 3))
    second = quantity[:, 0] - 2 * quantity[:, 1] + quantity[:, 2]
    return _line(light.mean(axis=1).ravel(), (second / np.sqrt(6)).ravel())


def _line(light: npt.NDArray[np.float32], noise: npt.NDArray[np.float32]) -> NoiseModel:
    """Fit variance against light, robustly: medians of absolute values in bins of light."""
    edges = np.quantile(light, np.linspace(0, 1, _BINS + 1))
    levels, variances = [], []
    for low, high in pairwise(edges):
        inside = (light >= low) & (light <= high)
        if np.count_nonzero(inside) >= 20:
            levels.append(float(np.median(light[inside])))
            variances.append(float((np.median(np.abs(noise[inside])) / 0.6745) ** 2))
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
