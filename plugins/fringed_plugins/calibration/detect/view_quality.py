"""How good a view of a board is: its figures, and the words for what is wrong with it.

Owns the figures that follow from the points found, and the limits' wording; a person reads it beside the board.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.board_spec import BoardSpec, Detection, Limits
from fringed_plugins.calibration.detect.smooth import grid_residuals, tilt_deg

Float64Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_STRAY, _STRAY_PX = 6.0, 0.05  # a point is none from so many deviations, and so many pixels, off its neighbours
_GLARE = 0.3  # share of the unseen points whose places are saturated


def judged(found: Detection, spec: BoardSpec, shape: tuple[int, int], saturated: Mask | None,
           limits: Limits) -> Detection:  # fmt: skip
    """Return a view without its strays, with its figures, and with what is wrong with it.

    `shape` is that of the picture, (height, width); `saturated` marks its pixels that were too bright.
    """
    board = spec.points_mm[found.index, :2]
    radius = np.sqrt(found.ellipses[:, 2] * found.ellipses[:, 3]) if len(found.ellipses) else None
    size = np.linalg.norm(grid_residuals(board, found.px, radius), axis=1)
    typical = float(np.nanmedian(size)) if np.isfinite(size).any() else float("nan")
    kept = ~(np.isfinite(size) & (size > _STRAY * typical + _STRAY_PX))
    px, board = found.px[kept], board[kept]
    quality = {
        **found.quality,
        "found_share": float(kept.sum() / len(spec.points_mm)),
        "residual_px": typical,
        "strays": float((~kept).sum()),
        "tilt_deg": tilt_deg(board, px, (shape[1], shape[0])),
        "turned_deg": _turned(board, px),
        "coverage": _coverage(px, shape),
        "saturated": _saturated(px, saturated),
    }
    reason, problems = _words(quality, int(kept.sum()), len(spec.points_mm), limits)
    if not reason:
        problems += _unseen(spec, found.index[kept], px, (shape, saturated))
    ellipses = found.ellipses[kept] if len(found.ellipses) else found.ellipses
    return replace(
        found, found=not reason, reason=reason, index=found.index[kept], px=px, sigma_px=found.sigma_px[kept],
        ellipses=ellipses, quality=quality, problems=problems,
    )  # fmt: skip


def marks_problems(quality: Mapping[str, float], limits: Limits) -> tuple[str, ...]:
    """Return what is wrong with the marks themselves: blur, size, contrast."""
    problems = []
    if quality.get("blur_px", 0.0) > limits.max_blur_px:
        problems.append(
            f"blurred: edges are {quality['blur_px']:.1f} px wide, at most {limits.max_blur_px:.1f}; hold the board "
            "still and within the depth of focus"
        )
    if quality.get("diameter_px", np.inf) < limits.min_diameter_px:
        problems.append(
            f"too small: circles are {quality['diameter_px']:.1f} px wide, at least {limits.min_diameter_px:.0f}; come "
            "closer, or use a board with larger circles"
        )
    if quality.get("contrast", 1.0) < limits.min_contrast:
        problems.append(
            f"low contrast: {quality['contrast']:.0%} of marks and ground, at least {limits.min_contrast:.0%}"
        )
    return tuple(problems)


def _words(quality: Mapping[str, float], points: int, every: int, limits: Limits) -> tuple[str, tuple[str, ...]]:
    """Return why the view is of no use, and what else is wrong with it."""
    if points < min(limits.min_points, every):
        return f"only {points} of {every} points are seen; at least {limits.min_points} are needed", ()
    if quality["tilt_deg"] > limits.max_tilt_deg:
        return (
            f"too oblique: tilted by {quality['tilt_deg']:.0f} degrees, at most {limits.max_tilt_deg:.0f} are useful",
            (),
        )
    problems = []
    if quality["saturated"] > limits.max_saturated:
        problems.append(
            f"saturated: {quality['saturated']:.1%} of the board's pixels, at most {limits.max_saturated:.1%}; shorten "
            "the exposure, or turn the board out of the glare"
        )
    return "", (*problems, *marks_problems(quality, limits))


def _unseen(
    spec: BoardSpec, index: npt.NDArray[np.int32], px: Float64Array, how: tuple[tuple[int, int], Mask | None]
) -> tuple[str, ...]:
    """Return where the points are that were not found: beyond an edge of the picture, in glare, or covered."""
    import cv2

    shape, saturated = how
    missing = np.setdiff1d(np.arange(len(spec.points_mm)), index)
    H: Any = cv2.findHomography(spec.points_mm[index, :2], px, cv2.LMEDS)[0] if len(missing) else None
    if H is None:
        return ()
    mapped = np.column_stack([spec.points_mm[missing, :2], np.ones(len(missing))]) @ H.T
    x, y = (mapped[:, :2] / mapped[:, 2:]).T
    room = 0.5 * float(np.median(_nearest(px)))  # a mark that touches the edge is cut as well
    beyond = {
        "left": x < room, "right": x > shape[1] - 1 - room, "upper": y < room, "lower": y > shape[0] - 1 - room,
    }  # fmt: skip
    outside = np.logical_or.reduce(list(beyond.values()))
    said = []
    if outside.any():
        edges = ", ".join(name for name, there in beyond.items() if there.any())
        said.append(f"cut by an edge of the picture ({edges}): {outside.sum()} of {len(spec.points_mm)} points")
    if not outside.all():
        inside = ~outside
        at = np.median(np.stack([x[inside], y[inside]], -1), axis=0)
        glare = False
        if saturated is not None:
            bright = saturated[np.rint(y[inside]).astype(int), np.rint(x[inside]).astype(int)]
            glare = float(bright.mean()) > _GLARE
        said.append(
            f"{'lost in glare' if glare else 'covered or not seen'}: {inside.sum()} of {len(spec.points_mm)} points, "
            f"around ({at[0]:.0f}, {at[1]:.0f}) px"
        )
    return tuple(said)


def _nearest(px: Float64Array) -> Float64Array:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(px).query(px, k=2)[0][:, 1])


def _turned(board: Float64Array, px: Float64Array) -> float:
    """Return by how much the board is turned in the picture, degrees, 0 for upright."""
    if len(board) < 3:
        return float("nan")
    slope, *_ = np.linalg.lstsq(np.column_stack([board, np.ones(len(board))]), px, rcond=None)
    return float(np.degrees(np.arctan2(slope[0, 1], slope[0, 0])))


def _coverage(px: Float64Array, shape: tuple[int, ...]) -> float:
    import cv2

    if len(px) < 3:
        return 0.0
    return float(cv2.contourArea(cv2.convexHull(px.astype(np.float32))) / (shape[0] * shape[1]))


def _saturated(px: Float64Array, saturated: Mask | None) -> float:
    import cv2

    if saturated is None or len(px) < 3:
        return 0.0
    inside = np.zeros(saturated.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.rint(cv2.convexHull(px.astype(np.float32))).astype(np.int32), 1)
    return float(saturated[inside > 0].mean()) if inside.any() else 0.0
