"""Chessboards and ChArUco boards: OpenCV finds their corners, which are then fitted.

Owns the call, and what the fit starts from. OpenCV names the corners well and places them to 0.06 px; a fit of both
edges with their blur and light is as good as noise allows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.board_spec import BoardSpec
from fringed_plugins.calibration.detect.corner_kernel import fit_corners
from fringed_plugins.parallel import run_rows

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]

_WINDOW = 0.35  # of the distance to the nearest corner: the radius of a fit
_CLEAR = 0.85  # of the distance to a marker's corner
_LEAST_PX = 3.5
_CROWDED_PX = 0.05  # what is within reach of the smallest window pulls a corner by, at the most
_MOST_SIGMA_PX = 0.5


@dataclass(frozen=True)
class Corners:
    """Points of the board `index` (n,), `px` (n, 2), `sigma_px` (n,), `blur_px` (n,) and `levels` (n, 2) of grey."""

    index: Int32Array
    px: Float64Array
    sigma_px: Float64Array
    blur_px: Float64Array
    levels: Float64Array


def find_corners(picture: Float32Array, spec: BoardSpec, threads: int = 0) -> Corners:
    """Return the corners that are seen in `picture` (height, width); none where there is no board."""
    low, high = np.nanpercentile(picture, (0.5, 99.5))
    grey = np.clip((np.nan_to_num(picture, nan=low) - low) * (255 / max(high - low, 1e-6)), 0, 255).astype(np.uint8)
    if not spec.dark_marks:
        grey = 255 - grey
    index, px = _charuco(grey, spec) if spec.kind == "charuco" else _chessboard(grey, spec)
    if len(index) < 4:
        return Corners(index[:0], px[:0], np.zeros(0), np.zeros(0), np.zeros((0, 2)))
    starts = _starts(picture, spec, index, px)
    if spec.kind == "chessboard" and _upside_down(starts[:, -2:], spec):
        px = px[::-1].copy()
        starts = _starts(picture, spec, index, px)
    count = len(px)
    out = (np.empty((count, 2)), np.empty(count), np.empty(count), np.empty((count, 2)))
    run_rows(fit_corners, count, picture, starts, out, threads=threads)
    out[1][starts[:, 2] <= _LEAST_PX] += _CROWDED_PX
    with np.errstate(invalid="ignore"):
        good = out[1] < _MOST_SIGMA_PX
    return Corners(index[good], out[0][good], out[1][good], out[2][good], out[3][good])


def _chessboard(grey: npt.NDArray[np.uint8], spec: BoardSpec) -> tuple[Int32Array, Float64Array]:
    import cv2

    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
    found, corners = cv2.findChessboardCornersSB(grey, (spec.columns, spec.rows), flags=flags)
    if not found:
        return np.zeros(0, np.int32), np.zeros((0, 2))
    px = corners.reshape(-1, 2).astype(np.float64)
    if px[0] @ np.ones(2) > px[-1] @ np.ones(2):  # where the two look alike the upper left one is first
        px = px[::-1].copy()
    return np.arange(len(px), dtype=np.int32), px


def _charuco(grey: npt.NDArray[np.uint8], spec: BoardSpec) -> tuple[Int32Array, Float64Array]:
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.CharucoDetector(spec.charuco, cv2.aruco.CharucoParameters(), parameters)
    corners, numbers, _, _ = detector.detectBoard(grey)
    if numbers is None or not len(numbers):
        return np.zeros(0, np.int32), np.zeros((0, 2))
    return numbers.ravel().astype(np.int32), corners.reshape(-1, 2).astype(np.float64)


def _starts(picture: Float32Array, spec: BoardSpec, index: Int32Array, px: Float64Array) -> Float64Array:
    """Return for each corner place, window, directions of both edges, blur and grey levels (n, 8)."""
    import cv2

    board = spec.points_mm[index, :2] / spec.pitch_mm
    H: Any = cv2.findHomography(board, px, cv2.LMEDS)[0]
    if H is None:
        return np.zeros((len(px), 8))
    weight = board @ H[2, :2] + H[2, 2]
    slopes = (H[:2, :2] - px[:, :, None] * H[2, :2]) / weight[:, None, None]  # (n, 2, 2): px by pitches
    step = np.linalg.norm(slopes, axis=1)
    room = _WINDOW
    if spec.kind == "charuco":
        part = spec.charuco.getMarkerLength() / spec.charuco.getSquareLength()
        room = min(room, _CLEAR * (1 - part) / np.sqrt(2))
    radius = np.maximum(room * step.min(axis=1), _LEAST_PX)
    angles = np.arctan2(slopes[:, 1], slopes[:, 0])
    along = slopes / step[:, None]
    levels = np.stack([_level(picture, px, (along[..., 0] + sign * along[..., 1]) * radius[:, None] / 2)
                       for sign in (1, -1)], -1)  # fmt: skip
    return np.column_stack([px, radius, angles, np.full(len(px), 0.7), levels])


def _upside_down(levels: Float64Array, spec: BoardSpec) -> bool:
    """Whether the squares' colours are those of a board turned by 180 degrees, where the two differ."""
    rows, columns = np.divmod(np.arange(len(levels)), spec.columns)
    first_is_mark = (levels[:, 0] < levels[:, 1]) == spec.dark_marks
    agree = np.mean(first_is_mark == ((rows + columns) % 2 == 0))
    return bool((spec.rows + spec.columns) % 2 == 1 and agree < 0.5)


def _level(picture: Float32Array, px: Float64Array, offset: Float64Array) -> Float64Array:
    """Return the mean grey level (n,) at both sides of each point."""
    seen = []
    for side in (px + offset, px - offset):
        x, y = np.clip(np.rint(side), 0, np.array(picture.shape[::-1]) - 1).astype(int).T
        seen.append(picture[y, x])
    return np.asarray(np.nanmean(np.nan_to_num(np.array(seen, np.float64)), axis=0))
