"""A board in a picture: its points, how good the view is, and why there are none.

Owns the order of the steps and the words for what is wrong; each step has a module of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.board_spec import BoardSpec, Detection, Limits
from fringed_plugins.calibration.detect.corners import find_corners
from fringed_plugins.calibration.detect.ellipses import Ellipses, find_ellipses
from fringed_plugins.calibration.detect.lattice import walk
from fringed_plugins.calibration.detect.matching import match
from fringed_plugins.calibration.detect.smooth import grid_residuals, tilt_deg

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

_STRAY, _STRAY_PX = 6.0, 0.05  # a point is none from so many deviations, and so many pixels, off its neighbours
_CORNER_PX = 0.04  # what OpenCV's corners are good to, at the least


def detect_board(
    picture: npt.NDArray[Any], spec: BoardSpec, *, saturated: npt.NDArray[np.bool_] | None = None,
    limits: Limits | None = None, threads: int = 0,
) -> Detection:  # fmt: skip
    """Return the board's points in `picture` (height, width) of any grey type, or the reason why there are none.

    `saturated` (height, width) marks the pixels that were too bright.

    Raises
    ------
    ValueError
        a picture that is no (height, width) array of numbers.
    """
    if picture.ndim != 2 or picture.dtype.kind not in "buif":
        raise ValueError(
            f"the picture has shape {picture.shape} and type {picture.dtype}; expected (height, width) grey"
        )
    image = np.ascontiguousarray(picture, dtype=np.float32)
    if min(image.shape) < 32:
        return Detection(False, f"the picture of {image.shape[1]} x {image.shape[0]} px is too small to show a board")
    finite = image[np.isfinite(image)]
    if finite.size < 0.01 * image.size or np.ptp(finite) < 1e-6 * max(1.0, float(np.abs(finite).max())):
        return Detection(False, "the picture is uniform: too dark, all too bright, or without a board")
    found = _circles(image, spec, threads) if spec.diameters_mm.any() else _corners(image, spec)
    return _judged(found, image, spec, (saturated, limits or Limits()))


def _circles(image: Float32Array, spec: BoardSpec, threads: int) -> Detection:
    ellipses = find_ellipses(image, spec.dark_marks, threads)
    if len(ellipses.px) < 4:
        marks = "dark" if spec.dark_marks else "light"
        return Detection(
            False,
            f"{len(ellipses.px)} {marks} circles are seen: no board, or one out of focus, too dark or too small",
            quality={"candidates": float(len(ellipses.px))},
        )
    big = _is_big(ellipses, spec)
    step = spec.pitch_mm / (np.sqrt(2) if spec.kind == "asymmetric-circles" else 1)
    radii = np.where(big, spec.diameters_mm.max(), spec.diameters_mm.min()) / 2
    lattice, known = walk(ellipses.px, ellipses.shape, step / radii)
    matched = match(lattice, known, big, spec, ellipses.px)
    quality = {"candidates": float(len(ellipses.px)), **_figures(ellipses.pick(known) if known.any() else ellipses)}
    if matched.reason:
        return Detection(False, matched.reason, quality=quality)
    chosen = np.flatnonzero(matched.index >= 0)
    chosen = chosen[np.argsort(matched.index[chosen])]
    own = ellipses.pick(chosen)
    long, short, angle = own.axes()
    return Detection(
        True, "", matched.index[chosen], own.px, own.sigma_px,
        np.column_stack([own.px, long, short, angle]), {**quality, **_figures(own)},
    )  # fmt: skip


def _is_big(ellipses: Ellipses, spec: BoardSpec) -> npt.NDArray[np.bool_]:
    """Return which marks are large beside their neighbours."""
    from scipy.spatial import cKDTree

    if not spec.big.any():
        return np.zeros(len(ellipses.px), bool)
    size = 1 / np.sqrt(ellipses.shape[:, 0] * ellipses.shape[:, 2] - ellipses.shape[:, 1] ** 2)
    _, near = cKDTree(ellipses.px).query(ellipses.px, k=min(10, len(size)))
    limit = np.sqrt(spec.diameters_mm.max() / spec.diameters_mm.min())
    return np.asarray(size > limit * np.median(size[near], axis=1))


def _figures(ellipses: Ellipses) -> dict[str, float]:
    long, short, _ = ellipses.axes()
    ground, mark = ellipses.ground, ellipses.mark
    with np.errstate(divide="ignore", invalid="ignore"):
        contrast = np.abs(ground - mark) / (np.abs(ground) + np.abs(mark))
    return {
        "blur_px": float(np.median(ellipses.blur_px)),
        "contrast": float(np.median(contrast)),
        "diameter_px": float(2 * np.median(np.sqrt(long * short))),
        "axis_ratio": float(np.median(short / long)),
    }


def _corners(image: Float32Array, spec: BoardSpec) -> Detection:
    low, high = np.nanpercentile(image, (0.5, 99.5))
    grey = np.clip((np.nan_to_num(image, nan=low) - low) * (255 / max(high - low, 1e-6)), 0, 255).astype(np.uint8)
    if not spec.dark_marks:
        grey = 255 - grey
    index, px = find_corners(grey, spec)
    if not len(index):
        whole = "; it has to be seen whole" if spec.kind == "chessboard" else ""
        return Detection(False, f"no {spec.kind} of {spec.columns} x {spec.rows} corners is seen{whole}")
    return Detection(True, "", index, px, np.full(len(px), _CORNER_PX))


def _judged(found: Detection, image: Float32Array, spec: BoardSpec, how: tuple[Any, Limits]) -> Detection:
    saturated, limits = how
    if not found.found:
        return found
    board = spec.points_mm[found.index, :2]
    radius = np.sqrt(found.ellipses[:, 2] * found.ellipses[:, 3]) if len(found.ellipses) else None
    residual = grid_residuals(board, found.px, radius)
    size = np.linalg.norm(residual, axis=1)
    typical = float(np.nanmedian(size)) if np.isfinite(size).any() else float("nan")
    stray = np.isfinite(size) & (size > _STRAY * typical + _STRAY_PX)
    kept = ~stray
    quality = dict(found.quality)
    quality |= {
        "found_share": float(kept.sum() / len(spec.points_mm)),
        "residual_px": typical,
        "strays": float(stray.sum()),
        "tilt_deg": tilt_deg(board[kept], found.px[kept], (image.shape[1], image.shape[0])),
        "turned_deg": _turned(board[kept], found.px[kept]),
        "coverage": _coverage(found.px[kept], image.shape),
        "saturated": _saturated(found.px[kept], saturated),
    }
    sigma = found.sigma_px[kept]
    if not spec.diameters_mm.any() and np.isfinite(typical):
        sigma = np.full(kept.sum(), max(_CORNER_PX / 2, typical / 1.18))
    reason, problems = _words(quality, int(kept.sum()), len(spec.points_mm), limits)
    ellipses = found.ellipses[kept] if len(found.ellipses) else found.ellipses
    return Detection(not reason, reason, found.index[kept], found.px[kept], sigma, ellipses, quality, problems)


def _words(quality: dict[str, float], points: int, every: int, limits: Limits) -> tuple[str, tuple[str, ...]]:
    """Return why the view is of no use, and what else is wrong with it."""
    problems = []
    if points < limits.min_points:
        return f"only {points} of {every} points are seen; at least {limits.min_points} are needed", ()
    if quality["tilt_deg"] > limits.max_tilt_deg:
        return (
            f"too oblique: tilted by {quality['tilt_deg']:.0f} degrees, at most {limits.max_tilt_deg:.0f} are useful",
            (),
        )
    if quality["saturated"] > limits.max_saturated:
        problems.append(
            f"saturated: {quality['saturated']:.1%} of the board's pixels, at most {limits.max_saturated:.1%}; shorten "
            "the exposure, or turn the board out of the glare"
        )
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
    if points < every:
        problems.append(f"cut or covered: {points} of {every} points are seen")
    return "", tuple(problems)


def _turned(board: Float64Array, px: Float64Array) -> float:
    """Return by how much the board is turned in the picture, degrees, 0 for upright."""
    if len(board) < 3:
        return float("nan")
    solution, *_ = np.linalg.lstsq(np.column_stack([board, np.ones(len(board))]), px, rcond=None)
    return float(np.degrees(np.arctan2(solution[0, 1], solution[0, 0])))


def _coverage(px: Float64Array, shape: tuple[int, ...]) -> float:
    import cv2

    if len(px) < 3:
        return 0.0
    return float(cv2.contourArea(cv2.convexHull(px.astype(np.float32))) / (shape[0] * shape[1]))


def _saturated(px: Float64Array, saturated: npt.NDArray[np.bool_] | None) -> float:
    import cv2

    if saturated is None or len(px) < 3:
        return 0.0
    inside = np.zeros(saturated.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.rint(cv2.convexHull(px.astype(np.float32))).astype(np.int32), 1)
    return float(saturated[inside > 0].mean()) if inside.any() else 0.0
