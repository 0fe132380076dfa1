"""Kernels that average a print over the footprint of each pixel.

Owns where pixels lie on the sheet and how much of each is covered by marks. A pixel is a square; on the sheet it is
taken for a parallelogram, which is what perspective and distortion leave of so small a thing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed.simulation.lens_kernels import pixel_ray
from fringed.simulation.trace_kernels import OBJECT

_SAMPLES = 16  # along each side, where the edge of a box crosses a pixel


class Marks(NamedTuple):
    """A print as kernels take it; see `shapes.shape.Print`."""

    discs: Any
    boxes: Any
    albedo: Any
    place: Any
    rows: int
    columns: int
    disc_starts: Any
    disc_items: Any
    box_starts: Any
    box_items: Any


@njit(cache=True, nogil=True)
def sheet_rows(rows: tuple[int, int], lens: Any, pose: Any, scale_x: float, out: Any) -> None:
    """Write where each pixel's ray meets the plane of the sheet, (2, height + 2, width + 2) mm; pixels begin at -1."""
    R, o = pose[:3, :3], pose[:3, 3]
    reach = R[0, 2] * o[0] + R[1, 2] * o[1] + R[2, 2] * o[2]
    for r in range(rows[0], rows[1]):
        yd = (r - 1.0 - lens[3]) / lens[1]
        ahead, below = 0.0, 0.0
        for c in range(out.shape[2]):
            xd = (c - 1.0 - lens[2]) / lens[0]
            x, y = pixel_ray(xd, yd, (xd + ahead, yd + below), lens)
            ahead, below = x - xd, y - yd
            slope = R[0, 2] * x + R[1, 2] * y + R[2, 2]
            t = reach / slope if slope > 1e-9 else np.nan
            p0, p1, p2 = t * x - o[0], t * y - o[1], t - o[2]
            out[0, r, c] = (R[0, 0] * p0 + R[1, 0] * p1 + R[2, 0] * p2) * scale_x
            out[1, r, c] = R[0, 1] * p0 + R[1, 1] * p1 + R[2, 1] * p2


@njit(cache=True, nogil=True)
def half_plane_area(distance: float, gx: float, gy: float) -> float:
    """Return how much of a unit square lies below a line at `distance` from its centre along (gx, gy).

    `distance` is that of the function whose gradient is (gx, gy): the area where it is negative.
    """
    length = np.sqrt(gx * gx + gy * gy)
    d = abs(distance) / length
    a, b = abs(gx) / length, abs(gy) / length
    if a < b:
        a, b = b, a
    far = (a + b) / 2
    if d >= far:
        less = 0.0
    elif d <= (a - b) / 2:
        less = 0.5 - d / a
    else:
        less = (far - d) ** 2 / (2 * a * b)
    return less if distance > 0 else 1.0 - less


@njit(cache=True, nogil=True)
def _disc_area(disc: Any, x: float, y: float, j: tuple[float, float, float, float]) -> float:
    """Return the part of a pixel at (x, y) that a disc covers; `j` are the derivatives of x and y by column and row."""
    dx, dy = x - disc[0], y - disc[1]
    far = np.sqrt(dx * dx + dy * dy)
    size = abs(j[0]) + abs(j[1]) + abs(j[2]) + abs(j[3])
    if far > disc[2] + size:
        return 0.0
    if far < disc[2] - size or far < 1e-9:
        return 1.0
    nx, ny = dx / far, dy / far
    gx, gy = nx * j[0] + ny * j[2], nx * j[1] + ny * j[3]
    # The mean of the distance over the pixel is not that at its centre: the circle is curved.
    bend = (j[0] ** 2 + j[1] ** 2 + j[2] ** 2 + j[3] ** 2 - gx * gx - gy * gy) / (24.0 * far)
    return float(half_plane_area(far - disc[2] + bend, gx, gy))


@njit(cache=True, nogil=True)
def _box_area(box: Any, x: float, y: float, j: tuple[float, float, float, float]) -> float:
    """Return the part of a pixel at (x, y) that a box covers: exact along an edge, from samples at a corner."""
    hx, hy = (abs(j[0]) + abs(j[1])) / 2, (abs(j[2]) + abs(j[3])) / 2
    if x + hx <= box[0] or x - hx >= box[2] or y + hy <= box[1] or y - hy >= box[3]:
        return 0.0
    if x - hx >= box[0] and x + hx <= box[2] and y - hy >= box[1] and y + hy <= box[3]:
        return 1.0
    left, right, top, end = x - hx < box[0], x + hx > box[2], y - hy < box[1], y + hy > box[3]
    if left + right + top + end == 1:
        if left or right:
            return float(half_plane_area(box[0] - x if left else x - box[2], j[0], j[1]))
        return float(half_plane_area(box[1] - y if top else y - box[3], j[2], j[3]))
    inside = 0
    for k in range(_SAMPLES):
        v = (k + 0.5) / _SAMPLES - 0.5
        for i in range(_SAMPLES):
            u = (i + 0.5) / _SAMPLES - 0.5
            px, py = x + j[0] * u + j[1] * v, y + j[2] * u + j[3] * v
            if box[0] <= px < box[2] and box[1] <= py < box[3]:
                inside += 1
    return inside / (_SAMPLES * _SAMPLES)


@njit(cache=True, nogil=True)
def print_rows(rows: tuple[int, int], place: Any, marks: Any, out: Any) -> None:
    """Multiply gain and base of `rows` by the albedo of what each pixel sees of the print."""
    gain, base, flags = out
    ground, mark = marks.albedo[0], marks.albedo[1]
    for r in range(rows[0], rows[1]):
        for c in range(gain.shape[1]):
            if flags[r, c] & OBJECT == 0:
                continue
            x, y = place[0, r + 1, c + 1], place[1, r + 1, c + 1]
            j = (
                (place[0, r + 1, c + 2] - place[0, r + 1, c]) / 2,
                (place[0, r + 2, c + 1] - place[0, r, c + 1]) / 2,
                (place[1, r + 1, c + 2] - place[1, r + 1, c]) / 2,
                (place[1, r + 2, c + 1] - place[1, r, c + 1]) / 2,
            )
            column, row = int((x - marks.place[0]) / marks.place[2]), int((y - marks.place[1]) / marks.place[2])
            covered = 0.0
            if 0 <= column < marks.columns and 0 <= row < marks.rows:
                cell = row * marks.columns + column
                for k in range(marks.disc_starts[cell], marks.disc_starts[cell + 1]):
                    covered += _disc_area(marks.discs[marks.disc_items[k]], x, y, j)
                for k in range(marks.box_starts[cell], marks.box_starts[cell + 1]):
                    covered += _box_area(marks.boxes[marks.box_items[k]], x, y, j)
            albedo = ground + (mark - ground) * min(covered, 1.0)
            gain[r, c] *= albedo
            base[r, c] *= albedo
