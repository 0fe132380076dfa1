"""Windows of 5 x 5 px over Gray code and fringes: where single pixels are too noisy for their bits.

Owns how the bits of a window are read: their differences are added up before they are judged. `correction` asks it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group, phase_variance_factor
from fringed_plugins.phase.temporal import windows
from fringed_plugins.phase.temporal.gray_kernel import options, ruler
from fringed_plugins.phase.temporal.graybits import BitFrames, Layout, differences, place

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]

_LEAST_PX = 9  # of 25: fewer are no window
_ZERO = np.float32(0)
_ONE = np.float32(1)
_HUGE = np.float32(1e30)
_PER_TURN = np.float32(0.5 / np.pi)
_ROUND = np.float32(12582912.0)  # 1.5 * 2**23: adding and subtracting it rounds to the nearest integer


@njit(**options)
def _all_differences(frames: Any, mean: Any, keep: Any, layout: Layout, out: Any) -> np.float32:
    part, level = _ONE, np.empty(frames.shape[2], np.float32)
    row = np.empty((layout.bits.size, frames.shape[2]), np.float32)
    for y in range(frames.shape[1]):
        part = differences(frames, y, mean[y], layout, row, level)
        for b in range(layout.bits.size):
            for x in range(level.size):
                out[b, y, x] = row[b, x] * keep[y, x]
    return part


@njit(**options)
def _orders(sums: Any, maps: Any, numbers: Any, rules: Any, out: Any) -> None:
    """Write the order of every window: its code's, made exact by its fringes' phase."""
    cosine, sine, count, background = maps
    part, factor, initial = numbers
    layout, scale = rules
    column = np.empty((layout.bits.size, 1), np.float32)
    for y in range(count.shape[0]):
        for x in range(count.shape[1]):
            n = count[y, x]
            if n < _LEAST_PX:
                out[y, x, windows.BEST], out[y, x, windows.SECOND] = _HUGE, _ZERO
                continue
            variance = (layout.noise_constant + layout.noise_slope * max(background[y, x], _ZERO)) / n
            for b in range(layout.bits.size):
                column[b, 0] = sums[b, y, x] / n
            position, half, margin, expected, _ = place(column, 0, np.sqrt(part * variance))
            c, s = cosine[y, x] / n, sine[y, x] / n
            here = fast_atan2(s, c) * _PER_TURN - initial
            coded = scale.first_turns + position * scale.turns_per_cell
            turns = here + ((coded - here + _ROUND) - _ROUND)
            soft2 = scale.soft2 + factor * variance / (c * c + s * s + np.float32(1e-12))
            beyond = max(abs(turns - coded) - half * scale.turns_per_cell, _ZERO)
            other = max(_ONE - abs(turns - coded) - half * scale.turns_per_cell, _ZERO)
            out[y, x, windows.TURNS] = turns
            out[y, x, windows.BEST] = beyond * beyond / soft2
            out[y, x, windows.SECOND] = min(other * other / soft2, (margin + expected) * (margin + expected))
            out[y, x, windows.MODULATION] = np.sqrt(c * c + s * s)


@dataclass(frozen=True)
class Viewer:
    """What windows say of a code and the fringes that it counts."""

    bits: BitFrames
    layout: Layout
    finest: Group
    noise: NoiseModel

    def __call__(
        self, frames: Array, parts: windows.Phasors, background: Float32Array, keep: Float32Array
    ) -> Float32Array:
        """Return the windows of a part of the image; see `correction.Evidence`."""
        shape = keep.shape
        differ = np.empty((len(self.bits.bits), *shape), np.float32)
        part = _all_differences(frames, background, keep, self.layout, differ)
        sums = np.stack([windows.summed(one) for one in differ])
        maps = (windows.summed(parts.cosine[-1]), windows.summed(parts.sine[-1]), windows.summed(keep), background)
        out = np.zeros((*shape, windows.WINDOW_VALUES), np.float32)
        out[..., windows.SLOPE_X], out[..., windows.SLOPE_Y] = windows.slopes_of(parts)
        out[..., windows.POWER] = windows.power_of(parts, maps[2])
        factor = np.float32(phase_variance_factor(self.finest.shifts_rad) / (2 * np.pi) ** 2)
        numbers = (np.float32(part), factor, np.float32(self.finest.initial_rad / (2 * np.pi)))
        _orders(sums, maps, numbers, (self.layout, ruler(self.bits.code, self.finest.period_px)), out)
        return out
