"""Small pictures of data objects, fast enough for a live view or a notebook.

Owns how each type looks at a glance; draws with OpenCV only, no axes.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from fringed.data import Array, FrameSet, Model, PhaseMap, RangeImage, Truth, UInt8Array
from fringed.messages import Preview

WIDTH_PX = 360
PAPER = (250, 250, 250)


def thumbnail(content: Any, width_px: int = WIDTH_PX) -> UInt8Array | None:
    """Return a BGR picture `(height, width, 3)` uint8 of a data object, None where it has none."""
    if isinstance(content, FrameSet):
        return _sheet(content, width_px)
    if isinstance(content, PhaseMap):
        cyclic = content.kind == "wrapped"
        return coloured(_small(content.phase_rad, width_px), cv2.COLORMAP_TWILIGHT if cyclic else cv2.COLORMAP_VIRIDIS)
    if isinstance(content, RangeImage):
        return coloured(_small(content.xyz_mm[..., 2], width_px), cv2.COLORMAP_VIRIDIS)
    if isinstance(content, Truth):
        seen = np.where(content.is_object > 0, content.xyz_mm[..., 2], np.nan)
        return coloured(_small(seen, width_px), cv2.COLORMAP_VIRIDIS)
    if isinstance(content, Preview):
        return grey(content.image)
    if isinstance(content, Model):
        from fringed_client.pictures.shading import VIEWS, render_points

        picture = render_points(content.points_mm, content.normals, VIEWS["oblique"], width_px)
        return picture.rgb[..., ::-1].copy()
    return None


def grey(frame: Array) -> UInt8Array:
    """Return one frame, uint8 or uint16, as BGR."""
    top = 255.0 if frame.dtype == np.uint8 else float(max(int(frame.max()), 1))
    scaled = frame if frame.dtype == np.uint8 else (frame * (255.0 / top)).astype(np.uint8)
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_GRAY2BGR), np.uint8)


def coloured(values: Array, colour_map: int) -> UInt8Array:
    """Return values with the 2nd to the 98th percentile over a colour map as BGR; NaN is paper."""
    valid = np.isfinite(values)
    picture: UInt8Array = np.full((*values.shape, 3), PAPER, np.uint8)
    if valid.any():
        low, high = np.percentile(values[valid], (2, 98))
        scaled = np.clip((np.nan_to_num(values, nan=low) - low) / max(float(high - low), 1e-9), 0, 1) * 255
        picture[valid] = cv2.applyColorMap(scaled.astype(np.uint8), colour_map)[valid]
    return picture


def png(picture: UInt8Array) -> bytes:
    """Return a BGR picture as a PNG file's bytes."""
    return bytes(cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 4])[1].tobytes())


def _small(values: Array, width_px: int) -> Array:
    step = max(1, -(-values.shape[1] // width_px))
    return values[::step, ::step]


def _sheet(frames: FrameSet, width_px: int, columns: int = 4) -> UInt8Array:
    step = max(1, -(-frames.frames.shape[2] * columns // (2 * width_px)))
    tiles = [grey(np.ascontiguousarray(frame[::step, ::step])) for frame in frames.frames]
    tiles += [np.full_like(tiles[0], PAPER[0])] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[start : start + columns]) for start in range(0, len(tiles), columns)]
    return np.asarray(np.vstack(rows), np.uint8)
