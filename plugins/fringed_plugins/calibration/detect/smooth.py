"""How well points lie on what a lens makes of a flat grid.

Owns a homography and a polynomial on it, which together follow perspective and distortion; what is off is no point.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
_LEAST = 16  # points from which on distortion is fitted as well


def grid_residuals(board: Float64Array, seen: Float64Array) -> Float64Array:
    """Return what is left (n, 2) px of `seen` (n, 2) after a robust fit on `board` (n, 2), NaN with too few points.

    Rounds of fitting leave out what is off by more than five times the middle deviation.
    """
    import cv2

    if len(board) < 6:
        return np.full(seen.shape, np.nan)
    scale = float(np.abs(board - board.mean(axis=0)).max()) or 1.0
    place = (board - board.mean(axis=0)) / scale
    H: Any = cv2.findHomography(place, seen, cv2.LMEDS)[0]
    if H is None:
        return np.full(seen.shape, np.nan)
    good = np.ones(len(place), bool)
    residual = np.zeros_like(seen)
    for _ in range(4):
        mapped = np.column_stack([place, np.ones(len(place))]) @ H.T
        residual = seen - mapped[:, :2] / mapped[:, 2:]
        terms = _terms(place, 3 if good.sum() >= _LEAST else 0)
        solution, *_ = np.linalg.lstsq(terms[good], residual[good], rcond=None)
        residual = residual - terms @ solution
        size = np.linalg.norm(residual, axis=1)
        typical = max(float(np.median(size[good])), 1e-6)
        chosen = size < 5 * typical + 1e-3
        if (chosen == good).all() or chosen.sum() < 8:
            break
        good = chosen
        again: Any = cv2.findHomography(place[good], seen[good], 0)[0]
        H = again if again is not None else H
    return np.asarray(residual)


def _terms(place: Float64Array, degree: int) -> Float64Array:
    x, y = place.T
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], -1)


def tilt_deg(board: Float64Array, seen: Float64Array, size: tuple[int, int]) -> float:
    """Return about how far the board is turned away from the camera, for a lens of ordinary length; NaN for none."""
    import cv2

    if len(board) < 4:
        return float("nan")
    H: Any = cv2.findHomography(board, seen, 0)[0]
    if H is None:
        return float("nan")
    focal = 1.8 * max(size)
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    columns = np.linalg.inv(K) @ H
    normal = np.cross(columns[:, 0], columns[:, 1])
    length = float(np.linalg.norm(normal))
    return float(np.degrees(np.arccos(min(1.0, abs(normal[2]) / length)))) if length else float("nan")
