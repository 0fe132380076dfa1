"""Kernels: the phase of one row of pixels to depths on their rays.

Owns the arithmetic of each model; `triangulate_kernel` calls it row by row. A camera ray is a straight line in the
projector's undistorted picture, so that the projector's distortion is a polynomial in one unknown: how far the ray's
point lies from where the phase is read. That is small, so float32 is exact enough for it; what it is added to, and the
last quotient, are float64.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
_options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}

STEREO, RATIONAL, POLYNOMIAL, HEIGHT = 0, 1, 2, 3


class Stereo(NamedTuple):
    """The projector's axis (`rig.Axis`), and how a phase is read as its normalised coordinate."""

    rotation: Float64Array  # (3, 3)
    translation: Float64Array  # (3,)
    distortion: Float64Array  # (5,)
    scale: float  # for one radian
    origin: float  # taken off
    steps: int  # of Newton's method


class PixelForm(NamedTuple):
    """A model of each pixel: `form` names it, STEREO where there is none; coefficients (k, height, width)."""

    form: int
    coefficients: Float32Array
    plane: Float64Array  # (4,) the reference plane's nx, ny, nz, d
    scale: float  # of p for one radian
    origin: float  # taken off


class Work(NamedTuple):
    """What the solution of a row needs on its way, float32 (width,)."""

    steep: Float32Array
    offset: Float32Array
    seen: Float32Array
    shift: Float32Array
    gain: Float32Array


@njit(**_options)
def new_work(width: int) -> Any:
    """Return room for one row."""
    return Work(
        np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32),
        np.empty(width, np.float32), np.empty(width, np.float32),
    )  # fmt: skip


@njit(**_options)
def solve_stereo(ray: Any, phase: Any, stereo: Any, work: Any, out: Any) -> None:
    """Write depth (mm) and its derivative by phase (mm/rad) of one row to `out`, both float32."""
    _epipolar_lines(ray, phase, stereo, work)
    for _ in range(stereo.steps):
        _newton(stereo.distortion, work)
    _depths(ray, phase, stereo, work, out)


@njit(**_options)
def _epipolar_lines(ray: Any, phase: Any, stereo: Any, work: Any) -> None:
    """Write each ray's line v = steep u + offset in the projector's picture, and the u that its phase reads."""
    rays_x, rays_y = ray
    r, t = stereo.rotation.astype(np.float32), stereo.translation.astype(np.float32)
    r00, r01, r02, r10, r11, r12 = r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2]
    r20, r21, r22, t0, t1, t2 = r[2, 0], r[2, 1], r[2, 2], t[0], t[1], t[2]
    scale, origin = stereo.scale, stereo.origin
    for i in range(phase.size):
        x, y = rays_x[i], rays_y[i]
        a = r00 * x + r01 * y + r02
        b = r10 * x + r11 * y + r12
        c = r20 * x + r21 * y + r22
        inverse = np.float32(1) / (a * t2 - t0 * c)
        work.steep[i] = (b * t2 - t1 * c) * inverse
        work.offset[i] = (a * t1 - b * t0) * inverse
        work.seen[i] = np.float32(np.float64(phase[i]) * scale - origin)
        work.shift[i] = np.float32(0)
        work.gain[i] = np.float32(1)


@njit(**_options)
def _newton(distortion: Any, work: Any) -> None:
    """Do one step for the shift from the distorted coordinate to the undistorted one, along the ray's line."""
    d = distortion.astype(np.float32)
    k1, k2, p1, p2, k3 = d[0], d[1], d[2], d[3], d[4]
    one, two, three, six = np.float32(1), np.float32(2), np.float32(3), np.float32(6)
    for i in range(work.shift.size):
        u = work.seen[i] + work.shift[i]
        v = work.steep[i] * u + work.offset[i]
        r2 = u * u + v * v
        radial = r2 * (k1 + r2 * (k2 + r2 * k3))
        twice = two * (k1 + r2 * (two * k2 + r2 * three * k3))
        off = u * radial + two * p1 * u * v + p2 * (three * u * u + v * v) + work.shift[i]
        by_u = one + radial + twice * u * u + two * p1 * v + six * p2 * u
        by_v = twice * u * v + two * p1 * u + two * p2 * v
        gain = by_u + work.steep[i] * by_v
        work.gain[i] = gain
        work.shift[i] -= off / gain


@njit(**_options)
def _depths(ray: Any, phase: Any, stereo: Any, work: Any, out: Any) -> None:
    rays_x, rays_y = ray
    depth, by_phase = out
    r, t = stereo.rotation, stereo.translation
    r00, r01, r02, r20, r21, r22 = r[0, 0], r[0, 1], r[0, 2], r[2, 0], r[2, 1], r[2, 2]
    t0, t2, scale, origin = t[0], t[2], stereo.scale, stereo.origin
    across, along, rise = np.float32(t0), np.float32(t2), np.float32(scale)
    for i in range(depth.size):
        x, y = np.float64(rays_x[i]), np.float64(rays_y[i])
        a = r00 * x + r01 * y + r02
        c = r20 * x + r21 * y + r22
        u = np.float64(phase[i]) * scale - origin + np.float64(work.shift[i])
        below = u * c - a
        depth[i] = np.float32((t0 - u * t2) / below)
        nearly = np.float32(below)
        by_phase[i] = rise * (along * np.float32(a) - across * np.float32(c)) / (nearly * nearly * work.gain[i])


@njit(**_options)
def solve_pixels(row: int, ray: Any, phase: Any, pixels: Any, out: Any) -> None:
    """Write depth, its derivative by phase, and of polynomials x and y over depth, of one row, by the pixels' model."""
    depth, by_phase, _, _ = out
    if pixels.form == RATIONAL:
        _rational(pixels.coefficients[:, row], phase, (pixels.scale, pixels.origin), depth, by_phase)
    elif pixels.form == HEIGHT:
        _heights(pixels.coefficients[:, row], phase, pixels, ray, (depth, by_phase))
    else:
        _polynomials(pixels.coefficients[:, row], phase, (pixels.scale, pixels.origin), out)


@njit(**_options)
def _rational(c: Any, phase: Any, reading: Any, depth: Any, by_phase: Any) -> None:
    scale, origin = reading
    rise = np.float32(scale)
    for i in range(depth.size):
        p = np.float32(np.float64(phase[i]) * scale - origin)
        below = np.float32(1) + c[2, i] * p
        depth[i] = (c[0, i] + c[1, i] * p) / below
        by_phase[i] = rise * (c[1, i] - c[0, i] * c[2, i]) / (below * below)


@njit(**_options)
def _heights(c: Any, phase: Any, pixels: Any, ray: Any, out: Any) -> None:
    rays_x, rays_y = ray
    depth, by_phase = out
    nx, ny, nz, d = pixels.plane[0], pixels.plane[1], pixels.plane[2], pixels.plane[3]
    rise = np.float32(pixels.scale)
    for i in range(depth.size):
        p = np.float64(phase[i]) * pixels.scale - pixels.origin
        difference = np.float32(p - np.float64(c[2, i]))
        below = difference + c[1, i]
        facing = np.float32(nx * rays_x[i] + ny * rays_y[i] + nz)
        depth[i] = (np.float32(d) + c[0, i] * difference / below) / facing
        by_phase[i] = rise * c[0, i] * c[1, i] / (below * below * facing)


@njit(**_options)
def _polynomials(c: Any, phase: Any, reading: Any, out: Any) -> None:
    depth, by_phase, over_x, over_y = out
    scale, origin = reading
    terms = c.shape[0] // 3
    rise = np.float32(scale)
    for i in range(depth.size):
        p = np.float32(np.float64(phase[i]) * scale - origin)
        x, y, z, slope = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        for k in range(terms - 1, -1, -1):
            slope = slope * p + z
            x = x * p + c[k, i]
            y = y * p + c[terms + k, i]
            z = z * p + c[2 * terms + k, i]
        depth[i], by_phase[i] = z, rise * slope
        over_x[i], over_y[i] = x / z, y / z
