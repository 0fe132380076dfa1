"""Points spread evenly over triangles."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
STEP_U, STEP_V = 0.7548776662466927, 0.5698402909980532  # of the plastic number: fills the square evenly


def sampled(vertices: Array, faces: Array, count: int) -> tuple[FloatArray, FloatArray]:
    """Return `count` points (count, 3) on triangles, as many on each as its area says, and unit normals (count, 3).

    The same ones for the same mesh.

    Raises
    ------
    ValueError
        no triangle has an area.

    References
    ----------
    Osada et al.: Shape distributions, TOG 2002 (a point of a triangle); Roberts 2018 (the sequence R2).
    """
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=1)
    total = float(area.sum())
    if not total > 0:
        raise ValueError(f"none of the {len(faces)} triangles has an area")
    at = np.searchsorted(np.cumsum(area), total * (np.arange(count) + 0.5) / count)
    at = np.minimum(at, len(faces) - 1)
    number = np.arange(1, count + 1)
    u, v = np.sqrt((number * STEP_U) % 1.0)[:, None], ((number * STEP_V) % 1.0)[:, None]
    points: FloatArray = (1 - u) * a[at] + u * (1 - v) * b[at] + u * v * c[at]
    return points, across[at] / area[at, None]
