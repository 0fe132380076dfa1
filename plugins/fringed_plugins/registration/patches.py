"""A surface as a patch for every pixel: smoothed point, tangents, normal and second fundamental form.

Owns the least-squares quadratic of a square window of the grid, of all points at once, which window serves, what it
cuts off, and what a smoothed point is worth. A patch is usable only where its whole window is valid. Knows nothing of
a second view.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.footpoints import fit_projection
from fringed_plugins.registration.normals import BoolArray, complete, healed
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray
from fringed_plugins.registration.window_kernels import build, gather, truncations

Array = npt.NDArray[Any]
WINDOWS_PX = (7, 5, 3)
TRUNCATED = 0.5  # a window is too large whose fit misses its middle by more than this many noises
STEADY = 0.05  # standard deviation of slopes: squared it is little beside what the normals of a body differ by
STEEP = 2.0  # resolutions: pixels that are longer average nothing
_SAMPLES = 4000


@dataclass(frozen=True)
class Patches:
    """Patches of one surface, relative to its `origin`.

    `table` (height, width, 15) float32: point, derivatives along columns and rows, unit normal towards the
    sensor, and the second fundamental form (e, f, g) for steps of one pixel; meaningless where not `usable`.
    """

    surface: Surface
    table: Array
    usable: BoolArray
    window_px: int

    @property
    def gain(self) -> float:
        """The variance of a smoothed point in units of one point's."""
        return quadratic(self.window_px)[1]

    @cached_property
    def projection(self) -> FloatArray:
        """The matrix (3, 4) that takes points to (column, row)."""
        return fit_projection(self.surface)

    @cached_property
    def errors(self) -> Array:
        """The points' deviation along the ray in mm, and the mean square in mm^2 of what patches cut off.

        (height, width, 2) float32. Third derivatives are in no patch.

        With x_u from windows of side w, S0 = w and S2, S4 the sums of u^2, u^4, a patch is off at (u, v) by
        (u^3 - u S4 / S2) x_uuu / 6 + u (v^2 - S2 / S0) x_uvv / 2, and the same of v; meant over one pixel.
        """
        u = np.arange(self.window_px, dtype=np.float64) - self.window_px // 2
        a, b = float((u**4).sum() / (u @ u)), float(u @ u / self.window_px)
        second, fourth, sixth = 1 / 12, 1 / 80, 1 / 448  # moments of one pixel
        along = (sixth - 2 * a * fourth + a * a * second) / 36
        across = second * (fourth - 2 * b * second + b * b) / 4
        out = np.empty((*self.usable.shape, 2), np.float32)
        out[..., 0] = self.surface.noise_mm if self.surface.sigma is None else self.surface.sigma
        truncations(self.table, self.usable, along, across, out)
        return out

    def sample(self, most_points: int) -> tuple[FloatArray, Array, float]:
        """Return smoothed points, normals, areas of a pixel (n, 7), flat pixels (n,), how many points one stands for.

        Every s-th column and row; while s is at most half the window no point is lost.
        """
        s = max(1, int(np.ceil(np.sqrt(self.usable.sum() / most_points))))
        rows, columns = np.nonzero(self.usable[s // 2 :: s, s // 2 :: s])
        pixels = (rows * s + s // 2) * self.usable.shape[1] + columns * s + s // 2
        out = np.empty((len(pixels), 7))
        gather(self.table.reshape(-1, 15), pixels, out)
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
    return _built(surface, (window_px,) if window_px else WINDOWS_PX)


def sharp(surface: Surface) -> Patches:
    """Return the patches that err least: of the smallest window whose slopes are steady, so that noise biases nothing.

    Where every point is used, a wider window tells no more of a motion, but what it cuts off a curved surface
    differs from view to view. Where a pixel is longer than two resolutions, near a silhouette, even three pixels
    cut off more than they average: there a patch goes through its own point.

    Raises
    ------
    ValueError
        no window is complete anywhere.
    """
    shaky = [window for window in WINDOWS_PX if slope_noise(surface, window) >= STEADY]  # the smallest ones
    windows = WINDOWS_PX[max(len(WINDOWS_PX) - len(shaky) - 1, 0) :]
    return _built(surface, windows, (STEEP**2 + 1) * surface.spacing_mm**2)


def _built(surface: Surface, windows_px: tuple[int, ...], steep_mm2: float = np.inf) -> Patches:
    """Return the patches of the first window that the surface is smooth over, else of the last one."""
    whole, filled = healed(surface.xyz, surface.valid)
    made: Patches | None = None
    for window in windows_px:
        usable = complete(filled, window) & surface.valid
        if not usable.any():
            continue
        made = Patches(surface, table_of(whole, usable, window, steep_mm2), usable, window)
        if _smooth_over(surface, made.table, usable, window):
            break
    if made is None:
        raise ValueError(
            f"the {surface.name} has no complete window of {windows_px[-1]} pixels: its valid region is too torn"
        )
    return made


def table_of(xyz: Array, usable: BoolArray, window_px: int, steep_mm2: float = np.inf) -> Array:
    """Return the patches' table (height, width, 15) of points (height, width, 3) float32; see `Patches`.

    A pixel without a tangent plane (coincident points) becomes unusable, in place. Where the tangents' squares add up
    to more than `steep_mm2` the point is the given one.
    """
    table = np.empty((*usable.shape, 15), np.float32)
    xyz = np.ascontiguousarray(xyz, np.float32)
    build(xyz, window_px // 2, quadratic(window_px)[0], usable, steep_mm2, table)
    return table


def slope_noise(surface: Surface, window_px: int) -> float:
    """Return the standard deviation of slopes from windows of this side."""
    half = np.arange(window_px) - window_px // 2
    return surface.noise_mm / (surface.spacing_mm * float(np.sqrt(window_px * (half @ half))))


def worth(window_px: int, stride_px: int) -> float:
    """Return how many points' information on slow changes one of the smoothed points at each stride-th pixel has.

    A sum over samples weighs a pixel by the windows that it lies in: even weights lose nothing.

    Examples
    --------
    >>> round(worth(7, 1), 6), round(worth(7, 3), 1), round(worth(3, 2), 1)
    (1.0, 6.6, 1.1)
    """
    u = np.arange(window_px, dtype=np.float64) - window_px // 2
    w = quadratic(window_px)[0]
    weights = w[0] + w[1] * u[:, None] ** 2 + w[2] * u[None] ** 2
    place = np.arange(window_px) % stride_px
    summed = np.zeros((stride_px, stride_px))
    np.add.at(summed, (place[:, None], place[None]), weights)
    return float(1 / (summed**2).sum())


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
    gain = 2.0 * np.sqrt(quadratic(window_px)[0][4])  # the variance of the coefficient of u^2
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
