"""What a rig says its camera and projector see of a board's points, with derivatives by every number.

Owns the residuals and their Jacobian for one pose: 9 numbers of each lens, 6 of the stereo pose, 6 of the board's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.bias import ellipse_centres
from fringed_plugins.calibration.pixel.derivatives import lens_derivatives
from fringed_plugins.calibration.rig import Pinhole
from fringed_plugins.calibration.solve.observations import Observation, Rig

Float64Array = npt.NDArray[np.float64]

CAMERA, PROJECTOR, STEREO, POSE = slice(0, 9), slice(9, 18), slice(18, 24), slice(24, 30)
SHARED = 24  # numbers of the rig; those of a pose come after them


class Predicted(NamedTuple):
    """Residuals (n, 2) px, observed minus predicted, of both lenses, and derivatives (n, 2, 30) of the prediction."""

    camera: Float64Array
    projector: Float64Array
    by_camera: Float64Array
    by_projector: Float64Array


def bias_px(seen: Observation, camera: Pinhole, pose: Float64Array) -> Float64Array:
    """Return what perspective adds to the centres (n, 2) px of a pose's circles; 0 for corners."""
    round_ = seen.radii_mm > 0
    bias = np.zeros((len(seen.board_mm), 2))
    if round_.any():
        points = seen.board_mm[round_] @ pose[:3, :3].T + pose[:3, 3]
        centres = ellipse_centres(points, pose[:3, 2], seen.radii_mm[round_], camera.matrix, camera.distortion)
        bias[round_] = centres - project(camera, points)
    return bias


def project(lens: Pinhole, points_mm: Float64Array) -> Float64Array:
    """Return the pixels (n, 2) of points (n, 3) in the lens's frame."""
    return lens_derivatives(lens, points_mm[:, :2] / points_mm[:, 2:])[0]


def predicted(seen: Observation, rig: Rig, pose: Float64Array, bias: Float64Array) -> Predicted:
    """Return the residuals of one pose; `bias` (n, 2) px is what perspective adds to the circles' centres.

    The projector was read at the ellipse's centre; its derivatives say what it is at the image of the circle's.
    """
    turned = seen.board_mm @ pose[:3, :3].T
    points = turned + pose[:3, 3]
    camera, by_point, by_lens = _seen(rig.camera, points)
    R = rig.T_projector_camera[:3, :3]
    lit_turned = points @ R.T
    lit = lit_turned + rig.T_projector_camera[:3, 3]
    projector, by_lit, by_projector_lens = _seen(rig.projector, lit)
    count = len(points)
    by_camera, by_projector = np.zeros((count, 2, 30)), np.zeros((count, 2, 30))
    by_camera[..., CAMERA] = by_lens
    by_camera[..., POSE] = _by_motion(by_point, turned)
    by_projector[..., PROJECTOR] = by_projector_lens
    by_projector[..., STEREO] = _by_motion(by_lit, lit_turned)
    by_projector[..., POSE] = _by_motion(by_lit @ R, turned)
    shift = np.einsum("nij,nj->ni", np.nan_to_num(seen.projector_jacobian), bias)
    return Predicted(seen.camera_px - bias - camera, seen.projector_px - shift - projector, by_camera, by_projector)


def _seen(lens: Pinhole, points: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return pixels (n, 2), their derivatives by the points (n, 2, 3) and by the lens's numbers (n, 2, 9)."""
    z = points[:, 2]
    xy = points[:, :2] / z[:, None]
    pixels, by_xy, by_lens = lens_derivatives(lens, xy)
    by_point = np.concatenate([by_xy, -np.einsum("nij,nj->ni", by_xy, xy)[..., None]], -1) / z[:, None, None]
    return pixels, by_point, by_lens


def _by_motion(by_point: Float64Array, turned: Float64Array) -> Float64Array:
    """Return derivatives (n, 2, 6) by a rotation before, and a translation of, points that were `turned` (n, 3)."""
    return np.concatenate([np.cross(turned[:, None, :], by_point), by_point], -1)
