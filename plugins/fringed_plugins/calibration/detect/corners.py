"""Chessboards and ChArUco boards: OpenCV finds their corners.

Owns the call and the deviation of the corners; OpenCV's sector model and its markers are as good as any.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.board_spec import BoardSpec

Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]


def find_corners(grey: npt.NDArray[np.uint8], spec: BoardSpec) -> tuple[Int32Array, Float64Array]:
    """Return the points of the board (n,) and where they are (n, 2) px; none of either where there is no board."""
    return _charuco(grey, spec) if spec.kind == "charuco" else _chessboard(grey, spec)


def _chessboard(grey: npt.NDArray[np.uint8], spec: BoardSpec) -> tuple[Int32Array, Float64Array]:
    import cv2

    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
    found, corners = cv2.findChessboardCornersSB(grey, (spec.columns, spec.rows), flags=flags)
    if not found:
        return np.zeros(0, np.int32), np.zeros((0, 2))
    px = corners.reshape(-1, 2).astype(np.float64)
    if px[0] @ np.ones(2) > px[-1] @ np.ones(2):  # upside down and upright look alike: the upper left one is first
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
