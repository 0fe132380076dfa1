"""Kernels of triangulation: phase to depth on each pixel's ray, then points, without flyers.

Owns the loops; `triangulate` prepares what they need. A camera ray is a straight line in the
projector's undistorted picture, so that the projector's distortion is a polynomial in one unknown:
Newton's method on it is exact to rounding after three steps.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

_OUT_OF_RANGE = np.uint16(16)
_DISCONTINUITY = np.uint16(64)
_LOW_MODULATION = np.uint16(2)
_NAN = np.float32(np.nan)
_ZERO = np.float32(0.0)
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


class Surfaces(NamedTuple):
    """From phase to projector pixel, and the depths that are kept; float64."""

    px_per_rad: float
    initial_rad: float
    near_mm: float
    far_mm: float


class Smoothness(NamedTuple):
    """What a point may differ from its neighbours' line; float32, lengths in pixels on the object."""

    per_depth: np.float32  # size of a pixel on the object over its depth
    bend_px: np.float32
    step_px: np.float32
    sigmas: np.float32  # of the prediction from two neighbours
    active: bool


@njit(**_options)
def _solve(rays: Any, phase: Any, axis: Any, surfaces: Any, depth: Any, slope: Any) -> None:
    """Write depth (mm) and its derivative by phase (mm/rad), of one row."""
    rays_x, rays_y = rays
    r, t = axis.rotation, axis.translation
    r00, r01, r02, r10, r11, r12 = r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2]
    r20, r21, r22, t0, t1, t2 = r[2, 0], r[2, 1], r[2, 2], t[0], t[1], t[2]
    k1, k2, p1, p2, k3 = (
        axis.distortion[0], axis.distortion[1], axis.distortion[2], axis.distortion[3], axis.distortion[4]
    )  # fmt: skip
    scale, origin = surfaces.px_per_rad / axis.focal_px, axis.centre_px / axis.focal_px
    for i in range(depth.size):
        x, y = np.float64(rays_x[i]), np.float64(rays_y[i])
        a = r00 * x + r01 * y + r02
        b = r10 * x + r11 * y + r12
        c = r20 * x + r21 * y + r22
        steep = (b * t2 - t1 * c) / (a * t2 - t0 * c)  # the ray's line in the projector's picture
        offset = (b - steep * a) / c if abs(c) > 1e-12 else (t1 - steep * t0) / t2
        target = (phase[i] - surfaces.initial_rad) * scale - origin
        u = target
        gain = 1.0
        for _ in range(3):
            v = steep * u + offset
            r2 = u * u + v * v
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            twice = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
            value = u * radial + 2 * p1 * u * v + p2 * (3 * u * u + v * v) - target
            by_u = radial + twice * u * u + 2 * p1 * v + 6 * p2 * u
            by_v = twice * u * v + 2 * p1 * u + 2 * p2 * v
            gain = by_u + steep * by_v
            u -= value / gain
        below = u * c - a
        depth[i] = (t0 - u * t2) / below
        slope[i] = (t2 * a - t0 * c) / (below * below) / gain * scale


@njit(**_options)
def depth_rows(start: int, stop: int, rays: Any, measured: Any, rig: Any, out: Any) -> None:
    """Write depth, its deviation along the ray and the mask of rows `start` to `stop`.

    `measured` is (phase, sigma, rejected), `rig` (axis, surfaces), `out` (depth, sigma_mm, rejected). The
    given sigma may be (0, 0): then the deviation is NaN.
    """
    depth, deviation, rejected = out
    phase, sigma, flags = measured
    axis, surfaces = rig
    width = phase.shape[1]
    z, by_phase = np.empty(width), np.empty(width)
    for row in range(start, stop):
        ray = (rays[0, row], rays[1, row])
        _solve(ray, phase[row], axis, surfaces, z, by_phase)
        known = sigma.shape[0] > 0
        given = (sigma[row] if known else phase[row], flags[row])
        _mask(ray, (z, by_phase), given, surfaces, (depth[row], deviation[row], rejected[row]))
        if not known:
            deviation[row] = _NAN


@njit(**_options)
def _mask(ray: Any, solved: Any, given: Any, surfaces: Any, out: Any) -> None:
    """Write what is kept of a row; a pixel off the range of depths is flagged."""
    rays_x, rays_y = ray
    z, by_phase = solved
    noise, flags = given
    depth, deviation, rejected = out
    for i in range(z.size):
        x, y = np.float64(rays_x[i]), np.float64(rays_y[i])
        inside = z[i] > surfaces.near_mm and z[i] < surfaces.far_mm
        lost = _OUT_OF_RANGE if flags[i] == 0 and not inside else np.uint16(0)
        kept = inside and flags[i] == 0
        depth[i] = np.float32(z[i]) if kept else _NAN
        length = np.sqrt(1 + x * x + y * y)
        deviation[i] = np.float32(abs(by_phase[i]) * length * noise[i]) if kept else _NAN
        rejected[i] = flags[i] | lost


@njit(**_options)
def _fits(z: Any, sigma: Any, near: Any, far: Any, smooth: Any, fits: Any) -> None:
    """Mark the pixels of a row that continue the line through two neighbours on one side."""
    for i in range(fits.size):
        size = smooth.per_depth * z[i]
        noise = sigma[i] if sigma[i] > _ZERO else _ZERO
        bend = abs(z[i] - near[i] - near[i] + far[i])
        step = abs(z[i] - near[i])
        alike = bend < smooth.bend_px * size + smooth.sigmas * noise
        alike = alike and step < smooth.step_px * size + smooth.sigmas * noise
        fits[i] = np.float32(1) if alike else fits[i]


@njit(**_options)
def point_rows(start: int, stop: int, rays: Any, seen: Any, smooth: Any, out: Any) -> None:
    """Write points and intensity of rows `start` to `stop`, dropping those that continue no surface.

    A point must continue the line through its two neighbours on one side along its row, and on one
    side along its column, and have a deviation of at most `most_mm`. `seen` is (depth, background, grey
    levels for one unit of background, most_mm), `out` (xyz, sigma_mm, rejected, intensity).
    """
    depth, background, scale, most_mm = seen
    xyz, sigma, rejected, intensity = out
    height, width = depth.shape
    along, across = np.ones(width, np.float32), np.ones(width, np.float32)
    for row in range(start, stop):
        if smooth.active:
            along[:] = _ZERO
            across[:] = _ZERO
            z, s = depth[row], sigma[row]
            if width > 2:
                _fits(z[2:], s[2:], z[1:], z, smooth, along[2:])
                _fits(z, s, z[1:], z[2:], smooth, along[: width - 2])
            if row >= 2:
                _fits(z, s, depth[row - 1], depth[row - 2], smooth, across)
            if row < height - 2:
                _fits(z, s, depth[row + 1], depth[row + 2], smooth, across)
        ray = (rays[0, row], rays[1, row])
        _write(ray, depth[row], (along, across, most_mm), xyz[row], (sigma[row], rejected[row]))
        for i in range(width):
            grey = background[row, i] * scale
            grey = grey if grey < np.float32(255) else np.float32(255)
            intensity[row, i] = np.uint8(grey + np.float32(0.5)) if grey > _ZERO else np.uint8(0)


@njit(**_options)
def _write(ray: Any, depth: Any, smooth: Any, xyz: Any, out: Any) -> None:
    rays_x, rays_y = ray
    along, across, most_mm = smooth
    sigma, rejected = out
    for i in range(depth.size):
        alone = along[i] * across[i] == _ZERO
        unsure = sigma[i] > most_mm
        flag = _DISCONTINUITY if alone else _LOW_MODULATION
        rejected[i] |= flag if (alone or unsure) and rejected[i] == 0 else np.uint16(0)
        z = _NAN if alone or unsure else depth[i]
        sigma[i] = _NAN if alone or unsure else sigma[i]
        xyz[i, 0] = rays_x[i] * z
        xyz[i, 1] = rays_y[i] * z
        xyz[i, 2] = z
