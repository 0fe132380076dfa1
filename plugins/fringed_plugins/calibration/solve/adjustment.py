"""The bundle adjustment: both lenses, their places and every pose at once, by weighted least squares.

Owns the normal equations, the damping and the weights of points that do not fit. Poses are eliminated one by one
(Schur), so that its time grows with their number only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.rig import Pinhole
from fringed_plugins.calibration.solve.observations import Observation, Rig, moved
from fringed_plugins.calibration.solve.projection import (
    CAMERA,
    PROJECTOR,
    SHARED,
    STEREO,
    Predicted,
    bias_px,
    predicted,
)

Float64Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Tick = Callable[[float], None]

HUBER = 2.0  # deviations from which a point's weight falls
_ROUNDS, _STEPS = 6, 40
_SETTLED = 1e-10  # of the cost


@dataclass(frozen=True)
class Weights:
    """What counts: `free` (24,) numbers of the rig, factors on the deviations of both sides, and points of each pose.

    `camera_used` and `projector_used` are (n,) of each pose.
    """

    free: Bools
    camera_factor: float
    projector_factor: float
    camera_used: tuple[Bools, ...]
    projector_used: tuple[Bools, ...]


@dataclass(frozen=True)
class Adjusted:
    """A rig, the residuals of each pose, the covariance (24, 24) of its shared numbers, and how it ended.

    `information` (24, 24) is what the views tell of all shared numbers, whatever the poses are, free or not.
    """

    rig: Rig
    residuals: tuple[Predicted, ...]
    covariance: Float64Array
    weights: Weights
    iterations: int
    cost: float
    information: Float64Array


def all_used(seen: Sequence[Observation], free: Bools) -> Weights:
    """Return weights in which every point counts whose place is known."""
    return Weights(free, 1.0, 1.0, tuple(np.ones(len(o.board_mm), bool) for o in seen), tuple(o.lit for o in seen))


def free_numbers(*, camera_k3: bool, projector_k3: bool) -> Bools:
    """Return which of the 24 shared numbers are estimated."""
    free = np.ones(SHARED, bool)
    free[CAMERA.start + 8], free[PROJECTOR.start + 8] = camera_k3, projector_k3
    return free


def adjust(
    seen: Sequence[Observation], rig: Rig, weights: Weights, *, robust: bool, tick: Tick | None = None
) -> Adjusted:
    """Return the rig that explains the observations best; `rig` is where it begins.

    With `robust`, points count less the farther they are off (Huber). What perspective does to circles is worked out
    again in each round. `tick` is called between steps with how far it is, and may raise to stop.

    References
    ----------
    Triggs et al. 2000; Lavest et al. 1998 (the target and the camera at once); Zhang & Huang 2006.
    """
    cost, steps = np.inf, 0
    for round_ in range(_ROUNDS):
        biases = [bias_px(o, rig.camera, rig.poses[v]) for v, o in enumerate(seen)]
        before = cost
        rig, cost, taken = _descend(seen, rig, (weights, robust, biases), tick, round_ / _ROUNDS)
        steps += taken
        if round_ > 0 and abs(before - cost) <= 1e-8 * max(cost, 1e-300):
            break
    biases = [bias_px(o, rig.camera, rig.poses[v]) for v, o in enumerate(seen)]
    residuals = tuple(predicted(o, rig, rig.poses[v], biases[v]) for v, o in enumerate(seen))
    normal, _, poses, _ = _normal(seen, residuals, weights, robust)
    information = _without_poses(normal, poses)
    return Adjusted(rig, residuals, inverse_of(information, weights.free), weights, steps, cost, information)


def _descend(
    seen: Sequence[Observation], rig: Rig, how: tuple[Weights, bool, list[Float64Array]], tick: Tick | None, done: float
) -> tuple[Rig, float, int]:
    weights, robust, biases = how
    damping, steps = 1e-4, 0
    current = [predicted(o, rig, rig.poses[v], biases[v]) for v, o in enumerate(seen)]
    normal, right, poses, cost = _normal(seen, current, weights, robust)
    for steps in range(1, _STEPS + 1):  # noqa: B007  the count is returned
        if tick is not None:
            tick(done)
        step, pose_steps = _solve(normal, right, poses, weights.free, damping)
        tried = _stepped(rig, step, pose_steps)
        now = [predicted(o, tried, tried.poses[v], biases[v]) for v, o in enumerate(seen)]
        new = _normal(seen, now, weights, robust)
        if new[3] <= cost:
            settled = cost - new[3] <= _SETTLED * max(cost, 1e-300)
            rig, (normal, right, poses, cost) = tried, new
            damping = max(damping * 0.2, 1e-12)
            if settled:
                break
        else:
            damping *= 10
            if damping > 1e10:
                break
    return rig, cost, steps


def _normal(
    seen: Sequence[Observation], now: Sequence[Predicted], weights: Weights, robust: bool
) -> tuple[Float64Array, Float64Array, list[tuple[Float64Array, Float64Array, Float64Array]], float]:
    """Return the normal matrix and right side of the shared numbers, the poses' parts of both, and the cost."""
    normal, right, cost = np.zeros((SHARED, SHARED)), np.zeros(SHARED), 0.0
    poses = []
    for v, (observed, part) in enumerate(zip(seen, now, strict=True)):
        own, side = np.zeros((30, 30)), np.zeros(30)
        sigma = np.repeat(observed.camera_sigma_px[:, None], 2, axis=1) * weights.camera_factor
        lit = observed.projector_sigma_px * weights.projector_factor
        for off, by, spread, used in (
            (part.camera, part.by_camera, sigma, weights.camera_used[v]),
            (part.projector, part.by_projector, lit, weights.projector_used[v]),
        ):
            if not used.any():
                continue
            scaled = off[used] / spread[used]
            size = np.linalg.norm(scaled, axis=1)
            weight = np.minimum(1.0, HUBER / np.maximum(size, 1e-300)) if robust else np.ones(len(size))
            cost += float(np.sum(np.where(weight < 1, HUBER * (2 * size - HUBER), size**2) if robust else size**2))
            J = (by[used] / spread[used][..., None] * np.sqrt(weight)[:, None, None]).reshape(-1, 30)
            own += J.T @ J
            side += J.T @ (scaled * np.sqrt(weight)[:, None]).ravel()
        normal += own[:SHARED, :SHARED]
        right += side[:SHARED]
        poses.append((own[SHARED:, SHARED:], own[:SHARED, SHARED:], side[SHARED:]))
    if not np.isfinite(cost):
        cost = np.inf
    return normal, right, poses, cost


def _solve(
    normal: Float64Array, right: Float64Array, poses: list[tuple[Float64Array, Float64Array, Float64Array]],
    free: Bools, damping: float,
) -> tuple[Float64Array, Float64Array]:  # fmt: skip
    """Return the step of the shared numbers (24,) and of each pose (v, 6)."""
    shared = normal + damping * np.diag(np.diag(normal))
    side = right.copy()
    inverses = []
    for own, across, own_side in poses:
        inverse = np.linalg.inv(own + damping * np.diag(np.diag(own)) + 1e-12 * np.eye(6))
        shared -= across @ inverse @ across.T
        side -= across @ inverse @ own_side
        inverses.append(inverse)
    step = np.zeros(SHARED)
    step[free] = _scaled_solve(shared[np.ix_(free, free)], side[free])
    pose_steps = np.array([
        inverse @ (own_side - across.T @ step) for inverse, (_, across, own_side) in zip(inverses, poses, strict=True)
    ])  # fmt: skip
    return step, pose_steps.reshape(-1, 6)


def _scaled_solve(matrix: Float64Array, side: Float64Array) -> Float64Array:
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * scale[:, None] * scale
    try:
        return np.asarray(scale * np.linalg.solve(scaled, scale * side))
    except np.linalg.LinAlgError:
        return np.asarray(scale * np.linalg.lstsq(scaled, scale * side, rcond=None)[0])


def _stepped(rig: Rig, step: Float64Array, pose_steps: Float64Array) -> Rig:
    return Rig(
        lens_with(rig.camera, lens_numbers(rig.camera) + step[CAMERA]),
        lens_with(rig.projector, lens_numbers(rig.projector) + step[PROJECTOR]),
        moved(rig.T_projector_camera, step[STEREO]),
        np.array([moved(pose, own) for pose, own in zip(rig.poses, pose_steps, strict=True)]),
    )


def lens_numbers(lens: Pinhole) -> Float64Array:
    """Return fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    m = lens.matrix
    return np.array([m[0, 0], m[1, 1], m[0, 2], m[1, 2], *lens.distortion])


def lens_with(lens: Pinhole, numbers: Float64Array) -> Pinhole:
    """Return the lens with other numbers."""
    fx, fy, cx, cy = numbers[:4]
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return Pinhole(lens.width_px, lens.height_px, matrix, np.asarray(numbers[4:], np.float64).copy())


def _without_poses(normal: Float64Array, poses: list[tuple[Float64Array, Float64Array, Float64Array]]) -> Float64Array:
    reduced = normal.copy()
    for own, across, _ in poses:
        reduced -= across @ np.linalg.inv(own + 1e-12 * np.diag(np.diag(own)) + 1e-300 * np.eye(6)) @ across.T
    return reduced


def inverse_of(information: Float64Array, free: Bools) -> Float64Array:
    """Return the covariance (24, 24) that an information leaves; numbers that are held have none."""
    found = np.zeros_like(information)
    part = information[np.ix_(free, free)]
    scale = 1 / np.sqrt(np.maximum(np.diag(part), 1e-300))
    inverse = np.linalg.pinv(part * scale[:, None] * scale, rcond=1e-14, hermitian=True)
    found[np.ix_(free, free)] = inverse * scale[:, None] * scale
    return found
