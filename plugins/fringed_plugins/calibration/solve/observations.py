"""What each pose showed, and the rig that is to explain it, as estimation wants them.

Owns the types; knows nothing of how views are detected.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.rig import Pinhole

Float64Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Observation:
    """One pose of a board: `board_mm` (n, 3), `camera_px` (n, 2), `projector_px` (n, 2), NaN where unknown.

    Deviations: `camera_sigma_px` (n,), `projector_sigma_px` (n, 2). `radii_mm` (n,) are those of circles, whose
    ellipses' centres the pixels are; 0 for corners. `projector_jacobian` (n, 2, 2) has the derivatives of the
    projector's pixel by the camera's. `light` (n,), or (0,).
    """

    name: str
    board_mm: Float64Array
    camera_px: Float64Array
    projector_px: Float64Array
    camera_sigma_px: Float64Array
    projector_sigma_px: Float64Array
    projector_jacobian: Float64Array
    radii_mm: Float64Array
    light: Float64Array = field(default_factory=lambda: np.zeros(0))

    @property
    def lit(self) -> Bools:
        """The points (n,) whose projector pixel is known."""
        return np.asarray(np.isfinite(self.projector_px).all(axis=1))


@dataclass(frozen=True)
class Rig:
    """Both lenses, T_projector_camera (4, 4), and T_camera_board (v, 4, 4) of each pose."""

    camera: Pinhole
    projector: Pinhole
    T_projector_camera: Float64Array
    poses: Float64Array

    def with_(self, **changes: Any) -> Rig:
        """Return another rig."""
        return replace(self, **changes)


def exp_rotation(vector: Float64Array) -> Float64Array:
    """Return the rotation (3, 3) of a rotation vector (3,).

    Examples
    --------
    >>> exp_rotation(np.array([0.0, 0.0, np.pi / 2])).round(6).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def moved(transform: Float64Array, step: Float64Array) -> Float64Array:
    """Return a transform (4, 4) after a small step (6,): a rotation before its own, then a translation."""
    result = transform.copy()
    result[:3, :3] = exp_rotation(step[:3]) @ transform[:3, :3]
    result[:3, 3] = transform[:3, 3] + step[3:]
    return result


def rotation_vector(rotation: Float64Array) -> Float64Array:
    """Return the rotation vector (3,) of a rotation (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())
