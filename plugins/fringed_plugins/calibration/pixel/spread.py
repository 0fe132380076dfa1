"""What a calibration's covariance leaves along every pixel's ray, in a form that a kernel evaluates in passing.

Owns the table: variances on a coarse grid, since they are smooth in the picture and in depth. With w = 1/z, the
variance over z^4 is nearly a polynomial of w of the second degree: exactly so for the derivatives themselves, of a
projector without distortion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.pixel.derivatives import point_derivatives, undistorted
from fringed_plugins.calibration.pixel.uncertainty import grid_pixels, named
from fringed_plugins.calibration.recent import Recent, key_of
from fringed_plugins.calibration.rig import Pinhole

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

GRID = (17, 23)
_PARTS = (0.55, 0.7, 0.85, 1.0, 1.2, 1.5, 1.9)
_KEPT_RIGS = 4
_tables = Recent[Float32Array](_KEPT_RIGS)


def spread_table(
    lenses: tuple[Pinhole, Pinhole], T_projector_camera: Float64Array, known: tuple[Float64Array, Sequence[str]],
    *, around_mm: float, orientation: str = "columns",
) -> Float32Array:  # fmt: skip
    """Return c (3, rows, width) float32: the variance (mm^2) along the ray is z^2 (c0 z^2 + c1 z + c2).

    `lenses` are the camera's and the projector's, `known` the covariance and the names of its numbers, `around_mm` a
    depth in the middle of what is measured. The rows are spread evenly over the picture, linear in between. The last
    few rigs' tables are kept.

    Raises
    ------
    ValueError
        as `uncertainty.trueness_mm`, or a covariance that is not finite.
    """
    camera, projector = lenses
    covariance, parameters = known
    key = key_of(camera.key, projector.key, T_projector_camera, covariance, tuple(parameters), around_mm, orientation)
    return _tables.get(
        key,
        lambda: _table(
            _variances(lenses, T_projector_camera, named(covariance, parameters), around_mm, orientation), camera
        ),
    )


def _variances(
    lenses: tuple[Pinhole, Pinhole], transform: Float64Array, known: tuple[Float64Array, list[int]],
    around_mm: float, orientation: str,
) -> Float64Array:  # fmt: skip
    """Return c0, c1 and c2 at the grid's pixels (3, rows, columns); NaN where points cannot be measured."""
    camera, projector = lenses
    covariance, among = known
    pixels = grid_pixels(camera, GRID)
    xy = undistorted(camera, pixels)
    ray = np.concatenate([xy, np.ones_like(xy[..., :1])], -1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    depths = around_mm * np.array(_PARTS)
    found = np.empty((len(depths), *GRID))
    for place, depth in enumerate(depths):
        moved, _ = point_derivatives(camera, projector, transform, pixels, depth, orientation=orientation)
        along = np.einsum("...i,...ik->...k", ray, moved[..., among])
        found[place] = np.einsum("...i,ij,...j->...", along, covariance, along) / depth**4
    powers = np.stack([depths**0.0, 1 / depths, 1 / depths**2], -1)
    # Relative errors count, so that far and near are alike: each depth is weighed by its own mean.
    weights = 1 / np.maximum(np.nanmean(found, axis=(1, 2)), 1e-300)
    solution = np.linalg.pinv(powers * weights[:, None]) * weights
    return np.asarray(np.tensordot(solution, found, 1))


def _table(nodes: Float64Array, camera: Pinhole) -> Float32Array:
    """Return the grid's nodes spread to every column, those that are NaN filled with the nearest of their row."""
    places = np.linspace(0, camera.width_px - 1, GRID[1])
    table = np.zeros((3, GRID[0], camera.width_px), np.float32)
    for k in range(3):
        for row in range(GRID[0]):
            good = np.isfinite(nodes[k, row])
            if good.any():
                table[k, row] = np.interp(np.arange(camera.width_px), places[good], nodes[k, row][good])
    table.flags.writeable = False
    return table
