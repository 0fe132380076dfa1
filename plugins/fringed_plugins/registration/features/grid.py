"""Principal curvatures of organised range images, with the noise that they carry.

Owns the general parametric form on the grid: derivatives are those of least-squares quadratics in square windows,
valid only where the whole window is. Knows nothing of jumps in depth: who calls has cleared them from `valid`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.features.grid_kernel import grid_curvatures
from fringed_plugins.registration.normals import BoolArray, complete
from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
SENSOR = (0.0, 0.0, 0.0)
FLOOR = 0.02  # of the curvatures' spread: no curvature repeats better between two samplings
_SAMPLES = 10_000


@dataclass(frozen=True)
class Curvatures:
    """Principal curvatures k1 >= k2 (height, width) in 1 / unit of length, positive where the surface bulges out.

    Out is where `normals` (height, width, 3) point: towards the sensor. `sigma_k1` to `sigma_gaussian` are standard
    deviations (height, width) from the points' noise. NaN where not `valid`, normals zero.
    """

    k1: FloatArray
    k2: FloatArray
    normals: FloatArray
    valid: BoolArray
    sigma_k1: FloatArray
    sigma_k2: FloatArray
    sigma_mean: FloatArray
    sigma_gaussian: FloatArray

    @property
    def mean(self) -> FloatArray:
        """The mean curvature H (height, width)."""
        return 0.5 * (self.k1 + self.k2)

    @property
    def gaussian(self) -> FloatArray:
        """The Gaussian curvature K (height, width)."""
        return self.k1 * self.k2

    def normalised(self) -> FloatArray:
        """Return (height, width, 2) k1 and k2 in units of their typical noise: see `in_units_of_noise`."""
        both, noise = np.dstack([self.k1, self.k2]), np.dstack([self.sigma_k1, self.sigma_k2])
        return in_units_of_noise(both, noise, self.valid)


def curvatures(
    xyz: Array,
    valid: Array,
    window_px: int = 7,
    sigma: float | Array | None = None,
    viewpoint: npt.ArrayLike | None = SENSOR,
) -> Curvatures:
    """Return the principal curvatures of a range image.

    With x_u, x_v, x_uu, x_uv, x_vv along columns and rows and n the normal away from the sensor: E, F, G = x_u.x_u,
    x_u.x_v, x_v.x_v; e, f, g = x_uu.n, x_uv.n, x_vv.n; K = (e g - f^2) / (E G - F^2), H = (e G - 2 f F + g E) /
    (2 (E G - F^2)); k1, k2 = H +- sqrt(H^2 - K).

    Parameters
    ----------
    xyz
        (height, width, 3) float points, rows downwards and columns to the right as a camera sees them; what is not
        `valid` may be anything.
    valid
        (height, width), true or nonzero where a point counts.
    window_px
        side of the window, odd, at least 3.
    sigma
        standard deviation of a point along its ray in the points' unit, one number or (height, width); estimated as
        one number when left out.
    viewpoint
        (3,) where rays start; None: noise is along the normal.

    Raises
    ------
    ValueError
        wrong shapes, an even or too small window, a negative sigma.

    References
    ----------
    do Carmo 1976, section 3.3; Besl & Jain, Invariant surface characteristics for 3D object recognition in range
    images, CVGIP 1986; Savitzky & Golay 1964 for the windows.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(-20, 21) * 0.1, np.arange(-20, 21) * 0.1)
    >>> bump = curvatures(np.dstack([x, y, 50 + 0.05 * x**2 + 0.02 * y**2]), np.ones((41, 41)), sigma=0.01)
    >>> float(bump.k1[20, 20].round(3)), float(bump.k2[20, 20].round(3)), int(bump.valid.sum())
    (0.1, 0.04, 1225)
    """
    xyz, inside = _checked(xyz, valid, window_px)
    if sigma is None:
        sigma = ray_noise(xyz, inside)
    variance = _variance(sigma, inside, window_px)
    eye = np.zeros(4) if viewpoint is None else np.array([*np.asarray(viewpoint, np.float64), 1.0])
    if eye.shape != (4,) or not np.isfinite(eye).all():
        raise ValueError(f"the viewpoint is {viewpoint!r}; expected three finite numbers, or None")
    ok = complete(inside, window_px)
    out = np.empty((*ok.shape, 9))
    grid_curvatures(xyz, window_px // 2, np.concatenate([*window(window_px), eye]), variance, ok, out)
    out[~ok] = np.nan
    normals = out[..., 2:5]
    normals[~ok] = 0.0
    return Curvatures(out[..., 0], out[..., 1], normals, ok, *(out[..., k] for k in (5, 6, 7, 8)))


def window(window_px: int) -> tuple[FloatArray, FloatArray]:
    """Return what turns a window's moments into derivatives (4,), and the derivatives' variances (5,).

    Variances of x_u, x_v, x_uu, x_uv, x_vv per pixel in units of a point's; the five are uncorrelated, since their
    weights u, v, u^2 - m, u v, v^2 - m are orthogonal on the square.

    Raises
    ------
    ValueError
        an even or too small window.

    Examples
    --------
    >>> window(3)[1].round(3)
    array([0.167, 0.167, 2.   , 0.25 , 2.   ])
    """
    if window_px < 3 or window_px % 2 == 0:
        raise ValueError(f"a window of {window_px} pixels; expected an odd number of at least 3")
    u = np.arange(window_px, dtype=np.float64) - window_px // 2
    n, square = float(window_px), float(u @ u)
    bend = n * float(((u**2 - square / n) ** 2).sum())
    weights = np.array([1 / (n * square), -2 * square / n / bend, 2 / bend, 1 / square**2])
    slope, curve, twist = 1 / (n * square), 4 / bend, 1 / square**2
    return weights, np.array([slope, slope, curve, twist, curve])


def ray_noise(xyz: Array, valid: BoolArray) -> float:
    """Return the standard deviation of points (height, width, 3) along their rays, from third differences.

    No smooth surface has any; of the two directions of the grid the smoother one counts. Zero without four valid
    neighbours anywhere.
    """
    found = [_third(xyz, valid), _third(xyz.transpose(1, 0, 2), valid.T)]
    known = [value for value in found if value is not None]
    return min(known, default=0.0)


def in_units_of_noise(curvature: FloatArray, sigma: FloatArray, valid: BoolArray, floor: float = FLOOR) -> FloatArray:
    """Return features divided by their typical noise, so that their variance is about one.

    Parameters
    ----------
    curvature, sigma
        (..., m) features and their standard deviations.
    valid
        (...) where they hold.
    floor
        the least noise as a part of the features' spread (10 to 90 per cent), for points without noise.

    Returns
    -------
    array
        (..., m); NaN where not `valid`. One factor for all points keeps equal features equal.

    References
    ----------
    Sharp, Lee, Wehe: ICP registration using invariant features, PAMI 2002, section 3.
    """
    out = np.full(curvature.shape, np.nan)
    if valid.any():
        low, high = np.percentile(curvature[valid], (10, 90), axis=0)
        typical = np.maximum(np.median(sigma[valid], axis=0), floor * (high - low))
        out[valid] = curvature[valid] / np.where(typical > 0, typical, 1.0)
    return out


def _checked(xyz: Array, valid: Array, window_px: int) -> tuple[FloatArray, BoolArray]:
    xyz, valid = np.asarray(xyz), np.asarray(valid)
    if xyz.ndim != 3 or xyz.shape[2] != 3 or xyz.dtype.kind != "f":
        raise ValueError(f"points of shape {xyz.shape} and type {xyz.dtype}; expected (height, width, 3) of floats")
    if valid.shape != xyz.shape[:2]:
        raise ValueError(f"valid has shape {valid.shape}; the points have {xyz.shape[:2]}")
    window(window_px)
    inside = valid != 0
    points = np.ascontiguousarray(xyz, np.float64)
    return points, inside & np.isfinite(points[..., 0] + points[..., 1] + points[..., 2])


def _variance(sigma: float | Array, valid: BoolArray, window_px: int) -> FloatArray:
    """Return the windows' mean variance of a point (height, width)."""
    given = np.asarray(sigma, np.float64)
    if given.shape not in ((), valid.shape):
        raise ValueError(f"sigma has shape {given.shape}; expected one number or {valid.shape}")
    if (
        not (given.min() >= 0 if given.ndim == 0 else (given[valid] >= 0).all())
        or not np.isfinite(given if given.ndim == 0 else given[valid]).all()
    ):
        raise ValueError("sigma is negative or not finite where points count; expected standard deviations")
    if given.ndim == 0:
        return np.full(valid.shape, float(given) ** 2)
    square = np.where(valid, given, 0.0) ** 2
    return np.asarray(cv2.blur(square, (window_px, window_px), borderType=cv2.BORDER_REPLICATE), np.float64)


def _third(xyz: Array, valid: BoolArray) -> float | None:
    """Return the noise that third differences along the first axis say, on a sample; None without any."""
    four = valid[:-3] & valid[1:-2] & valid[2:-1] & valid[3:]
    rows, columns = np.divmod(np.flatnonzero(four), max(valid.shape[1], 1))
    if not rows.size:
        return None
    few = max(1, rows.size // _SAMPLES)
    rows, columns = rows[::few], columns[::few]
    a, b, c, d = (xyz[rows + k, columns] for k in range(4))
    third = d - 3 * c + 3 * b - a
    return float(1.4826 * np.median(np.sqrt(np.einsum("ij,ij->i", third, third))) / np.sqrt(20.0))
