"""The reference plane: what phase it has at every camera pixel, and heights above it.

Owns the prediction from a calibration, and the textbook formula for the ideal rig beside it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.rig import Axis, Pinhole, camera_rays

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]


def plane_depth(camera: Pinhole, plane: Float64Array, threads: int = 0) -> Float64Array:
    """Return the depth z (height, width) at which each pixel's ray meets `plane` (nx, ny, nz, d), n . X = d.

    NaN where it does not, or behind the camera.
    """
    rays = camera_rays(camera, threads)
    slope = plane[0] * rays[0].astype(np.float64) + plane[1] * rays[1] + plane[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = plane[3] / slope
    return np.where(depth > 0, depth, np.nan)


def phase_at_depth(
    camera: Pinhole, axis: Axis, fringes: tuple[float, float], depth_mm: npt.NDArray[Any], threads: int = 0
) -> Float64Array:
    """Return the absolute phase (rad) of points at `depth_mm` (height, width) on each pixel's ray.

    `fringes` is (period_px, initial_rad). Exact for both lenses' distortions.
    """
    return _phase_on_rays(camera_rays(camera, threads).astype(np.float64), axis, fringes, depth_mm)


def period_depth_mm(
    camera: Pinhole, axis: Axis, fringes: tuple[float, float], depth_mm: float, chosen: npt.NDArray[np.bool_]
) -> float:
    """Return how much depth (mm) one period stands for around `depth_mm`: the median of the `chosen` pixels.

    It takes one pixel of 64, unless that leaves none. NaN where nothing is chosen.
    """
    every = slice(None, None, 8)
    sparse = np.zeros_like(chosen)
    sparse[every, every] = chosen[every, every]
    rays = camera_rays(camera)[:, sparse if sparse.any() else chosen].astype(np.float64)
    if rays.size == 0:
        return float("nan")
    near, far = (_phase_on_rays(rays, axis, fringes, np.asarray(depth_mm * part)) for part in (0.9995, 1.0005))
    return float(np.median(2 * np.pi * 0.001 * depth_mm / np.abs(far - near)))


def _phase_on_rays(
    rays: Float64Array, axis: Axis, fringes: tuple[float, float], depth_mm: npt.NDArray[Any]
) -> Float64Array:
    r, t = axis.rotation, axis.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        w = 1 / np.asarray(depth_mm, np.float64)
        below = r[2, 0] * rays[0] + r[2, 1] * rays[1] + r[2, 2] + w * t[2]
        u = (r[0, 0] * rays[0] + r[0, 1] * rays[1] + r[0, 2] + w * t[0]) / below
        v = (r[1, 0] * rays[0] + r[1, 1] * rays[1] + r[1, 2] + w * t[1]) / below
    k1, k2, p1, p2, k3 = axis.distortion
    r2 = u * u + v * v
    distorted = u * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    pixel = axis.focal_px * distorted + axis.centre_px
    return np.asarray(pixel * (2 * np.pi / fringes[0]) + fringes[1])


def height_from_difference(
    difference_rad: npt.NDArray[Any], distance_mm: float, baseline_mm: float, frequency_per_mm: float
) -> npt.NDArray[Any]:
    """Return the height above the reference plane, in the ideal rig of the textbook formula.

    h = L dphi / (dphi + 2 pi f0 D): camera and projector side by side, `baseline_mm` apart and both
    `distance_mm` from the plane, pinholes, and fringes of `frequency_per_mm` on the plane. The sign of
    `difference_rad` is that for which heights are positive.

    References
    ----------
    thesis.md, section 3, eqs. 3.2-3.7; Takeda & Mutoh 1983.

    Examples
    --------
    >>> round(float(height_from_difference(np.array(2 * np.pi), 1000.0, 250.0, 0.1)), 3)
    38.462
    """
    return distance_mm * difference_rad / (difference_rad + 2 * np.pi * frequency_per_mm * baseline_mm)


def nearest_orders(
    difference_rad: Float32Array,
    regions: npt.NDArray[np.int32],
    expected_rad: Float32Array,
) -> Float32Array:
    """Return the multiple of 2 pi, for each region, that brings its difference nearest to what is expected.

    `regions` (height, width) numbers the regions from 1, 0 elsewhere. The result has one entry for each
    number, 0 first. A region with nothing expected keeps 0.
    """
    count = int(regions.max(initial=0))
    shifts = np.zeros(count + 1, np.float32)
    inside = (regions > 0) & np.isfinite(difference_rad) & np.isfinite(expected_rad)
    order = np.argsort(regions[inside], kind="stable")
    numbers = regions[inside][order]
    turns = ((expected_rad[inside] - difference_rad[inside]) / (2 * np.pi))[order]
    edges = np.searchsorted(numbers, np.arange(count + 2))
    for number in range(1, count + 1):
        part = turns[edges[number] : edges[number + 1]]
        if part.size:
            shifts[number] = 2 * np.pi * np.round(np.median(part))
    return shifts


def axes_crossing_mm(T_projector_camera: Float64Array) -> float:
    """Return the depth on the camera's optical axis that is nearest to the projector's optical axis.

    A rig is aimed there, so it is the best guess of where an object stands.

    Raises
    ------
    ValueError
        parallel axes, or a crossing behind the camera.
    """
    rotation, translation = T_projector_camera[:3, :3], T_projector_camera[:3, 3]
    across, ahead = rotation[2], np.array([0.0, 0.0, 1.0])
    centre = -rotation.T @ translation
    cosine = float(ahead @ across)
    if 1 - cosine**2 < 1e-9:
        raise ValueError("the optical axes of camera and projector are parallel; give the depth of the object instead")
    depth = float((centre @ ahead - cosine * (centre @ across)) / (1 - cosine**2))
    if depth <= 0:
        raise ValueError(f"the optical axes cross at {depth:.1f} mm, behind the camera; give the depth of the object")
    return depth
