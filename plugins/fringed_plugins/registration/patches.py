"""A surface as a patch for every pixel: smoothed point, tangents, normal and second fundamental form.

Owns the least-squares quadratic of a square window of the grid, of all points at once. A patch is usable only
where its whole window is valid. What a window averages counts as often as points lie in it, so that a few of
the smoothed points tell as much of a motion as all points did. Knows nothing of a second view.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.footpoints import fit_projection
from fringed_plugins.registration.normals import BoolArray, complete, healed
from fringed_plugins.registration.patch_kernels import build
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
WINDOWS_PX = (7, 5, 3)
TRUNCATED = 0.5  # a window is too large whose fit misses its middle by more than this many noises
_SAMPLES = 4000


@dataclass(frozen=True)
class Patches:
    """Patches of one surface, relative to its `origin`.

    `table` (height, width, 15) float32: point, derivatives along columns and rows, unit normal towards the
    sensor, and the second fundamental form (e, f, g) for steps of one pixel; meaningless where not `usable`.
    `projection` (3, 4) takes points to (column, row). `gain` is the variance of a smoothed point in units of
    one point's.
    """

    surface: Surface
    table: Array
    usable: BoolArray
    projection: FloatArray
    window_px: int
    gain: float

    def sample(self, most_points: int) -> tuple[FloatArray, Array, float]:
        """Return smoothed points, normals, areas of a pixel (n, 7), flat pixels (n,), how many points one stands for.

        Every s-th column and row; while s is at most half the window no point is lost.
        """
        s = max(1, int(np.ceil(np.sqrt(self.usable.sum() / most_points))))
        rows, columns = np.nonzero(self.usable[s // 2 :: s, s // 2 :: s])
        rows, columns = rows * s + s // 2, columns * s + s // 2
        chosen = self.table[rows, columns]
        pixels = rows * self.usable.shape[1] + columns
        out = np.empty((len(chosen), 7))
        out[:, :3], out[:, 3:6] = chosen[:, :3], chosen[:, 9:12]
        across = chosen[:, [4, 5, 3]] * chosen[:, [8, 6, 7]] - chosen[:, [5, 3, 4]] * chosen[:, [7, 8, 6]]
        out[:, 6] = np.sqrt(np.einsum("ij,ij->i", across, across))
        return out, pixels, float(s * s)


def patches(surface: Surface, window_px: int | None = None) -> Patches:
    """Return the patches of a surface.

    Parameters
    ----------
    surface
        what `surface.prepare` gives.
    window_px
        side of the window, odd, at least 3; None takes the largest of 7, 5 and 3 that the surface is smooth over.

    Raises
    ------
    ValueError
        no window is complete anywhere.

    References
    ----------
    Savitzky & Golay 1964: least squares of a window are a convolution; Besl & Jain 1988 for range images.
    """
    whole, filled = healed(surface.xyz, surface.valid)
    for window in (window_px,) if window_px else WINDOWS_PX:
        usable = complete(filled, window) & surface.valid
        if not usable.any():
            continue
        table = table_of(whole, usable, window)
        if window == WINDOWS_PX[-1] or window_px or _smooth_over(surface, table, usable, window):
            return Patches(surface, table, usable, fit_projection(surface), window, quadratic(window)[1])
    raise ValueError(
        f"the {surface.name} has no complete window of {window_px or WINDOWS_PX[-1]} pixels: its valid region is too "
        "torn"
    )


def table_of(xyz: Array, usable: BoolArray, window_px: int) -> Array:
    """Return the patches' table (height, width, 15) of points (height, width, 3) float32; see `Patches`.

    A pixel without a tangent plane (coincident points) becomes unusable, in place.
    """
    table = np.empty((*usable.shape, 15), np.float32)
    build(np.ascontiguousarray(xyz, np.float32), window_px // 2, quadratic(window_px)[0], usable, table)
    return table


def quadratic(window_px: int) -> tuple[FloatArray, float]:
    """Return what turns a window's moments into a quadratic's coefficients, and its value's variance.

    With u, v = -h .. h, n points a side: sums S0 = n, S2 = sum u^2, S4 = sum u^4.
    """
    u = np.arange(window_px, dtype=np.float64) - window_px // 2
    S0, S2, S4 = float(window_px), float(u @ u), float((u**4).sum())
    # 1, u^2 and v^2 mix: normal equations of those three
    N = np.array([[S0 * S0, S0 * S2, S0 * S2], [S0 * S2, S0 * S4, S2 * S2], [S0 * S2, S2 * S2, S0 * S4]])
    inverse = np.linalg.inv(N)
    weights = np.array([*inverse[0], *inverse[1], *inverse[2], 1 / (S0 * S2), 1 / (S2 * S2)])
    return weights, float(inverse[0, 0])


def curvature_noise(patches: FloatArray, noise: float, window_px: int) -> FloatArray:
    """Return the standard deviation of principal curvatures (n, 2) of patches (n, 15) where points have `noise`.

    Of noise along the normal a second derivative keeps 4 times the variance of its coefficient; a pixel is
    sqrt(E), sqrt(G) long. Of both curvatures that along the longer side is the more certain one: the mean serves.
    """
    S = np.arange(window_px, dtype=np.float64) - window_px // 2
    n, S2, S4 = float(window_px), float(S @ S), float((S**4).sum())
    N = np.array([[n * n, n * S2, n * S2], [n * S2, n * S4, S2 * S2], [n * S2, S2 * S2, n * S4]])
    gain = 2.0 * np.sqrt(np.linalg.inv(N)[1, 1])
    a, b = patches[:, 3:6], patches[:, 6:9]
    area = np.sqrt(np.maximum((a * a).sum(1) * (b * b).sum(1), 1e-300))
    one = np.maximum(gain * noise / area, 1e-300)
    return np.stack([one, one], axis=1)


def _smooth_over(surface: Surface, table: Array, usable: BoolArray, window_px: int) -> bool:
    """Tell whether the quadratics of windows meet the points in their middles within the noise."""
    at = np.flatnonzero(usable)
    at = at[:: max(1, at.size // _SAMPLES)]
    missed = table.reshape(-1, 15)[at, :3] - surface.xyz.reshape(-1, 3)[at]
    scale = 1.4826 * float(np.median(np.sqrt(np.einsum("ij,ij->i", missed, missed))))
    # noise is along the ray alone, so that the length has one degree of freedom; the rest is what the window cuts
    noise = surface.noise_mm * np.sqrt(max(1 - quadratic(window_px)[1], 0.0))
    return bool(scale < (1 + TRUNCATED) * max(noise, 1e-5 * surface.spacing_mm))
