"""What small windows of an image know of their fringe orders, where single pixels are too noisy to tell.

Owns the sums over 5 x 5 px and their orders; `correction` uses them. Inside a window a surface is taken for a plane:
the phasors of every period are added up, which leaves a fifth of the noise, and the orders of the sum follow from
all periods as those of a pixel do (`joint`). A window across a depth edge adds phasors that do not agree; its sum is
short, so that it loses against a window beside the edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.shifts import Group, transform
from fringed_plugins.phase.temporal.joint import Search, find_orders

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]

RADIUS = 2
_LEAST_PX = 9  # of 25: fewer are no window
_ZERO = np.float32(0)
_ONE = np.float32(1)
_PER_TURN = np.float32(0.5 / np.pi)
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


class Phasors(NamedTuple):
    """Sums of every period's frames, `(periods, height, width)` float32: C and S of `shifts`."""

    cosine: Float32Array
    sine: Float32Array


# What a window says, the last axis of (height, width, 7) float32: one place in memory for what is asked together.
TURNS = 0  # absolute phase of the finest period at the window's centre
SLOPE_X = 1  # its slope in turns per pixel, across
SLOPE_Y = 2  # ... and down
BEST = 3  # chi^2 of the order taken; huge where there is no window
SECOND = 4  # ... of the next one
MODULATION = 5  # of the finest period, averaged with its phase
POWER = 6  # mean square of the finest period's modulation, with its noise, whatever the phases are
WINDOW_VALUES = 7


@njit(**_options)
def _project(frame: Any, keep: Any, c: np.float32, s: np.float32, cosine: Any, sine: Any) -> None:
    for y in range(frame.shape[0]):
        values, mask, row_c, row_s = frame[y], keep[y], cosine[y], sine[y]
        for x in range(values.size):
            value = np.float32(values[x]) * mask[x]
            row_c[x] += c * value
            row_s[x] += s * value


def phasors(frames: Array, groups: Sequence[Group], keep: Float32Array) -> Phasors:
    """Return C and S of every group; nothing where `keep` (height, width) float32 is 0."""
    shape = (len(groups), *frames.shape[1:])
    out = Phasors(np.zeros(shape, np.float32), np.zeros(shape, np.float32))
    for g, group in enumerate(groups):
        rows = transform(group.shifts_rad)[1:3].astype(np.float32)
        for i, index in enumerate(group.frames):
            _project(frames[index], keep, rows[0, i], rows[1, i], out.cosine[g], out.sine[g])
    return out


@njit(**_options)
def _box(values: Any, line: Any, out: Any) -> None:
    """Write sums over 5 x 5 px; what is beyond the border counts nothing."""
    height = values.shape[0]
    for y in range(height):
        line[:] = _ZERO
        for row in range(max(0, y - RADIUS), min(height, y + RADIUS + 1)):
            source, target = values[row], line[RADIUS:]
            for x in range(source.size):
                target[x] += source[x]
        a, b, c, d, e, total = line, line[1:], line[2:], line[3:], line[4:], out[y]
        for x in range(total.size):
            total[x] = a[x] + b[x] + c[x] + d[x] + e[x]


def summed(values: Float32Array) -> Float32Array:
    """Return sums over 5 x 5 px."""
    out = np.empty_like(values)
    _box(values, np.empty(values.shape[1] + 2 * RADIUS, np.float32), out)
    return out


@njit(**_options)
def _steps(cosine: Any, sine: Any, across: Any, down: Any) -> None:
    """Write z(next) conj(z) to the right and down, `(2, height, width)`: its phase is the slope."""
    height, width = cosine.shape
    for y in range(height):
        below = min(y + 1, height - 1)
        c, s, right_c, right_s, low_c, low_s = (
            cosine[y],
            sine[y],
            cosine[y, 1:],
            sine[y, 1:],
            cosine[below],
            sine[below],
        )
        for x in range(width - 1):
            across[0, y, x] = right_c[x] * c[x] + right_s[x] * s[x]
            across[1, y, x] = right_s[x] * c[x] - right_c[x] * s[x]
        across[0, y, width - 1] = _ZERO
        across[1, y, width - 1] = _ZERO
        for x in range(width):
            down[0, y, x] = low_c[x] * c[x] + low_s[x] * s[x] if below > y else _ZERO
            down[1, y, x] = low_s[x] * c[x] - low_c[x] * s[x]


@njit(**_options)
def _polar(cosine: Any, sine: Any, count: Any, angle: Any, length: Any) -> None:
    """Write phase and length of the sums; the length is over sqrt(count), so that its noise is that of one pixel."""
    for y in range(cosine.shape[0]):
        for x in range(cosine.shape[1]):
            c, s, n = cosine[y, x], sine[y, x], count[y, x]
            angle[y, x] = fast_atan2(s, c)
            length[y, x] = np.sqrt((c * c + s * s) / (n if n > _ONE else _ONE))


@njit(**_options)
def _slopes(vector: Any, out: Any) -> None:
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            out[y, x] = fast_atan2(vector[1, y, x], vector[0, y, x]) * _PER_TURN


def slopes_of(parts: Phasors) -> tuple[Float32Array, Float32Array]:
    """Return the finest period's slope across and down in every window, in turns per pixel."""
    shape = parts.cosine.shape[1:]
    across, down = np.empty((2, *shape), np.float32), np.empty((2, *shape), np.float32)
    _steps(parts.cosine[-1], parts.sine[-1], across, down)
    slopes = (np.empty(shape, np.float32), np.empty(shape, np.float32))
    for vectors, slope in zip((across, down), slopes, strict=True):
        _slopes(np.stack([summed(vectors[0]), summed(vectors[1])]), slope)
    return slopes


def look(parts: Phasors, background: Float32Array, keep: Float32Array, search: Search) -> Float32Array:
    """Return what every window says; `background` is for the noise, `keep` 0 where a pixel is not to count."""
    count = summed(keep)
    shape = parts.cosine.shape
    angle, length = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for m in range(shape[0]):
        _polar(summed(parts.cosine[m]), summed(parts.sine[m]), count, angle[m], length[m])
    orders = find_orders(angle, length, background, search, threads=1)
    orders.best[count < _LEAST_PX] = np.inf
    modulation = np.asarray(length[-1] / np.sqrt(np.maximum(count, _ONE)), np.float32)
    slope_x, slope_y = slopes_of(parts)
    values = (orders.turns, slope_x, slope_y, orders.best, orders.second, modulation, power_of(parts, count))
    return np.stack(values, axis=-1)


def power_of(parts: Phasors, count: Float32Array) -> Float32Array:
    """Return the mean square of the finest period's modulation in every window; `count` is how many pixels it has."""
    both = summed(parts.cosine[-1] ** 2 + parts.sine[-1] ** 2)
    return np.asarray(both / np.maximum(count, _ONE), np.float32)
