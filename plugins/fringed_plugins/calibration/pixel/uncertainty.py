"""How far points may be off, because a calibration is known only so well.

Owns the propagation of a calibration's covariance to points; noise of the phase is none of its business.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.pixel.derivatives import NUMBERS, point_derivatives
from fringed_plugins.calibration.rig import Pinhole

Float64Array = npt.NDArray[np.float64]

_KINDS = ("camera.", "projector.", "stereo.")


def trueness_mm(
    camera: Pinhole, projector: Pinhole, T_projector_camera: Float64Array, covariance: Float64Array,
    parameters: Sequence[str], *, depths_mm: Sequence[float] | Float64Array, grid: tuple[int, int] = (9, 13),
    orientation: str = "columns",
) -> Float64Array:  # fmt: skip
    """Return the standard deviations of X, Y and Z (depths, rows, columns, 3), mm, that the calibration leaves.

    They are those of points in the camera's frame, at `depths_mm` on the rays of a `grid` (rows, columns) of pixels
    that spans the camera's picture, corners included: `grid_pixels`. `covariance` (p, p) is that of the numbers that
    `parameters` names (`derivatives.NUMBERS`); numbers that are not named count as known, and names of other things,
    such as poses, do not matter here. NaN outside the projector's picture.

    Raises
    ------
    ValueError
        a parameter of a lens or of the stereo pose that is unknown, or a covariance of another shape.

    Examples
    --------
    A baseline of 100 mm along x that is known to 0.1 mm: depth is known to a thousandth, wherever it is.

    >>> matrix = np.array([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]])
    >>> lens, pose = Pinhole(641, 481, matrix, np.zeros(5)), np.eye(4)
    >>> pose[0, 3] = -100.0
    >>> sigma = trueness_mm(lens, lens, pose, np.array([[0.01]]), ["stereo.tx"], depths_mm=[800.0], grid=(3, 3))
    >>> np.round(sigma[0, 1, 1], 6).tolist()
    [0.0, 0.0, 0.8]

    References
    ----------
    JCGM 100:2008 (GUM), section 5.2: the law of propagation for correlated quantities.
    """
    chosen, among = named(covariance, parameters)
    pixels = grid_pixels(camera, grid)
    found = np.empty((len(depths_mm), *grid, 3))
    for place, depth in enumerate(depths_mm):
        moved, seen = point_derivatives(
            camera, projector, T_projector_camera, pixels, float(depth), orientation=orientation
        )
        part = moved[..., among]
        variance = np.einsum("...ij,jk,...ik->...i", part, chosen, part)
        lit = np.all((seen > -0.5) & (seen < (projector.width_px - 0.5, projector.height_px - 0.5)), axis=-1)
        found[place] = np.where(lit[..., None], np.sqrt(np.maximum(variance, 0.0)), np.nan)
    return found


def grid_pixels(camera: Pinhole, grid: tuple[int, int]) -> Float64Array:
    """Return x and y (rows, columns, 2) of a grid of pixels that spans the picture, corners included."""
    rows, columns = np.linspace(0, camera.height_px - 1, grid[0]), np.linspace(0, camera.width_px - 1, grid[1])
    return np.stack(np.meshgrid(columns, rows), -1)


def named(covariance: Float64Array, parameters: Sequence[str]) -> tuple[Float64Array, list[int]]:
    """Return the part of a covariance that moves points, and the places of its numbers among `NUMBERS`.

    Raises
    ------
    ValueError
        an unknown parameter of a lens or of the stereo pose, or a covariance of another shape or not finite.
    """
    if np.shape(covariance) != (len(parameters), len(parameters)):
        raise ValueError(
            f"the covariance has shape {np.shape(covariance)}, and {len(parameters)} parameters are named; it has a "
            "row and a column for each"
        )
    strange = [name for name in parameters if name.startswith(_KINDS) and name not in NUMBERS]
    if strange:
        raise ValueError(f"unknown parameters {', '.join(strange)}; known are {', '.join(NUMBERS)}")
    places = [place for place, name in enumerate(parameters) if name in NUMBERS]
    chosen: Any = np.asarray(covariance, np.float64)[np.ix_(places, places)]
    if not np.isfinite(chosen).all():
        raise ValueError("the covariance is not finite: some number is not determined by the poses; take more of them")
    return chosen, [NUMBERS.index(parameters[place]) for place in places]
