"""The stated deviation of a point against the scatter of points, over noise and over rigs that are drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fringe_truth import run, small_rig
from test_pixel_uncertainty import DEVIATIONS, moved, strong_rig
from test_triangulate import phase_map, pinhole, points, relief, turned

from fringed.errors import DataError
from fringed_plugins.calibration.pixel.derivatives import NUMBERS, point_derivatives
from fringed_plugins.calibration.pixel.spread import GRID, spread_table
from fringed_plugins.calibration.pixel.uncertainty import grid_pixels
from fringed_plugins.triangulation_plugin import Triangulate


def covariance_of(seed=3, size=1.0):
    """Return a covariance (24, 24) with correlations, and a root of it."""
    rng = np.random.default_rng(seed)
    root = size * DEVIATIONS[:, None] * (np.eye(24) + 0.4 * rng.normal(size=(24, 24)) / np.sqrt(24))
    return root @ root.T, root


@pytest.mark.parametrize("orientation", ["columns", "rows"])
def test_stated_deviation_is_the_scatter_over_noise_and_over_calibrations(orientation):
    calibration, rng = strong_rig(), np.random.default_rng(8)
    if orientation == "rows":
        calibration = turned(replace(calibration, projector=replace(calibration.projector, height_px=256)))
    covariance, root = covariance_of(size=0.1)
    stated = replace(calibration, covariance=covariance, parameters=NUMBERS)
    xyz = points(calibration, relief())
    phase = phase_map(calibration, xyz, orientation, sigma_rad=np.full(xyz.shape[:2], 0.004, np.float32))
    known = run(Triangulate, {"phase": phase, "calibration": stated}, keep_flyers=True)
    noise = run(Triangulate, {"phase": phase, "calibration": calibration}, keep_flyers=True)
    ray = xyz / np.linalg.norm(xyz, axis=2, keepdims=True)
    offs = []
    for _ in range(300):
        noisy = replace(phase, phase_rad=(phase.phase_rad + rng.normal(0, 0.004, xyz.shape[:2])).astype(np.float32))
        other = moved(calibration, root @ rng.normal(size=24))
        seen = run(Triangulate, {"phase": noisy, "calibration": other}, keep_flyers=True)
        offs.append(np.einsum("ijk,ijk->ij", seen.xyz_mm - xyz, ray))
    scatter = np.sqrt(np.mean(np.square(offs), axis=0))
    kept = (known.rejected == 0) & np.isfinite(scatter)
    ratio = (scatter / known.sigma_mm)[kept]
    assert kept.mean() > 0.95
    # Both parts count here; 300 draws leave 4 % of a deviation, in which a few directions of the covariance share.
    assert 1.1 < np.median((known.sigma_mm / noise.sigma_mm)[kept]) < 10
    assert abs(np.sqrt(np.mean(ratio**2)) - 1) < 0.06
    assert np.percentile(np.abs(ratio - 1), 90) < 0.10


@pytest.mark.parametrize("depth", [700.0, 900.0, 1000.0, 1100.0, 1300.0])
def test_table_says_what_the_derivatives_say(depth):
    calibration = strong_rig()
    covariance, _ = covariance_of()
    lenses = (pinhole(calibration.camera), pinhole(calibration.projector))
    table = spread_table(lenses, calibration.T_projector_camera, (covariance, NUMBERS), around_mm=1000.0)
    assert table.shape == (3, GRID[0], 160)
    pixels = grid_pixels(lenses[0], (GRID[0], 160))  # between the grid's columns too
    derivatives, _ = point_derivatives(*lenses, calibration.T_projector_camera, pixels, depth)
    xyz = points(calibration, 1.0)[np.round(pixels[:, 0, 1]).astype(int)]
    ray = xyz / np.linalg.norm(xyz, axis=-1, keepdims=True)
    along = np.einsum("ijk,ijkn->ijn", ray, derivatives)
    exact = np.sqrt(np.einsum("ijn,nm,ijm->ij", along, covariance, along))
    found = depth * np.sqrt((table[0] * depth + table[1]) * depth + table[2])
    assert np.abs(found / exact - 1).max() < 0.02


def test_deviation_of_the_calibration_drops_no_point():
    calibration = small_rig()
    covariance, _ = covariance_of(size=3.0)
    xyz = points(calibration, relief())
    phase = phase_map(calibration, xyz, sigma_rad=np.full(xyz.shape[:2], 1e-4, np.float32))
    stated = replace(calibration, covariance=covariance, parameters=NUMBERS)
    result = run(Triangulate, {"phase": phase, "calibration": stated})
    assert not result.rejected.any() and np.nanmin(result.sigma_mm) > 0.05
    assert run(Triangulate, {"phase": replace(phase, sigma_rad=None), "calibration": stated}).sigma_mm is None


def test_flyers_are_found_by_noise_and_not_by_the_calibrations_deviation():
    calibration = small_rig()
    covariance, _ = covariance_of(size=30.0)
    depth = relief()
    depth[60, 80] += 25.0
    phase = phase_map(calibration, points(calibration, depth))
    stated = replace(calibration, covariance=covariance, parameters=NUMBERS)
    plain = run(Triangulate, {"phase": phase, "calibration": calibration})
    result = run(Triangulate, {"phase": phase, "calibration": stated})
    assert result.rejected[60, 80] > 0
    assert (result.rejected == plain.rejected).all()


def test_covariance_that_cannot_be_used_is_refused():
    calibration = small_rig()
    phase = phase_map(calibration, points(calibration, relief()))
    for covariance, names, message in (
        (np.eye(1), ("camera.k7",), r"unknown parameters camera\.k7"),
        (np.array([[np.inf]]), ("camera.k1",), "not finite"),
    ):
        stated = replace(calibration, covariance=covariance, parameters=names)
        with pytest.raises(DataError, match=message):
            run(Triangulate, {"phase": phase, "calibration": stated})
