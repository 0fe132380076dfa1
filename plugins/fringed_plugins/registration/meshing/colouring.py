"""What the views say of the vertices: normals, intensity, confidence.

Owns the lookup at the feet of vertices on every view's patches. Knows nothing of voxels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fringed_plugins.registration.meshing.triangles import TriangleMesh, vertex_normals
from fringed_plugins.registration.meshing.volume import Seen
from fringed_plugins.registration.patch_kernels import walk
from fringed_plugins.registration.result import Report
from fringed_plugins.registration.transforms import FloatArray, inverse, turned

Array = npt.NDArray[Any]
CHUNK = 25_000  # vertices between two reports


def coloured(
    shape: tuple[Array, Array],
    views: Sequence[Seen],
    intensities: Sequence[Array],
    reach: float,
    report: Report,
) -> TriangleMesh:
    """Return the mesh of `shape`, vertices and faces, with what the views within `reach` of its vertices say.

    Normals and intensities are means by the views' weights. Where no view has looked, normals are the faces' and the
    intensity is that of the nearest vertex that one has seen.
    """
    vertices, faces = shape
    plain = vertex_normals(vertices, faces, lambda: report(0.0, "normals"))
    total, grey, normals = np.zeros(len(vertices)), np.zeros(len(vertices)), np.zeros((len(vertices), 3))
    for number, (seen, image) in enumerate(zip(views, intensities, strict=True)):
        pixels = _on_patches(seen, image)
        for start in range(0, len(vertices), CHUNK):
            part = slice(start, start + CHUNK)
            report(number / len(views), f"intensity of the {seen.patches.surface.name}")
            w, g, n = _looked_up(seen, pixels, vertices[part], plain[part], reach)
            total[part] += w
            grey[part] += w * g
            normals[part] += w[:, None] * n
    known = total > 0
    grey[known] /= total[known]
    if known.any() and not known.all():
        tree, lost = cKDTree(vertices[known], balanced_tree=False, compact_nodes=False), np.flatnonzero(~known)
        for start in range(0, len(lost), CHUNK):
            report(1.0, "intensity of what nobody has seen")
            some = lost[start : start + CHUNK]
            grey[some] = grey[known][tree.query(vertices[some])[1]]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0, normals / np.maximum(length, 1e-300), plain)
    return TriangleMesh(
        vertices.astype(np.float32), faces, normals.astype(np.float32),
        np.clip(np.rint(grey), 0, 255).astype(np.uint8), total.astype(np.float32),
    )  # fmt: skip


def _on_patches(seen: Seen, intensity: Array) -> Array:
    """Return the intensity (h, w) float32 of a view's patches: means of the pixels that each one covers."""
    (h, w), (top, left), s = seen.weights.shape, seen.corner, seen.step
    part = np.ascontiguousarray(intensity[top : top + h * s, left : left + w * s]).astype(np.float32)
    return part if s == 1 else cv2.resize(part, (w, h), interpolation=cv2.INTER_AREA)


def _looked_up(
    seen: Seen, pixels: Array, vertices: Array, normals: Array, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return weights (n,), intensities (n,) and normals (n, 3) in the model's frame of what a view sees of vertices."""
    T = inverse(seen.T_model_centred)
    found, rows = np.full(len(vertices), -1, np.int64), np.zeros((len(vertices), 8))
    table = seen.patches.table
    both = np.ascontiguousarray(np.hstack([vertices, normals]), np.float64)
    walk(both, np.vstack([T, seen.patches.projection]), table, seen.patches.usable, found, rows)
    met = (found >= 0) & (np.abs(rows[:, 6]) < reach)
    at = found[met]
    weight, grey, normal = np.zeros(len(vertices)), np.zeros(len(vertices)), np.zeros((len(vertices), 3))
    patch = table.reshape(-1, 15)[at].astype(np.float64)
    weight[met] = seen.weights.reshape(-1)[at]
    normal[met] = turned(seen.T_model_centred[:3, :3], patch[:, 9:12])
    du, dv = _way(patch, rows[met, :3])
    width = table.shape[1]
    columns, lines = (at % width + du).astype(np.float32), (at // width + dv).astype(np.float32)
    grey[met] = _between(pixels, columns, lines)
    return weight, grey, normal


def _way(patch: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how many columns and rows places (n, 3) are away from the middles of their patches (n, 15)."""
    off, a, b = places - patch[:, :3], patch[:, 3:6], patch[:, 6:9]
    E, F, G = ((p * q).sum(1) for p, q in ((a, a), (a, b), (b, b)))
    x, y = (off * a).sum(1), (off * b).sum(1)
    determinant = np.maximum(E * G - F * F, 1e-300)
    return np.clip((G * x - F * y) / determinant, -1, 1), np.clip((E * y - F * x) / determinant, -1, 1)


def _between(image: Array, columns: Array, rows: Array) -> Array:
    """Return an image's values between its pixels, bilinear."""
    h, w = image.shape
    c, r = np.clip(columns, 0, w - 1), np.clip(rows, 0, h - 1)
    left, top = np.minimum(c.astype(np.int64), max(w - 2, 0)), np.minimum(r.astype(np.int64), max(h - 2, 0))
    right, below = np.minimum(left + 1, w - 1), np.minimum(top + 1, h - 1)
    u, v = c - left, r - top
    upper = (1 - u) * image[top, left] + u * image[top, right]
    lower = (1 - u) * image[below, left] + u * image[below, right]
    out: Array = (1 - v) * upper + v * lower
    return out
