"""A board in a picture: its points, how good the view is, and why there are none.

Owns the order of the steps; each step has a module of its own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.board_spec import BoardSpec, Detection, Limits
from fringed_plugins.calibration.detect.corners import find_corners
from fringed_plugins.calibration.detect.ellipses import LEAST_PX, Ellipses, find_ellipses
from fringed_plugins.calibration.detect.lattice import walk
from fringed_plugins.calibration.detect.matching import match
from fringed_plugins.calibration.detect.nothing import why_nothing
from fringed_plugins.calibration.detect.view_quality import judged, marks_problems

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_LEAST_PX = 32  # side of a picture
_SMALLEST_PX = 2 * LEAST_PX
_OTHER = 9  # marks of the other polarity that are no chance


def detect_board(
    picture: npt.NDArray[Any], spec: BoardSpec, *, saturated: Mask | None = None, limits: Limits | None = None,
    threads: int = 0,
) -> Detection:  # fmt: skip
    """Return the board's points in `picture` (height, width) of any grey type, or the reason why there are none.

    `saturated` (height, width) marks the pixels that were too bright; NaN in the picture is not known.

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
    if min(image.shape) < _LEAST_PX:
        return Detection(False, f"the picture of {image.shape[1]} x {image.shape[0]} px is too small to show a board")
    finite = image[np.isfinite(image)]
    if finite.size < 0.01 * image.size or np.ptp(finite) < 1e-6 * max(1.0, float(np.abs(finite).max())):
        level = f"{float(np.median(finite)):.4g} everywhere" if finite.size else "not known anywhere"
        bright = f"; {saturated.mean():.0%} of it saturated" if saturated is not None and saturated.any() else ""
        return Detection(
            False, f"the picture is uniform, {level}{bright}: too dark, all too bright, or without a board"
        )
    limits = limits or Limits()
    found = _circles(image, spec, threads) if spec.diameters_mm.any() else _corners(image, spec, threads)
    if found.found:
        return judged(found, spec, (image.shape[0], image.shape[1]), saturated, limits)
    return replace(found, reason="; ".join(_reasons(found, image, saturated, limits)))


def _reasons(found: Detection, image: Float32Array, saturated: Mask | None, limits: Limits) -> list[str]:
    """Return why there is no board: what is wrong with the marks, or else with the picture, beside what was seen."""
    if found.decided:
        return [found.reason]
    wrong = list(marks_problems(found.quality, limits))
    picture = "" if wrong else why_nothing(image, saturated, limits)
    return [*([picture] if picture else []), found.reason, *wrong]


def _circles(image: Float32Array, spec: BoardSpec, threads: int) -> Detection:
    ellipses = find_ellipses(image, spec.dark_marks, threads)
    if len(ellipses.px) < 4:
        return _too_few(image, spec, len(ellipses.px), threads)
    big = _is_big(ellipses, spec)
    step = spec.pitch_mm / (np.sqrt(2) if spec.kind == "asymmetric-circles" else 1)
    radii = np.where(big, spec.diameters_mm.max(), spec.diameters_mm.min()) / 2
    lattice, known = walk(ellipses.px, ellipses.shape, step / radii)
    matched = match(lattice, known, big, spec, ellipses.px)
    quality = {"candidates": float(len(ellipses.px)), **_figures(ellipses.pick(known) if known.any() else ellipses)}
    if matched.reason:
        return Detection(False, matched.reason, quality=quality, decided=matched.mirrored)
    chosen = np.flatnonzero(matched.index >= 0)
    chosen = chosen[np.argsort(matched.index[chosen])]
    own = ellipses.pick(chosen)
    long, short, angle = own.axes()
    return Detection(
        True, "", matched.index[chosen], own.px, own.sigma_px,
        np.column_stack([own.px, long, short, angle]), {**quality, **_figures(own)},
    )  # fmt: skip


def _too_few(image: Float32Array, spec: BoardSpec, count: int, threads: int) -> Detection:
    seen, other = ("dark", "light") if spec.dark_marks else ("light", "dark")
    others = len(find_ellipses(image, not spec.dark_marks, threads).px)
    if others >= _OTHER:
        reason = f"{others} {other} circles and {count} {seen} ones are seen: the board's polarity is the other one"
        return Detection(False, reason, quality={"candidates": float(count)}, decided=True)
    return Detection(
        False,
        f"no board: {count} {seen} circles of {_SMALLEST_PX:.0f} px or more are seen",
        quality={"candidates": float(count)},
    )


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
    return {
        "blur_px": float(np.median(ellipses.blur_px)),
        "contrast": _contrast(ellipses.ground, ellipses.mark),
        "diameter_px": float(2 * np.median(np.sqrt(long * short))),
        "axis_ratio": float(np.median(short / long)),
    }


def _contrast(one: Float64Array, other: Float64Array) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.median(np.abs(one - other) / (np.abs(one) + np.abs(other))))


def _corners(image: Float32Array, spec: BoardSpec, threads: int) -> Detection:
    found = find_corners(image, spec, threads)
    if not len(found.index):
        if spec.kind == "charuco" and len(find_corners(np.ascontiguousarray(image[:, ::-1]), spec, threads).index):
            return Detection(
                False, "the board is mirrored: the picture is flipped, or the board is seen in a mirror", decided=True
            )
        whole = "; it has to be seen whole" if spec.kind == "chessboard" else ""
        return Detection(False, f"no {spec.kind} of {spec.columns} x {spec.rows} corners is seen{whole}")
    quality = {"blur_px": float(np.median(found.blur_px)), "contrast": _contrast(*found.levels.T)}
    return Detection(True, "", found.index, found.px, found.sigma_px, quality=quality)
