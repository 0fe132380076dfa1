"""What a calibration's covariance leaves of points, against rigs that are drawn from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fringe_truth import distorted, projector_pixels, small_rig

from fringed_plugins.calibration.pixel.derivatives import NUMBERS, point_derivatives, undistorted
from fringed_plugins.calibration.pixel.uncertainty import grid_pixels, trueness_mm
from fringed_plugins.calibration.rig import Pinhole, camera_rays

STRONG = (np.array([-0.25, 0.12, 2e-3, -1e-3, 0.02]), np.array([-0.15, 0.05, 1e-3, -2e-3, 0.01]))
DEVIATIONS = np.array(
    [
        *(0.15, 0.15, 0.1, 0.1, 4e-4, 2e-3, 3e-5, 3e-5, 3e-3),
        *(0.2, 0.2, 0.15, 0.15, 8e-4, 4e-3, 5e-5, 5e-5, 6e-3),
        *(4e-5, 5e-5, 3e-5, 0.02, 0.02, 0.05),
    ]
)


def strong_rig():
    calibration = small_rig()
    lenses = (
        replace(lens, distortion=d) for lens, d in zip((calibration.camera, calibration.projector), STRONG, strict=True)
    )
    return replace(calibration, **dict(zip(("camera", "projector"), lenses, strict=True)))


def turned_by(vector):
    """Return the rotation of a rotation vector, as the series of the matrix exponential."""
    x, y, z = vector
    cross, term, total = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.eye(3), np.eye(3)
    for n in range(1, 12):
        term = term @ cross / n
        total = total + term
    return total


def moved(calibration, change):
    """Return the calibration with `change` (24,) added to its numbers, by their definition in the contract."""
    lenses = []
    for lens, part in ((calibration.camera, change[:9]), (calibration.projector, change[9:18])):
        matrix = lens.matrix + np.array([[part[0], 0, part[2]], [0, part[1], part[3]], [0, 0, 0]])
        lenses.append(replace(lens, matrix=matrix, distortion=lens.distortion + part[4:]))
    transform = calibration.T_projector_camera.copy()
    transform[:3, :3] = turned_by(change[18:21]) @ transform[:3, :3]
    transform[:3, 3] += change[21:]
    return replace(calibration, camera=lenses[0], projector=lenses[1], T_projector_camera=transform)


def rays_of(lens, pixels):
    """Return x and y of pixels (..., 2) by fixed-point iteration."""
    xy = (pixels - lens.matrix[:2, 2]) / np.diag(lens.matrix)[:2]
    for _ in range(30):
        xy = xy - (distorted(lens, xy) - pixels) / np.diag(lens.matrix)[:2]
    return xy


def points_on(calibration, pixels, depth):
    xy = rays_of(calibration.camera, pixels)
    return np.concatenate([xy * depth[..., None], depth[..., None]], -1)


def measured(calibration, pixels, wanted_px, axis, start_mm):
    """Return the points whose projector coordinate along `axis` is `wanted_px`, by the secant method."""
    rays = points_on(calibration, pixels, np.ones_like(start_mm))
    before, depth = start_mm - 1.0, start_mm.copy()
    off_before = projector_pixels(calibration, rays * before[..., None])[..., axis] - wanted_px
    for _ in range(6):
        off = projector_pixels(calibration, rays * depth[..., None])[..., axis] - wanted_px
        rise = off - off_before
        before, off_before, depth = depth, off, depth - off * (depth - before) / np.where(rise == 0, np.inf, rise)
    return rays * depth[..., None]


def pinhole(lens):
    return Pinhole(lens.width_px, lens.height_px, lens.matrix, lens.distortion)


def rig_of(calibration):
    return pinhole(calibration.camera), pinhole(calibration.projector), calibration.T_projector_camera


@pytest.mark.parametrize("orientation", ["columns", "rows"])
def test_derivatives_are_those_of_points_measured_again_with_another_rig(orientation):
    calibration, axis = strong_rig(), ("columns", "rows").index(orientation)
    if orientation == "rows":
        quarter = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        calibration = replace(calibration, T_projector_camera=quarter @ calibration.T_projector_camera @ quarter.T)
    pixels = np.array([[80.0, 60.0], [10.0, 8.0], [150.0, 100.0], [40.5, 110.25]])
    depth = np.array([1000.0, 950.0, 1050.0, 1010.0])
    found, seen = point_derivatives(*rig_of(calibration), pixels, depth, orientation=orientation)
    points = points_on(calibration, pixels, depth)
    assert np.abs(seen - projector_pixels(calibration, points)).max() < 1e-9
    for number, step in enumerate(DEVIATIONS * 0.1):
        change = np.eye(24)[number] * step
        ahead = measured(moved(calibration, change), pixels, seen[..., axis], axis, depth)
        behind = measured(moved(calibration, -change), pixels, seen[..., axis], axis, depth)
        numeric = (ahead - behind) / (2 * step)
        assert np.abs(found[..., number] - numeric).max() < 1e-5 * max(1.0, np.abs(numeric).max()), NUMBERS[number]


def test_stated_trueness_is_the_scatter_of_points_over_rigs_that_are_drawn():
    calibration, rng = strong_rig(), np.random.default_rng(3)
    mixing = np.eye(24) + 0.4 * rng.normal(size=(24, 24)) / np.sqrt(24)
    root = DEVIATIONS[:, None] * mixing
    covariance = root @ root.T
    stated = trueness_mm(*rig_of(calibration), covariance, NUMBERS, depths_mm=[950.0, 1050.0], grid=(3, 4))
    pixels = grid_pixels(pinhole(calibration.camera), (3, 4))
    for place, depth in enumerate((950.0, 1050.0)):
        start = np.full(pixels.shape[:2], depth)
        seen = projector_pixels(calibration, points_on(calibration, pixels, start))[..., 0]
        drawn = [
            measured(moved(calibration, root @ rng.normal(size=24)), pixels, seen, 0, start) for _ in range(400)
        ]  # fmt: skip
        ratio = np.std(drawn, axis=0) / stated[place]
        kept = np.isfinite(stated[place])
        assert kept.mean() > 0.5
        # 400 draws leave 3.5 % of a deviation; neighbours hang together, so that the mean is no better than that.
        assert np.abs(ratio[kept] - 1).max() < 0.15
        assert abs(np.mean(ratio[kept]) - 1) < 0.06


def test_order_and_absence_of_parameters_do_not_matter():
    rig = rig_of(strong_rig())
    names = ["stereo.ty", "view 3.rx", "camera.k1", "projector.cx"]
    covariance = np.diag([0.02, 5.0, 4e-4, 0.15]) ** 2
    order = [2, 3, 0]
    plain = trueness_mm(*rig, covariance, names, depths_mm=[1000.0])
    other = trueness_mm(*rig, covariance[np.ix_(order, order)], [names[i] for i in order], depths_mm=[1000.0])
    assert np.allclose(plain, other, equal_nan=True)
    full = (
        np.diag([{"stereo.ty": 0.02, "camera.k1": 4e-4, "projector.cx": 0.15}.get(name, 0.0) for name in NUMBERS]) ** 2
    )
    assert np.allclose(plain, trueness_mm(*rig, full, NUMBERS, depths_mm=[1000.0]), equal_nan=True)


def test_nothing_is_known_outside_the_projectors_picture():
    camera, projector, pose = rig_of(small_rig())
    narrow = replace(projector, width_px=projector.width_px // 2)
    found = trueness_mm(camera, narrow, pose, np.array([[0.01]]), ["stereo.tx"], depths_mm=[1000.0])
    assert np.isnan(found[0, :, -1]).all() and np.isfinite(found[0, 4, 1]).all()


def test_parameters_that_nobody_knows_are_refused():
    rig = rig_of(small_rig())
    with pytest.raises(ValueError, match=r"unknown parameters camera\.k9"):
        trueness_mm(*rig, np.eye(1), ["camera.k9"], depths_mm=[1000.0])
    with pytest.raises(ValueError, match=r"shape \(2, 2\), and 1 parameters"):
        trueness_mm(*rig, np.eye(2), ["camera.k1"], depths_mm=[1000.0])


def test_pixels_are_undistorted_and_told_where_they_cannot_be():
    lens = strong_rig().camera
    pixels = np.array([[0.0, 0.0], [159.0, 119.0], [80.0, 3.0]])
    assert np.abs(distorted(lens, undistorted(pinhole(lens), pixels)) - pixels).max() < 1e-8
    folded = Pinhole(160, 120, lens.matrix, np.array([-5.0, 0, 0, 0, 0]))
    assert np.isnan(undistorted(folded, np.array([[0.0, 0.0]]))).all()
    assert np.isnan(camera_rays(folded)[:, 0, 0]).all()
