"""Equal points, and points of one voxel: which belong together, and their means."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.features.grouping_kernel import grouped, summed
from fringed_plugins.registration.transforms import FloatArray

Index = npt.NDArray[np.intp]
Counts = npt.NDArray[np.int64]


def distinct(points: FloatArray) -> tuple[Index, Index]:
    """Return which rows to keep so that no two are the same, and for each row (n,) which of those it is like.

    Examples
    --------
    >>> keep, group = distinct(np.array([[0.0, 1.0], [2.0, 1.0], [0.0, 1.0]]))
    >>> keep.tolist(), group.tolist()
    ([0, 1], [0, 1, 0])
    """
    plain = np.ascontiguousarray(points) + 0.0  # one zero
    group, first = _groups(plain.view(np.uint64))
    return first, group


def voxels(points: FloatArray, side: float) -> tuple[Index, int]:
    """Return each point's voxel (n,), numbered as they first appear, and how many voxels there are."""
    cell = np.floor((points - points.min(axis=0)) / side).astype(np.int64)
    size = cell.max(axis=0) + 1
    keys = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    group, first = _groups(keys.view(np.uint64)[:, None])
    return group, len(first)


def means(points: FloatArray, counts: Counts, group: Index, number: int) -> tuple[FloatArray, Counts]:
    """Return the mean of each group's points (number, 3), weighted by their counts (n,), and the sums of these."""
    sums, totals = np.zeros((number, points.shape[1])), np.zeros(number, np.int64)
    summed(points, counts, group, sums, totals)
    mean: FloatArray = sums / totals[:, None]
    return mean, totals


def _groups(keys: npt.NDArray[Any]) -> tuple[Index, Index]:
    group, first = np.empty(len(keys), np.intp), np.empty(len(keys), np.intp)
    return group, first[: grouped(keys, group, first)]
