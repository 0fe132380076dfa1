"""One pose of a board, and the projector is where it is again: a rig that was knocked, put right in the field.

Owns which numbers a single pose can tell: where the projector stands to the camera. Lenses are taken as they were.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.solve.adjustment import Adjusted, Weights, adjust, all_used
from fringed_plugins.calibration.solve.consistency import pose_of, why
from fringed_plugins.calibration.solve.estimate import refined
from fringed_plugins.calibration.solve.observations import Observation, Rig, rotation_vector
from fringed_plugins.calibration.solve.projection import SHARED, STEREO

Float64Array = npt.NDArray[np.float64]

_ACCEPTED_PX = 0.3


class Corrected(NamedTuple):
    """The rig put right, how far the projector had turned and moved, what is left, and how well it is known.

    `before_px` and `after_px` are the projector's residuals, RMS, with the old place and with the new one.
    `covariance` (6, 6) is that of the place if the lenses were known, `by_lenses` (6, 18) its derivatives by theirs.
    """

    rig: Rig
    turned_deg: float
    moved_mm: float
    before_px: float
    after_px: float
    covariance: Float64Array
    by_lenses: Float64Array

    def covariance_with(self, lenses: Float64Array) -> Float64Array:
        """Return the covariance (24, 24) of all numbers where that of the lenses is `lenses` (18, 18).

        The lenses are as uncertain as before, and what they are off by has moved the place along.
        """
        across = self.by_lenses @ lenses
        place = self.covariance + across @ self.by_lenses.T
        return np.block([[lenses, across.T], [across, place]])


def corrected(seen: Sequence[Observation], rig: Rig, *, accepted_px: float = _ACCEPTED_PX) -> Corrected:
    """Return the rig with the projector where the views say it is; `rig.poses` is not looked at.

    References
    ----------
    Schmidt 1966 (numbers that are not estimated, but are uncertain: consider covariance).

    Raises
    ------
    ValueError
        views that contradict the lenses, or too few points.
    """
    if not seen or min(int(o.lit.sum()) for o in seen) < 12:
        raise ValueError("a view with 12 points and more in both pictures is needed; take a pose in the middle")
    poses = np.array([pose_of(o, rig) for o in seen])
    begun = rig.with_(poses=poses)
    free = np.zeros(SHARED, bool)
    before = _rms(adjust(seen, begun, all_used(seen, free), robust=True))
    free[STEREO] = True
    found = adjust(seen, begun, all_used(seen, free), robust=True)
    weights = refined(seen, found)
    found = adjust(seen, found.rig, weights, robust=False)
    after, camera = _rms(found), _camera_rms(found, weights)
    if max(after, camera) > accepted_px:
        raise ValueError(
            f"the view contradicts the lenses: {camera:.2f} px RMS are left in the camera's picture, {after:.2f} in "
            f"the projector's, at most {accepted_px:g} are accepted; {why(seen[0], begun)}; calibrate anew"
        )
    old, new = rig.T_projector_camera, found.rig.T_projector_camera
    turn = float(np.degrees(np.linalg.norm(rotation_vector(new[:3, :3] @ old[:3, :3].T))))
    shift = float(np.linalg.norm(new[:3, :3].T @ new[:3, 3] - old[:3, :3].T @ old[:3, 3]))
    place = found.information[STEREO, STEREO]
    by_lenses = np.asarray(-np.linalg.solve(place, found.information[STEREO, : STEREO.start]), np.float64)
    return Corrected(found.rig, turn, shift, before, after, found.covariance[STEREO, STEREO], by_lenses)


def _rms(found: Adjusted) -> float:
    off = np.concatenate([part.projector[np.isfinite(part.projector).all(axis=1)] for part in found.residuals])
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _camera_rms(found: Adjusted, weights: Weights) -> float:
    off = np.concatenate([part.camera[used] for part, used in zip(found.residuals, weights.camera_used, strict=True)])
    return float(np.sqrt((off**2).sum(axis=1).mean())) if len(off) else float("inf")
