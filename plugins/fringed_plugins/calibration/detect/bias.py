"""Where a circle's image has its centre: not where the image of the circle's centre is.

Owns that difference, which perspective makes of a circle that is tilted; lenses add to it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.pixel.derivatives import lens_derivatives
from fringed_plugins.calibration.rig import Pinhole

Float64Array = npt.NDArray[np.float64]
_AROUND = 64


def ellipse_centres(
    points_mm: Float64Array,
    normal: Float64Array,
    radii_mm: Float64Array,
    matrix: Float64Array,
    distortion: Float64Array,
) -> Float64Array:
    """Return the centre (n, 2) px of each circle's image: the centroid of what the lens makes of it.

    `points_mm` (n, 3) are the circles' centres in the lens's frame, `normal` (3,) that of their plane.

    References
    ----------
    Heikkila 2000, section 2.2 (the bias of circles' centres); the centroid of a polygon by Green's theorem.

    Examples
    --------
    A circle of 10 mm at 100 mm, tilted by 45 degrees: its image's centre lies off the centre's image.

    >>> matrix, tilt = np.diag([1000.0, 1000.0, 1.0]), np.array([0.0, np.sqrt(0.5), np.sqrt(0.5)])
    >>> float(ellipse_centres(np.array([[0.0, 0, 100]]), tilt, np.array([10.0]), matrix, np.zeros(5)).round(2)[0, 1])
    5.02
    """
    normal = normal / np.linalg.norm(normal)
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    angle = np.arange(_AROUND) * (2 * np.pi / _AROUND)
    circle = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(normal, first)
    around = points_mm[:, None] + radii_mm[:, None, None] * circle
    lens = Pinhole(0, 0, matrix, distortion)
    pixels, _, _ = lens_derivatives(lens, around[..., :2] / around[..., 2:])
    middle = pixels.mean(axis=1, keepdims=True)
    x, y = np.moveaxis(pixels - middle, -1, 0)
    xn, yn = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    cross = x * yn - xn * y
    area = cross.sum(axis=1)
    moment = np.stack([((x + xn) * cross).sum(axis=1), ((y + yn) * cross).sum(axis=1)], -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(middle[:, 0] + np.where(area[:, None] != 0, moment / (3 * area[:, None]), 0.0))
