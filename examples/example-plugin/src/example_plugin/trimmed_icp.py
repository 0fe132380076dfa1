"""Trimmed ICP: point to point, with the better part of the pairs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta
from scipy.spatial import cKDTree

from fringed import hookspecs
from fringed.data import IterationRecord, RangeImage, Registration
from fringed.errors import DataError
from fringed.hookspecs import Context


class TrimmedIcpParams(hookspecs.Params, frozen=True, kw_only=True):
    """Parameters."""

    overlap: Annotated[float, Meta(gt=0, le=1, description="part of the pairs that is trusted")] = 0.7
    points: Annotated[int, Meta(ge=100, le=1_000_000, description="control points of the model")] = 4000
    iterations: Annotated[int, Meta(ge=1, le=10_000, description="most iterations")] = 60
    tolerance_mm: Annotated[
        float, Meta(gt=0, le=10, description="motion at which it stops", extra_json_schema={"units": "mm"})
    ] = 1e-3


class TrimmedIcp:
    """Move the model onto the reference by point-to-point ICP on the best pairs.

    It starts where the views are, so they must lie within some ten degrees of each other.

    References
    ----------
    Chetverikov, Svirko, Stepanov, Krsek 2002 (trimmed ICP); Arun, Huang, Blostein 1987 (rigid motion).
    """

    name: ClassVar[str] = "trimmed-icp"
    version: ClassVar[str] = "0.1.0"
    summary: ClassVar[str] = "point-to-point ICP on the better part of the pairs"
    inputs: ClassVar[Mapping[str, Any]] = {"reference": RangeImage, "model": RangeImage}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Registration
    Params: ClassVar[type[hookspecs.Params]] = TrimmedIcpParams

    def run(self, inputs: Mapping[str, Any], params: TrimmedIcpParams, context: Context) -> Registration:
        """Return T_reference_model with its history; raise DataError for views with too few points."""
        reference, model = (_points(inputs, name) for name in ("reference", "model"))
        control = model[:: max(1, len(model) // params.points)]
        tree, transform, history = cKDTree(reference), np.eye(4), []
        converged, rms_mm = False, float("inf")
        for number in range(params.iterations):
            context.progress(number / params.iterations, f"iteration {number}")
            moved = control @ transform[:3, :3].T + transform[:3, 3]
            distance, index = tree.query(moved)
            best = np.argsort(distance, kind="stable")[: max(6, int(params.overlap * len(moved)))]
            step = rigid_motion(reference[index[best]], moved[best])
            transform = step @ transform
            rms_mm = float(np.sqrt(np.mean(distance[best] ** 2)))
            shift = np.linalg.norm(moved[best] @ step[:3, :3].T + step[:3, 3] - moved[best], axis=1).max()
            turn = float(np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1)))
            history.append(
                IterationRecord(
                    rms_mm, len(best), float(distance[best].max()), turn, float(np.linalg.norm(step[:3, 3])), "trimmed"
                )
            )
            if shift < params.tolerance_mm:
                converged = True
                break
        reason = "no point moves any more" if converged else f"still moving after {params.iterations} iterations"
        return Registration(
            reference=inputs["reference"].id,
            model=inputs["model"].id,
            T_reference_model=transform,
            converged=converged,
            reason=reason,
            rms_mm=rms_mm,
            overlap=params.overlap,
            history=tuple(history),
        )


def rigid_motion(target: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Return the (4, 4) motion that takes `source` (n, 3) onto `target` in the least-squares sense."""
    target_mean, source_mean = target.mean(axis=0), source.mean(axis=0)
    left, _, right = np.linalg.svd((target - target_mean).T @ (source - source_mean))
    rotation = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, target_mean - rotation @ source_mean
    return motion


def _points(inputs: Mapping[str, Any], name: str) -> np.ndarray:
    view = inputs.get(name)
    if not isinstance(view, RangeImage):
        raise DataError(f"trimmed-icp takes the range image {name!r}, not {type(view).__name__}")
    points = view.xyz_mm[view.rejected == 0].astype(np.float64)
    if len(points) < 100:
        raise DataError(f"the {name} has {len(points)} points; trimmed-icp needs at least 100")
    return points
