"""Whether every view tells of the same rig and the same board: what each one says of them by itself.

Owns which views deviate and why: the board's scale, the projector's place, points that are no board's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.solve.adjustment import Adjusted
from fringed_plugins.calibration.solve.causes import MOVED_DEG, MOVED_MM
from fringed_plugins.calibration.solve.findings import Finding
from fringed_plugins.calibration.solve.initial import middle_transform
from fringed_plugins.calibration.solve.observations import Observation, Rig, moved, rotation_vector
from fringed_plugins.calibration.solve.projection import POSE, STEREO, bias_px, predicted

Float64Array = npt.NDArray[np.float64]

_SIGMAS = 8.0
_BENT_PX = 1.0
_LEFT_OUT = 0.4  # share of a view's points that may be off before the view is
_WORSE = 4.0  # times the others' residuals
_EXPLAINED_PX = 0.3


def deviating(seen: Sequence[Observation], found: Adjusted) -> list[int]:
    """Return the views that do not fit with the others: many points left out, or residuals far above the others'."""
    rms, lost = [], []
    for v, part in enumerate(found.residuals):
        camera, projector = found.weights.camera_used[v], found.weights.projector_used[v]
        lit = max(int(seen[v].lit.sum()), 1)
        lost.append(max(1 - camera.mean(), 1 - projector.sum() / lit))
        every = [np.linalg.norm(part.camera, axis=1), np.linalg.norm(part.projector[seen[v].lit], axis=1)]
        rms.append([float(np.sqrt(np.mean(e**2))) if e.size else 0.0 for e in every])
    typical = np.maximum(np.median(rms, axis=0), 1e-6)
    limit = np.maximum(_WORSE * typical, 0.02)
    worse = [bool((np.array(own) > limit).any()) for own in rms]
    return [v for v in range(len(seen)) if lost[v] > _LEFT_OUT or (worse[v] and lost[v] > 0.05) or max(rms[v]) > 3.0]


def why(observed: Observation, rig: Rig) -> str:
    """Return why a view does not fit: a board of another size, a projector that moved, or something else."""
    pose = pose_of(observed, rig)
    off = predicted(observed, rig, pose, bias_px(observed, rig.camera, pose)).camera
    camera_px = float(np.sqrt(np.median((off**2).sum(axis=1))))
    if camera_px > _BENT_PX:
        return (
            f"its points are {camera_px:.1f} px (median) off a flat board's in the camera's picture: is it bent, did "
            "it move meanwhile, or is it another one?"
        )
    scale = _scale(observed, rig, pose)
    step, rms = _projector_moved(observed, rig, pose)
    angle, shift = float(np.degrees(np.linalg.norm(step[:3]))), float(np.linalg.norm(step[3:]))
    other_size = scale is not None and abs(scale[0] - 1) > max(5 * scale[1], 2e-4) and scale[2] < _EXPLAINED_PX
    moved_ = rms < _EXPLAINED_PX and (angle > MOVED_DEG or shift > MOVED_MM)
    if scale is not None and other_size and not (moved_ and rms < scale[2]):
        size = f"{abs(scale[0] - 1):.2%} {'larger' if scale[0] > 1 else 'smaller'}"
        return f"its board is {size} than that of the other views: another board, or another pitch"
    if moved_:
        return f"in it the projector stands elsewhere: turned by {angle:.2f} degrees, moved by {shift:.1f} mm"
    return "it fits neither the other views' rig nor their board: did something move while it was taken?"


def pose_of(observed: Observation, rig: Rig) -> Float64Array:
    """Return T_camera_board (4, 4) by the camera alone."""
    import cv2

    turn, shift = cv2.solvePnP(observed.board_mm, observed.camera_px, rig.camera.matrix, rig.camera.distortion)[1:]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(shift)
    return pose


def _scale(observed: Observation, rig: Rig, pose: Float64Array) -> tuple[float, float, float] | None:
    """Return the board's size over the stated one, its deviation, and what is left (px RMS); None where it diverges."""
    scale, deviation, rms = 1.0, np.inf, np.inf
    for _ in range(12):
        scaled = Observation(**{**observed.__dict__, "board_mm": observed.board_mm * scale})
        part = predicted(scaled, rig, pose, bias_px(scaled, rig.camera, pose))
        grown = (scaled.board_mm @ pose[:3, :3].T) / scale
        lit = observed.lit
        J, off = [], []
        for residual, by, use in (
            (part.camera, part.by_camera, np.ones_like(lit)),
            (part.projector, part.by_projector, lit),
        ):
            own = by[..., POSE]
            J.append(
                np.concatenate([own, np.einsum("nij,nj->ni", own[..., 3:], grown)[..., None]], -1)[use].reshape(-1, 7)
            )
            off.append(residual[use].ravel())
        every, left = np.concatenate(J), np.concatenate(off)
        step, *_ = np.linalg.lstsq(every, left, rcond=None)
        pose, scale = moved(pose, np.asarray(step[:6], np.float64)), scale + float(step[6])
        if not 0.2 < scale < 5:
            return None
        rms = float(np.sqrt(np.mean(left**2) * 2))
        deviation = rms * float(np.sqrt(np.linalg.pinv(every.T @ every)[6, 6]))
        if abs(step[6]) < 1e-9:
            break
    return scale, deviation, rms


def _projector_moved(observed: Observation, rig: Rig, pose: Float64Array) -> tuple[Float64Array, float]:
    """Return where the projector stands instead (6,), and what is left (px RMS)."""
    transform, lit = rig.T_projector_camera, observed.lit
    rms = np.inf
    for _ in range(15):
        now = rig.with_(T_projector_camera=transform)
        part = predicted(observed, now, pose, bias_px(observed, rig.camera, pose))
        J = part.by_projector[lit][..., STEREO].reshape(-1, 6)
        step, *_ = np.linalg.lstsq(J, part.projector[lit].ravel(), rcond=None)
        transform = moved(transform, np.asarray(step, np.float64))
        rms = float(np.sqrt(np.mean(part.projector[lit] ** 2) * 2)) if lit.any() else np.inf
        if np.linalg.norm(step[:3]) < 1e-10:
            break
    turn = rotation_vector(transform[:3, :3] @ rig.T_projector_camera[:3, :3].T)
    return np.concatenate([turn, transform[:3, 3] - rig.T_projector_camera[:3, 3]]), rms


def moved_between(seen: Sequence[Observation], transforms: Float64Array) -> list[Finding]:
    """Say where the rig moved: from one view on, T_projector_camera (v, 4, 4) of each view by itself is another one.

    One view alone that differs is none of this: it is left out instead.
    """
    middle = middle_transform(transforms)
    turn = np.array([np.degrees(rotation_vector(t[:3, :3] @ middle[:3, :3].T)) for t in transforms])
    shift = np.array([(t[:3, 3] - middle[:3, 3]) for t in transforms])
    splits = range(2, len(seen) - 1)
    steps = [(_step(turn, k), _step(shift, k)) for k in splits]
    if not steps:
        return []
    least = [max(min(pair[part][1] for pair in steps), 1e-9) for part in (0, 1)]
    best = min(range(len(steps)), key=lambda k: sum(steps[k][part][1] / least[part] for part in (0, 1)))
    (angle, angle_noise), (length, length_noise) = steps[best]
    if angle < max(_SIGMAS * angle_noise, MOVED_DEG) and length < max(_SIGMAS * length_noise, MOVED_MM):
        return []
    before, after = seen[splits[best] - 1].name, seen[splits[best]].name
    return [
        Finding(
            after,
            f"the rig moved between {before} and {after}: from there on the projector is turned by {angle:.2f} degrees "
            f"and moved by {length:.1f} mm against the camera; fix both, and take the views again",
            True,
        )
    ]


def _step(values: Float64Array, split: int) -> tuple[float, float]:
    """Return how far apart the two parts of `values` (v, 3) are, and the mean distance from their own middles."""
    parts = values[:split], values[split:]
    middles = [np.median(part, axis=0) for part in parts]
    off = np.concatenate([part - middle for part, middle in zip(parts, middles, strict=True)])
    return float(np.linalg.norm(middles[1] - middles[0])), float(np.mean(np.linalg.norm(off, axis=1)))
