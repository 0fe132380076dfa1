"""Normals and boundaries of organised points by small least-squares windows on the grid.

Owns differentiation on the grid. A value is valid only where its whole window is, so that nothing is
invented at borders and holes. Knows nothing of registration.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

BoolArray = npt.NDArray[np.bool_]
Array = npt.NDArray[Any]


def complete(valid: BoolArray, window_px: int) -> BoolArray:
    """Return where the whole `window_px` square around a pixel is valid; outside the image is not."""
    kernel = np.ones((window_px, window_px), np.uint8)
    eroded = cv2.erode(valid.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return eroded.astype(np.bool_)


def healed(xyz: Array, valid: BoolArray) -> tuple[Array, BoolArray]:
    """Return points and validity with single missing pixels filled by their neighbours' mean.

    Only where six of the eight neighbours are valid: windows survive lost pixels, but no gap or depth jump
    is bridged. What is filled serves windows; it is never a point.
    """
    around = cv2.boxFilter(valid.astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    fill = ~valid & (around > 5.5)
    if not fill.any():
        return xyz, valid
    rows, columns = np.nonzero(fill)
    whole = np.pad(xyz, ((1, 1), (1, 1), (0, 0)))
    total = sum(whole[rows + i, columns + j] for i in range(3) for j in range(3))
    out = xyz.copy()
    out[rows, columns] = total / around[rows, columns][:, None]
    return out, valid | fill


def tangents(xyz: Array, window_px: int) -> tuple[Array, Array]:
    """Return the derivatives of (height, width, 3) points along columns and rows, per pixel.

    First derivatives of the least-squares quadratic in a square window: Savitzky & Golay 1964. Invalid
    points have to be finite (zero, say); what their windows give is meaningless.
    """
    half = window_px // 2
    ramp = np.arange(-half, half + 1, dtype=np.float64)
    slope, mean = ramp / (ramp @ ramp), np.full(window_px, 1.0 / window_px)
    along_columns = cv2.sepFilter2D(xyz, -1, slope, mean, borderType=cv2.BORDER_REPLICATE)
    along_rows = cv2.sepFilter2D(xyz, -1, mean, slope, borderType=cv2.BORDER_REPLICATE)
    return along_columns, along_rows


def normals(xyz: Array, valid: BoolArray, window_px: int = 5) -> tuple[Array, BoolArray]:
    """Return unit normals (height, width, 3) towards the camera, and where they are valid.

    Parameters
    ----------
    xyz
        (height, width, 3) float32 or float64 points, rows downwards and columns to the right as a
        camera sees them; finite everywhere.
    valid
        (height, width) which points count.
    window_px
        side of the window, odd.

    Raises
    ------
    ValueError
        an even or too small window.

    Examples
    --------
    >>> y, x = np.mgrid[0:7.0, 0:7.0]
    >>> n, ok = normals(np.dstack([x, y, 10 + 0.5 * x]), np.ones((7, 7), bool))
    >>> n[3, 3].round(4) + 0.0, int(ok.sum())
    (array([ 0.4472,  0.    , -0.8944]), 9)
    """
    if window_px < 3 or window_px % 2 == 0:
        raise ValueError(f"a window of {window_px} pixels; expected an odd number of at least 3")
    along_columns, along_rows = tangents(xyz, window_px)
    n = _cross(along_rows, along_columns)
    length = np.sqrt(np.einsum("...i,...i->...", n, n))
    ok = complete(valid, window_px) & (length > 0)
    n *= np.divide(1.0, length, out=np.zeros_like(length), where=ok)[..., None]
    return n, ok


def _cross(a: Array, b: Array) -> Array:
    out = np.empty_like(a)  # np.cross is several times slower on images
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out
