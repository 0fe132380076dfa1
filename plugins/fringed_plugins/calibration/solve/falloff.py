"""How both lenses darken towards the corners, from the paper of boards at known places.

Owns the model: what a matt paper sends back is the product of both lenses' falloff, the cosine towards the projector,
and one over the square of its distance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.rig import Pinhole
from fringed_plugins.calibration.solve.observations import Observation, Rig

Float64Array = npt.NDArray[np.float64]
_LEAST = 60


def falloffs(seen: Sequence[Observation], rig: Rig) -> tuple[Float64Array, Float64Array] | None:
    """Return the coefficients (1,) of r^2 of the camera and of the projector, None where too little light is known.

    r runs from the picture's centre, 1 at its corners: relative light is 1 + c r^2.
    """
    rows = []
    R, t = rig.T_projector_camera[:3, :3], rig.T_projector_camera[:3, 3]
    for observed, pose in zip(seen, rig.poses, strict=True):
        if not len(observed.light):
            continue
        points = observed.board_mm @ pose[:3, :3].T + pose[:3, 3]
        lit = points @ R.T + t
        facing = np.abs(np.einsum("ni,i->n", lit, R @ pose[:3, 2]))
        far = np.linalg.norm(lit, axis=1)
        good = (observed.light > 0) & observed.lit & (facing > 0)
        level = np.log(observed.light[good] * far[good] ** 3 / facing[good])
        rows.append(np.column_stack([
            level, _radius2(rig.camera, observed.camera_px[good]), _radius2(rig.projector, observed.projector_px[good]),
        ]))  # fmt: skip
    table = np.concatenate(rows) if rows else np.zeros((0, 3))
    return _fitted(table) if len(table) >= _LEAST else None


def _fitted(table: Float64Array) -> tuple[Float64Array, Float64Array]:
    from scipy.optimize import least_squares

    def off(p: Float64Array) -> Float64Array:
        bright = [np.log(np.maximum(1 + p[k] * table[:, k], 1e-3)) for k in (1, 2)]
        return np.asarray(table[:, 0] - p[0] - bright[0] - bright[1])

    found = least_squares(off, [float(np.median(table[:, 0])), 0.0, 0.0], loss="soft_l1", f_scale=0.02)
    return np.array([found.x[1]]), np.array([found.x[2]])


def _radius2(lens: Pinhole, px: Float64Array) -> Float64Array:
    """Return the square of the distance from the picture's centre, 1 at the corners."""
    half = np.array([lens.width_px, lens.height_px]) / 2
    centre = half - 0.5
    return np.asarray(((px - centre) ** 2).sum(axis=1) / (half**2).sum())
