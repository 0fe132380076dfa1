"""Marks in a picture: found roughly at several scales, then fitted.

Owns the way from a picture to ellipses; knows nothing of boards.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.ellipse_kernel import PARAMETERS, fit_ellipses
from fringed_plugins.parallel import run_rows

Float64Array = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]

REACH = 1.45  # of the radius: the window of a fit
_BLOCKS = (0.02, 0.05, 0.12, 0.3)  # of the picture's larger side: windows of the local threshold
_STEP = 0.04  # of the picture's range: least contrast of a candidate
_FILLED = (0.88, 1.10)  # area of a candidate over that of its ellipse
_SLIM = 0.15
_ROUGH, _LEAST_ROUGH = 4.0, 0.04  # misfit over contrast: of the middle one, and at the least, what is no circle
LEAST_PX = 2.5  # half axis


class Ellipses(NamedTuple):
    """Ellipses: `px` (n, 2) centres, `shape` (n, 3) a11, a12, a22 of |A (x - c)| = 1, `sigma_px` (n,) of a coordinate.

    `blur_px`, `ground` and `mark` (grey levels), `misfit` (grey levels), all (n,).
    """

    px: Float64Array
    shape: Float64Array
    sigma_px: Float64Array
    blur_px: Float64Array
    ground: Float64Array
    mark: Float64Array
    misfit: Float64Array

    def pick(self, chosen: npt.NDArray[Any]) -> Ellipses:
        """Return some of them."""
        return Ellipses(*(part[chosen] for part in self))

    def axes(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return the larger and the smaller half axis (n,) px, and the larger one's angle (rad)."""
        matrices = np.stack([self.shape[:, :2], self.shape[:, 1:]], 1)
        values, vectors = np.linalg.eigh(matrices)
        angle = np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0])
        return 1 / values[:, 0], 1 / values[:, 1], angle


def find_ellipses(picture: Float32Array, dark: bool, threads: int = 0) -> Ellipses:
    """Return the ellipses that are darker (or lighter) than what is around them, each once.

    `picture` (height, width) float32; NaN counts as the darkest level when candidates are looked for, and not at all
    when they are fitted.
    """
    starts = _candidates(picture, dark)
    fitted = starts.copy()
    sigma, misfit = np.empty((len(starts), 2)), np.empty(len(starts))
    run_rows(fit_ellipses, len(starts), picture, starts, REACH, (fitted, sigma, misfit), threads=threads)
    spread = np.sqrt(np.mean(sigma**2, axis=1))
    found = Ellipses(fitted[:, :2], fitted[:, 2:5], spread, fitted[:, 5], fitted[:, 6], fitted[:, 7], misfit)
    signed = (found.ground - found.mark) * (1.0 if dark else -1.0)
    with np.errstate(invalid="ignore"):
        good = np.isfinite(spread) & (spread < 0.5) & (signed > 4 * misfit)
    return _alike(_once(found.pick(good)))


def _candidates(picture: Float32Array, dark: bool) -> Float64Array:
    """Return starts (n, 10) of fits: outlines that are ellipses, of a local threshold at several scales."""
    import cv2

    grey, low, high = _grey(picture)
    if high <= low:
        return np.zeros((0, PARAMETERS))
    found: list[Float64Array] = []
    size = max(picture.shape)
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.8)
    for part in _BLOCKS:
        block = max(7, int(part * size) | 1)
        mode = cv2.THRESH_BINARY_INV if dark else cv2.THRESH_BINARY
        offset = 255 * _STEP if dark else -255 * _STEP
        marks = cv2.adaptiveThreshold(smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, mode, block, offset)
        outlines, kin = cv2.findContours(marks, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        for number, outline in enumerate(outlines):
            hole = kin[0][number][3] >= 0  # a mark that is wider than the window has one
            start = None if hole else _ellipse(cv2, outline, grey.shape)
            if start is not None:
                found.append(start)
    if not found:
        return np.zeros((0, PARAMETERS))
    starts = np.array(found)
    return _with_levels(picture, starts[_distinct(starts[:, :2], 1 / np.sqrt(starts[:, 2] * starts[:, 4]))])


def _grey(picture: Float32Array) -> tuple[npt.NDArray[np.uint8], float, float]:
    finite = picture[np.isfinite(picture)]
    if finite.size < 100:
        return np.zeros(picture.shape, np.uint8), 0.0, 0.0
    low, high = (float(v) for v in np.percentile(finite[:: max(1, finite.size // 200_000)], (0.5, 99.5)))
    if high - low < 1e-6 * max(abs(high), 1.0):
        return np.zeros(picture.shape, np.uint8), low, low
    scaled = np.clip((np.nan_to_num(picture, nan=low) - low) * (255 / (high - low)), 0, 255)
    return scaled.astype(np.uint8), low, high


def _ellipse(cv2: Any, outline: Any, shape: tuple[int, ...]) -> Float64Array | None:
    """Return the start of a fit, or None for an outline that is no ellipse."""
    if len(outline) < 12:
        return None
    area = cv2.contourArea(outline)
    if area < np.pi * LEAST_PX**2 or area > 0.1 * shape[0] * shape[1]:
        return None
    (x, y), (first, second), degrees = cv2.fitEllipseDirect(outline)
    a, b = first / 2 + 0.5, second / 2 + 0.5  # an outline runs through the centres of the outermost pixels
    if not (min(a, b) > LEAST_PX and min(a, b) > _SLIM * max(a, b)):
        return None
    if not _FILLED[0] < area / (np.pi * (a - 0.5) * (b - 0.5)) < _FILLED[1]:
        return None
    if not (a + b < x < shape[1] - a - b and a + b < y < shape[0] - a - b) and not (
        max(a, b) < x < shape[1] - max(a, b) - 1 and max(a, b) < y < shape[0] - max(a, b) - 1
    ):
        return None
    turn = np.deg2rad(degrees)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    matrix = axes @ np.diag([1 / a, 1 / b]) @ axes.T
    return np.array([x, y, matrix[0, 0], matrix[0, 1], matrix[1, 1], 0.6, 0.0, 0.0, 0.0, 0.0])


def _distinct(px: Float64Array, radius: Float64Array) -> npt.NDArray[np.intp]:
    """Return the places of candidates of which none lies within another one's inner half; the first of equals stays."""
    from scipy.spatial import cKDTree

    order = np.arange(len(px))
    kept = np.ones(len(px), bool)
    for i, j in sorted(cKDTree(px).query_pairs(0.5 * float(radius.max()))):
        if kept[i] and kept[j] and np.linalg.norm(px[i] - px[j]) < 0.5 * min(radius[i], radius[j]):
            kept[j] = False
    return order[kept]


def _with_levels(picture: Float32Array, starts: Float64Array) -> Float64Array:
    """Write the grey levels of ground and mark, as seen at a few places, into the starts."""
    height, width = picture.shape
    angles = np.arange(16) * (2 * np.pi / 16)
    circle = np.stack([np.cos(angles), np.sin(angles)], -1)
    for start in starts:
        inverse = np.linalg.inv([[start[2], start[3]], [start[3], start[4]]])
        levels = []
        for reach in (1.4, 0.4):
            at = np.rint(start[:2] + reach * circle @ inverse.T).astype(int)
            inside = (at[:, 0] >= 0) & (at[:, 0] < width) & (at[:, 1] >= 0) & (at[:, 1] < height)
            seen = picture[at[inside, 1], at[inside, 0]]
            seen = seen[np.isfinite(seen)]
            levels.append(float(np.median(seen)) if seen.size else 0.0)
        start[6:8] = levels
    return starts


def _alike(found: Ellipses) -> Ellipses:
    """Return those that fit about as well as most do: the others are covered in part, in glare, or no circles."""
    if not len(found.px):
        return found
    share = found.misfit / np.abs(found.ground - found.mark)
    return found.pick(share < max(_ROUGH * float(np.median(share)), _LEAST_ROUGH))


def _once(found: Ellipses) -> Ellipses:
    """Return each ellipse once: of several fits of one mark the best."""
    if not len(found.px):
        return found
    best = found.pick(np.argsort(found.misfit, kind="stable"))
    return best.pick(_distinct(best.px, 1 / np.sqrt(best.shape[:, 0] * best.shape[:, 2] - best.shape[:, 1] ** 2)))
