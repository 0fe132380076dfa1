"""A print that is not what it should be: longer along one direction, or on a sheet that is not flat.

Owns four numbers, the same in all views: the stretch of x over y, and a surface of the second degree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.solve.observations import Observation

Float64Array = npt.NDArray[np.float64]

SHAPE = 4


def reach_mm(seen: Sequence[Observation]) -> float:
    """Return how far from the board's middle the outermost point lies along x or y."""
    return float(max(np.abs(one.board_mm[:, :2]).max() for one in seen))


def directions(board_mm: Float64Array, reach: float) -> Float64Array:
    """Return where points (n, 3) go with each number (n, 3, 4): the stretch, then the rise (mm) by x^2, x y and y^2.

    Examples
    --------
    >>> directions(np.array([[100.0, 50.0, 0.0]]), 100.0)[0].tolist()
    [[50.0, 0.0, 0.0, 0.0], [-25.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.5, 0.25]]
    """
    x, y = board_mm[:, 0] / reach, board_mm[:, 1] / reach
    result = np.zeros((len(board_mm), 3, SHAPE))
    result[:, 0, 0], result[:, 1, 0] = board_mm[:, 0] / 2, -board_mm[:, 1] / 2
    result[:, 2, 1:] = np.stack([x * x, x * y, y * y], -1)
    return result


def shaped(seen: Sequence[Observation], values: Float64Array) -> list[Observation]:
    """Return views whose boards are as `values` (4,) say; fewer count as the first ones."""
    every = np.zeros(SHAPE)
    every[: len(values)] = values
    reach = reach_mm(seen)
    return [replace(one, board_mm=one.board_mm + directions(one.board_mm, reach) @ every) for one in seen]


def bend_mm(seen: Sequence[Observation], values: Float64Array) -> float:
    """Return how far from flat the board is, from its lowest to its highest point, less the best plane.

    Examples
    --------
    A strip whose ends rise by 1 mm, seen from its middle; no plane takes any of it away.

    >>> line = np.column_stack([np.linspace(-100, 100, 201), np.zeros(201), np.zeros(201)])
    >>> none = np.zeros((201, 2))
    >>> one = Observation("", line, none, none, none[:, 0], none, np.zeros((201, 2, 2)), none[:, 0])
    >>> round(bend_mm([one], np.array([0.0, 1.0, 0.0, 0.0])), 6)
    1.0
    """
    if len(values) < SHAPE:
        return 0.0
    points = max((one.board_mm for one in seen), key=len)
    z = directions(points, reach_mm(seen))[:, 2, 1:] @ values[1:]
    plane = np.column_stack([points[:, :2], np.ones(len(points))])
    return float(np.ptp(z - plane @ np.linalg.lstsq(plane, z, rcond=None)[0]))
