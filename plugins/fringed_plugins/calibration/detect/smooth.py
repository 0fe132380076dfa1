"""How well points lie on what a lens makes of a flat grid.

Owns a homography and a polynomial on it, which together follow perspective and distortion; what is off is no point.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
_DEGREES = ((50, 5), (16, 3), (0, 0))  # of the polynomial, from so many points on
_ORDINARY = 1.8  # focal length of an ordinary lens over the picture's larger side


def grid_residuals(board: Float64Array, seen: Float64Array, radius_px: Float64Array | None = None) -> Float64Array:
    """Return what is left (n, 2) px of `seen` (n, 2) after a robust fit on `board` (n, 2), NaN with too few points.

    A homography that bears half of the points being wrong is followed by polynomials of rising degree in the pixel
    that it predicts, where Brown's distortion is one; each leaves out what is more than five times the middle
    deviation off. `radius_px` (n,) of circles: perspective moves their centres by its square.

    Examples
    --------
    >>> import numpy as np
    >>> board = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), -1).reshape(-1, 2)
    >>> bent = board * (100 + np.sum((board - 2) ** 2, axis=1, keepdims=True))
    >>> bent[7] += 16
    >>> np.flatnonzero(np.abs(grid_residuals(board, bent)).max(axis=1) > 1)
    array([7])
    """
    import cv2

    if len(board) < 6:
        return np.full(seen.shape, np.nan)
    scale = float(np.abs(board - board.mean(axis=0)).max()) or 1.0
    place = (board - board.mean(axis=0)) / scale
    H: Any = cv2.findHomography(place, seen, cv2.LMEDS)[0]
    if H is None:
        return np.full(seen.shape, np.nan)
    mapped = _mapped(H, place)
    residual = seen - mapped
    good = _near(residual, np.ones(len(place), bool), 1.0)
    for _ in range(5):
        if good.sum() < 6:
            break
        terms = _terms(mapped, good, radius_px)
        solution, *_ = np.linalg.lstsq(terms[good], (seen - mapped)[good], rcond=None)
        residual = seen - mapped - terms @ solution
        chosen = _near(residual, good, 1e-3)
        if (chosen == good).all():
            break
        good = chosen
    return np.asarray(residual)


def _mapped(H: Any, place: Float64Array) -> Float64Array:
    mapped = np.column_stack([place, np.ones(len(place))]) @ np.asarray(H).T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _near(residual: Float64Array, good: npt.NDArray[np.bool_], least_px: float) -> npt.NDArray[np.bool_]:
    size = np.linalg.norm(residual, axis=1)
    return np.asarray(size < 5 * max(float(np.median(size[good])), 1e-6) + least_px)


def _terms(px: Float64Array, good: npt.NDArray[np.bool_], radius_px: Float64Array | None) -> Float64Array:
    middle = px[good].mean(axis=0)
    x, y = ((px - middle) / (float(np.abs(px[good] - middle).max()) or 1.0)).T
    degree = next(degree for points, degree in _DEGREES if good.sum() >= points)
    terms = [x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)]
    if radius_px is not None and degree and np.ptp(radius_px[good]) > 0.1 * radius_px[good].max():
        bias = (radius_px / radius_px.max()) ** 2
        terms += [bias, bias * x, bias * y]
    return np.stack(terms, -1)


def tilt_deg(board: Float64Array, seen: Float64Array, size: tuple[int, int]) -> float:
    """Return the angle between the line of sight and the board's normal at the points' middle; NaN with too few points.

    From how much shorter lengths are along one direction than across it, which needs no focal length but for how
    oblique the line of sight is to the picture; there an ordinary lens is assumed. `size` is width and height, px.
    """
    import cv2

    if len(board) < 4:
        return float("nan")
    H: Any = cv2.findHomography(board, seen, 0)[0]
    if H is None:
        return float("nan")
    at = _mapped(H, board.mean(axis=0, keepdims=True))[0]
    weight = float(H[2, :2] @ board.mean(axis=0) + H[2, 2])
    slopes = (H[:2, :2] - np.outer(at, H[2, :2])) / weight
    ray = (at - np.array([size[0] - 1, size[1] - 1]) / 2) / (_ORDINARY * max(size))
    sight = np.array([*ray, 1.0]) / np.sqrt(1 + ray @ ray)
    across = (np.eye(3) - np.outer(sight, sight))[:, :2] @ slopes  # lengths as an eye at the lens sees them
    long, short = np.linalg.svd(across, compute_uv=False)
    return float(np.degrees(np.arccos(np.clip(short / long, 0.0, 1.0)))) if long > 0 else float("nan")
