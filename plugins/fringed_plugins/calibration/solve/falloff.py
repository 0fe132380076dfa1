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
        given = facing[good] / far[good] ** 3
        rows.append(np.column_stack([
            np.log(observed.light[good]), given, _radius2(rig.camera, observed.camera_px[good]),
            _radius2(rig.projector, observed.projector_px[good]),
        ]))  # fmt: skip
    table = np.concatenate(rows) if rows else np.zeros((0, 4))
    return _fitted(table) if len(table) >= _LEAST else None


def _fitted(table: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Fit log(level) = log(a) + log(camera's) + log(projector's given + ambient); ambient light knows no projector."""
    from scipy.optimize import least_squares

    level, given = table[:, 0], table[:, 1] / np.median(table[:, 1])

    def off(p: Float64Array) -> Float64Array:
        camera, projector = (np.maximum(1 + c * table[:, k], 1e-3) for k, c in ((2, p[1]), (3, p[2])))
        return np.asarray(level - p[0] - np.log(camera) - np.log(projector * given + p[3]))

    start = [float(np.median(level)), 0.0, 0.0, 0.02]
    bounds = ([-np.inf, -0.95, -0.95, 0.0], [np.inf, 1.0, 1.0, 1.0])
    found = least_squares(off, start, bounds=bounds, loss="soft_l1", f_scale=0.02)
    return np.array([found.x[1]]), np.array([found.x[2]])


def _radius2(lens: Pinhole, px: Float64Array) -> Float64Array:
    """Return the square of the distance from the picture's centre, 1 at the corners."""
    half = np.array([lens.width_px, lens.height_px]) / 2
    centre = half - 0.5
    return np.asarray(((px - centre) ** 2).sum(axis=1) / (half**2).sum())
