"""Kernels of triangulation: phase to points, without flyers, in one pass over the rows.

Owns the loops; `triangulate` prepares what they need, `depth_kernel` has the models. Whether a point continues a
surface depends on two rows above and below, so that the last five rows of depths are kept in a ring.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.calibration import depth_kernel
from fringed_plugins.calibration.depth_kernel import POLYNOMIAL, STEREO, new_work, solve_pixels, solve_stereo
from fringed_plugins.compiled import kept

Float32Array = npt.NDArray[np.float32]

_OUT_OF_RANGE = np.uint16(16)
_DISCONTINUITY = np.uint16(64)
_LOW_MODULATION = np.uint16(2)
_NONE = np.uint16(0)
_NAN = np.float32(np.nan)
_ZERO = np.float32(0.0)
_RING = 5
_options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


class Keeping(NamedTuple):
    """Which points are kept; float32, lengths in pixels on the object."""

    near_mm: np.float32
    far_mm: np.float32
    most_mm: np.float32  # deviation by noise
    per_depth: np.float32  # size of a pixel on the object over its depth
    bend_px: np.float32
    step_px: np.float32
    sigmas: np.float32  # of the prediction from two neighbours
    active: bool


class Spread(NamedTuple):
    """Variance (mm^2) that a model leaves along the ray: `constant` + z^2 (c0 z^2 + c1 z + c2).

    c (3, n, width) holds for `n` rows evenly from the picture's first to its last one; n is 0 where there is none.
    """

    constant: np.float32
    coefficients: Float32Array


@njit(**_options)
def _solve(row: int, measured: Any, models: Any, room: Any) -> None:
    """Write depth and deviation by noise of a row, NaN where nothing is kept; of polynomials, x and y over depth."""
    rays, phase, sigma, flags = measured
    stereo, pixels, keeping = models
    work, depth, noise, over_x, over_y = room
    ray = (rays[0, row], rays[1, row])
    by_phase = noise  # its place serves twice
    if pixels.form == STEREO:
        solve_stereo(ray, phase[row], stereo, work, (depth, by_phase))
    else:
        solve_pixels(row, ray, phase[row], pixels, (depth, by_phase, over_x, over_y))
    if sigma.shape[0] > 0:
        _mask(ray, sigma[row], flags[row], keeping, (depth, noise))
    else:
        _mask(ray, phase[row], flags[row], keeping, (depth, noise))
        noise[:] = _NAN


@njit(**_options)
def _mask(ray: Any, sigma: Any, flags: Any, keeping: Any, out: Any) -> None:
    rays_x, rays_y = ray
    depth, noise = out
    for i in range(depth.size):
        x, y, z = rays_x[i], rays_y[i], depth[i]
        is_kept = z > keeping.near_mm and z < keeping.far_mm and flags[i] == _NONE
        length = np.sqrt(np.float32(1) + x * x + y * y)
        depth[i] = z if is_kept else _NAN
        noise[i] = abs(noise[i]) * length * sigma[i] if is_kept else _NAN


@njit(**_options)
def _allow(depth: Any, noise: Any, keeping: Any, allowed: Any) -> None:
    """Write how far the points of a row may bend and step."""
    bend, step = allowed
    for i in range(depth.size):
        size = keeping.per_depth * depth[i]
        unsure = keeping.sigmas * (noise[i] if noise[i] > _ZERO else _ZERO)
        bend[i] = keeping.bend_px * size + unsure
        step[i] = keeping.step_px * size + unsure


@njit(**_options)
def _fits(z: Any, one: Any, other: Any, allowed: Any, fits: Any) -> None:
    """Write 1 where a row continues the line through its two neighbours on the one side or the other, else 0."""
    near, far = one
    next_, last = other
    bend, step = allowed
    for i in range(fits.size):
        rise, fall = z[i] - near[i], z[i] - next_[i]
        alike = (abs(rise - near[i] + far[i]) < bend[i]) & (abs(rise) < step[i])
        alike |= (abs(fall - next_[i] + last[i]) < bend[i]) & (abs(fall) < step[i])
        fits[i] = np.float32(1) if alike else _ZERO


@njit(**_options)
def _judge(row: int, height: int, depth: Any, noise: Any, keeping: Any, room: Any) -> None:
    """Write whether the points of a row continue a surface along it and across it: 1, else 0.

    A point must continue the line through its two neighbours on one side along its row, and on one side along its
    column. `depth` and `noise` are rings of rows.
    """
    along, across, bend, step = room
    z, n = depth[row % _RING], depth.shape[1]
    _allow(z, noise[row % _RING], keeping, (bend, step))
    along[:] = _ZERO
    if n > 4:
        _fits(z[2:], (z[1:], z), (z[3:], z[4:]), (bend[2:], step[2:]), along[2 : n - 2])
    if n > 2:
        right, left = (z[1:], z[2:]), (z[n - 3 :], z[n - 4 :]) if n > 3 else (z[1:], z)
        _fits(z, right, right, (bend, step), along[: min(2, n - 2)])
        start = max(2, n - 2)
        _fits(z[start:], left, left, (bend[start:], step[start:]), along[start:])
    above = (depth[(row - 1) % _RING], depth[(row - 2) % _RING])
    below = (depth[(row + 1) % _RING], depth[(row + 2) % _RING])
    if row >= 2 and row < height - 2:
        _fits(z, above, below, (bend, step), across)
    elif row >= 2:
        _fits(z, above, above, (bend, step), across)
    elif row < height - 2:
        _fits(z, below, below, (bend, step), across)
    else:
        across[:] = _ZERO


@njit(**_options)
def _drop(solved: Any, flags: Any, keeping: Any, out: Any) -> None:
    """Write deviations and masks of a row, and take the points that continue no surface or are unsure out of it.

    Loops of one thing each, which the compiler turns into vectors.
    """
    depth, noise, along, across = solved
    sigma, rejected = out
    for i in range(depth.size):
        alone = along[i] * across[i] == _ZERO
        flag = _LOW_MODULATION if noise[i] > keeping.most_mm else _NONE
        flag = _DISCONTINUITY if alone else flag
        flag = flag if depth[i] == depth[i] else _OUT_OF_RANGE
        rejected[i] = flag if flags[i] == _NONE else flags[i]
    for i in range(depth.size):
        dropped = (along[i] * across[i] == _ZERO) | (noise[i] > keeping.most_mm)
        along[i] = _NAN if dropped else depth[i]  # it has been read, and serves as the depth that is left
        sigma[i] = _NAN if dropped else noise[i]


@njit(**_options)
def _place(over_x: Any, over_y: Any, depth: Any, xyz: Any) -> None:
    """Write the points of a row to `xyz` (3 width,)."""
    for i in range(depth.size):
        z = depth[i]
        xyz[3 * i] = over_x[i] * z
        xyz[3 * i + 1] = over_y[i] * z
        xyz[3 * i + 2] = z


@njit(**_options)
def _widen(place: float, spread: Any, depth: Any, sigma: Any) -> None:
    """Add what the model leaves to the deviations of a row, `place` of the way (0 to 1) down the picture."""
    last = spread.coefficients.shape[1] - 1
    if last < 1 and spread.constant == _ZERO:
        return
    if last < 1:
        for i in range(sigma.size):
            sigma[i] = np.sqrt(sigma[i] * sigma[i] + spread.constant)
        return
    above = min(int(place * last), last - 1)
    part = np.float32(place * last - above)
    c = spread.coefficients
    for i in range(sigma.size):
        c0 = c[0, above, i] + part * (c[0, above + 1, i] - c[0, above, i])
        c1 = c[1, above, i] + part * (c[1, above + 1, i] - c[1, above, i])
        c2 = c[2, above, i] + part * (c[2, above + 1, i] - c[2, above, i])
        z = depth[i]
        variance = spread.constant + z * z * (z * (c0 * z + c1) + c2)
        variance = variance if variance > _ZERO else _ZERO
        sigma[i] = np.sqrt(sigma[i] * sigma[i] + variance)


@njit(**_options)
def _light(background: Any, scale: Any, intensity: Any) -> None:
    for i in range(intensity.size):
        grey = background[i] * scale
        grey = grey if grey < np.float32(255) else np.float32(255)
        intensity[i] = np.uint8(grey + np.float32(0.5)) if grey > _ZERO else np.uint8(0)


@kept(depth_kernel, **_options)
def point_rows(start: int, stop: int, measured: Any, models: Any, seen: Any, out: Any) -> None:
    """Write points, deviations, masks and intensity of rows `start` to `stop`.

    `measured` is (rays, phase, sigma, rejected), sigma (0, 0) where unknown: then deviations are NaN. `models` is
    (stereo, pixels, keeping), `seen` (background, grey levels for one unit of background, spread), `out` (xyz of shape
    (height, 3 width), sigma_mm, rejected, intensity). Background may be (0, 0).
    """
    background, scale, spread = seen
    rays, _, noise_rad, flags = measured
    _, pixels, keeping = models
    xyz, sigma, rejected, intensity = out
    height, width = rejected.shape
    depth, noise = np.empty((_RING, width), np.float32), np.empty((_RING, width), np.float32)
    over_x, over_y = np.empty((_RING, width), np.float32), np.empty((_RING, width), np.float32)
    along, across = np.empty(width, np.float32), np.empty(width, np.float32)
    bend, step = np.empty(width, np.float32), np.empty(width, np.float32)
    work = new_work(width)
    for ahead in range(max(0, start - 2), stop + 2):
        k = ahead % _RING
        if ahead < height:
            _solve(ahead, measured, models, (work, depth[k], noise[k], over_x[k], over_y[k]))
        row = ahead - 2
        if row < start:
            continue
        k = row % _RING
        along[:] = np.float32(1)
        across[:] = np.float32(1)
        if keeping.active:
            _judge(row, height, depth, noise, keeping, (along, across, bend, step))
        _drop((depth[k], noise[k], along, across), flags[row], keeping, (sigma[row], rejected[row]))
        if pixels.form == POLYNOMIAL:
            _place(over_x[k], over_y[k], along, xyz[row])
        else:
            _place(rays[0, row], rays[1, row], along, xyz[row])
        if noise_rad.shape[0] > 0:
            _widen(row / max(height - 1, 1), spread, depth[k], sigma[row])
        if background.shape[0] > 0:
            _light(background[row], scale, intensity[row])
        else:
            intensity[row] = np.uint8(0)


@kept(depth_kernel, **_options)
def depth_rows(start: int, stop: int, measured: Any, models: Any, out: Any) -> None:
    """Write depths and deviations by noise (mm) of rows `start` to `stop` to `out`, flyers and all."""
    depth, noise = out
    width = depth.shape[1]
    over_x, over_y = np.empty(width, np.float32), np.empty(width, np.float32)
    work = new_work(width)
    for row in range(start, stop):
        _solve(row, measured, models, (work, depth[row], noise[row], over_x, over_y))
