"""Where the adjustment begins: each lens by itself, then where they stand to each other.

Owns the calls of OpenCV's calibration, which needs no start of its own, and the middle of what the poses say.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.rig import Pinhole
from fringed_plugins.calibration.solve.observations import Observation, Rig, rotation_vector

Float64Array = npt.NDArray[np.float64]
Size = tuple[int, int]

_LEAST_POINTS = 8


def initial_rig(seen: Sequence[Observation], camera_size: Size, projector_size: Size) -> tuple[Rig, Float64Array]:
    """Return a rig that is near enough for the adjustment, and T_projector_camera (v, 4, 4) by each view alone.

    References
    ----------
    Zhang 2000 (planes without known places); Zhang & Huang 2006 (the projector as an inverse camera).

    Raises
    ------
    ValueError
        views from which no lens can be told.
    """
    camera, camera_poses = _lens([(o.board_mm, o.camera_px) for o in seen], camera_size, "camera")
    lit = [(o.board_mm[o.lit], o.projector_px[o.lit]) for o in seen]
    projector, projector_poses = _lens(lit, projector_size, "projector")
    relative = projector_poses @ np.linalg.inv(camera_poses)
    return Rig(camera, projector, middle_transform(relative), camera_poses), relative


def _lens(pairs: list[tuple[Float64Array, Float64Array]], size: Size, name: str) -> tuple[Pinhole, Float64Array]:
    import cv2

    if min(len(points) for points, _ in pairs) < _LEAST_POINTS:
        raise ValueError(f"a view has fewer than {_LEAST_POINTS} points that the {name} sees")
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    focal = 1.5 * max(size)
    guess = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]])
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-9)
    boards = [points.astype(np.float32) for points, _ in pairs]
    pixels = [seen.astype(np.float32).reshape(-1, 1, 2) for _, seen in pairs]
    best = None
    for start in (guess, None):  # Zhang's closed form fails for some sets, a guess of the focal length for others
        try:
            found = cv2.calibrateCamera(
                boards, pixels, size, None if start is None else start.copy(), np.zeros(5),
                flags=flags if start is not None else cv2.CALIB_FIX_K3, criteria=criteria,
            )  # fmt: skip
        except cv2.error:
            continue
        if np.isfinite(found[0]) and (best is None or found[0] < best[0]):
            best = found
    if best is None:
        raise ValueError(f"no lens explains what the {name} sees in {len(pairs)} views: are they of one board?")
    _, matrix, distortion, turns, shifts = best
    poses = np.tile(np.eye(4), (len(pairs), 1, 1))
    for pose, turn, shift in zip(poses, turns, shifts, strict=True):
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(shift)
    return Pinhole(size[0], size[1], np.asarray(matrix, np.float64), np.ravel(distortion)[:5].astype(np.float64)), poses


def middle_transform(transforms: Float64Array) -> Float64Array:
    """Return the one of (v, 4, 4) that is nearest to all others, so that a few wrong ones do not matter."""
    scale = float(np.median(np.linalg.norm(transforms[:, :3, 3], axis=1))) or 1.0
    far = np.array([[_apart(a, b, scale) for b in transforms] for a in transforms])
    return np.asarray(transforms[int(np.argmin(np.median(far, axis=1)))])


def _apart(a: Float64Array, b: Float64Array, scale: float) -> float:
    turn = float(np.linalg.norm(rotation_vector(a[:3, :3].T @ b[:3, :3])))
    return turn + float(np.linalg.norm(a[:3, 3] - b[:3, 3])) / scale
