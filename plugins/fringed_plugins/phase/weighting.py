"""Weighted least squares: each frame of a pixel counts by what its own light says of its noise.

Owns one Gauss-Newton step from the unweighted solution, which is the best that frames with shot noise allow. It gives
up what equal weights have: frames in equal steps no longer cancel the projector's harmonics, so that it is for
fringes whose tone curve is compensated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.compiled import kept
from fringed_plugins.parallel import run_rows
from fringed_plugins.phase import level_kernel
from fringed_plugins.phase.level_kernel import BLOCK_PX, options
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group, transform

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]
_ZERO = np.float32(0)
_ONE = np.float32(1)
_TINY = np.float32(1e-12)


@njit(**options)
def _clear(rows: Any) -> None:
    for row in rows:
        for x in range(row.size):
            row[x] = _ZERO


@njit(**options)
def _fit(frames: Any, rows: Any, fit: Any) -> None:
    """Write the unweighted background, cosine and sine of a block into the three rows of `fit`."""
    light, cosine, sine = fit
    _clear(fit)
    for k in range(frames.shape[0]):
        frame, a, c, s = frames[k], rows[0, k], rows[1, k], rows[2, k]
        for x in range(frame.size):
            value = np.float32(frame[x])
            light[x] += a * value
            cosine[x] += c * value
            sine[x] += s * value


@njit(**options)
def _add(frame: Any, shift: Any, noise: Any, fit: Any, sums: Any) -> None:
    """Add one frame to the weighted normal equations, whose unknowns are light, modulation and modulation x phase."""
    cos_shift, sin_shift = shift
    constant, slope = noise
    light, cosine, sine = fit
    m00, m01, m02, m11, m12, m22, b0, b1, b2 = sums
    for x in range(frame.size):
        size = np.sqrt(cosine[x] * cosine[x] + sine[x] * sine[x] + _TINY)
        along = (cosine[x] * cos_shift - sine[x] * sin_shift) / size
        across = -(sine[x] * cos_shift + cosine[x] * sin_shift) / size
        expected = light[x] + size * along
        weight = _ONE / (constant + slope * (expected if expected > _ZERO else _ZERO))
        off = weight * (np.float32(frame[x]) - expected)
        m00[x] += weight
        m01[x] += weight * along
        m02[x] += weight * across
        m11[x] += weight * along * along
        m12[x] += weight * along * across
        m22[x] += weight * across * across
        b0[x] += off
        b1[x] += off * along
        b2[x] += off * across


@njit(**options)
def _solve(fit: Any, sums: Any, phase: Any, sigma: Any) -> None:
    """Correct the phase, and write its deviation."""
    _, cosine, sine = fit
    m00, m01, m02, m11, m12, m22, b0, b1, b2 = sums
    for x in range(phase.size):
        size = np.sqrt(cosine[x] * cosine[x] + sine[x] * sine[x] + _TINY)
        q01, q02 = m01[x] / m00[x], m02[x] / m00[x]  # light eliminated first, then modulation
        n11, n12 = m11[x] - q01 * m01[x], m12[x] - q01 * m02[x]
        c1 = b1[x] - q01 * b0[x]
        q12 = n12 / (n11 + _TINY)
        information = m22[x] - q02 * m02[x] - q12 * n12
        step = (b2[x] - q02 * b0[x] - q12 * c1) / (information + _TINY)
        phase[x] += step / size
        sigma[x] = np.sqrt(_ONE / (information + _TINY)) / size if not np.isnan(phase[x]) else phase[x]


@kept(level_kernel, **options)
def _weigh_blocks(start: int, stop: int, frames: Any, group: Any, noise: Any, out: Any) -> None:
    """Correct phases of blocks `start` to `stop`."""
    rows, shifts = group
    phase, sigma = out
    new = np.empty
    fit = (new(BLOCK_PX, np.float32), new(BLOCK_PX, np.float32), new(BLOCK_PX, np.float32))
    sums = (
        new(BLOCK_PX, np.float32), new(BLOCK_PX, np.float32), new(BLOCK_PX, np.float32),
        new(BLOCK_PX, np.float32), new(BLOCK_PX, np.float32), new(BLOCK_PX, np.float32),
        new(BLOCK_PX, np.float32), new(BLOCK_PX, np.float32), new(BLOCK_PX, np.float32),
    )  # fmt: skip
    for number in range(start, stop):
        a, b = number * BLOCK_PX, min((number + 1) * BLOCK_PX, phase.size)
        block = frames[:, a:b]
        _fit(block, rows, fit)
        _clear(sums)
        for k in range(frames.shape[0]):
            _add(block[k], (shifts[0, k], shifts[1, k]), noise, fit, sums)
        _solve(fit, sums, phase[a:b], sigma[a:b])


def weigh(
    phase_rad: Float32Array, sigma_rad: Float32Array, frames: Array, group: Group, noise: NoiseModel, threads: int = 0
) -> None:
    """Correct, in place, a least-squares phase of `group` by the noise that each frame's light has.

    `phase_rad` and `sigma_rad` are (height, width), C-ordered float32, NaN where dropped; `frames` (n, height, width)
    are those of the whole set. `sigma_rad` becomes the weighted solution's, at the Cramer-Rao bound of the noise model.

    References
    ----------
    Kay 1993, Fundamentals of statistical signal processing: estimation theory (weighted least squares, its bound).

    Examples
    --------
    >>> phase = np.float32([[0.0]])
    >>> sigma = np.float32([[0.0]])
    >>> group = Group((0, 1, 2, 3), tuple(np.arange(4) * np.pi / 2), 16.0)
    >>> light = np.array([190.0, 100.0, 10.0, 100.0]).reshape(4, 1, 1)
    >>> weigh(phase, sigma, light, group, NoiseModel(1.0, 0.0))
    >>> phase.round(6).item(), round(sigma.item() * 90, 4)
    (0.0, 0.7071)
    """
    stack = np.ascontiguousarray(frames[list(group.frames)])
    shifts = np.asarray(group.shifts_rad)
    rows = transform(group.shifts_rad)[:3].astype(np.float32)
    angles = np.stack([np.cos(shifts), np.sin(shifts)]).astype(np.float32)
    model = (np.float32(max(noise.constant_dn2, 1e-6)), np.float32(noise.slope_dn))
    flat = stack.reshape(len(stack), -1)
    out = (phase_rad.reshape(-1), sigma_rad.reshape(-1))
    if phase_rad.size:
        run_rows(_weigh_blocks, -(-phase_rad.size // BLOCK_PX), flat, (rows, angles), model, out, threads=threads)
