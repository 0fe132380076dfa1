"""The phase shifts that frames really have, from the frames alone.

Owns the estimate, its uncertainty, and the reasons why there is none; `shift_geometry` has the first guess and the
choice of sign. Takes plain arrays; knows no contract.

The advanced iterative algorithm (Wang & Han 2004) fits the pixels with the shifts held, then the shifts with the
pixels held, and so on. Both fits need the frames' n x n matrix of second moments only, and with background and
modulation of every pixel free, what they go down is

    f(shifts) = sum over pixels of |frames - best A + C cos(shift) - S sin(shift)|^2.

It is minimised here directly over the shifts (variable projection: Golub & Pereyra 1973), so that an iteration
costs nothing and a background or modulation that varies does no harm. With three or four frames f does not determine
the shifts, whatever the algorithm: what the fringes themselves tell then decides, that over many of them C and S
are of one size and uncorrelated (as in Vargas, Quiroga & Belenguer 2011). Where f does decide, that counts for nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import optimize

from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.unknown.shift_geometry import DegenerateShifts, aligned, first_guess

Array = npt.NDArray[Any]
Float64Array = npt.NDArray[np.float64]

_TILES = 4  # along each side, for the uncertainty
_UNEVEN = 0.02  # how far C and S may differ by chance, as a part of their size
_DETERMINED = 5  # frames from which on the frames alone determine the shifts
_MOST_MISFIT = 0.35  # of the modulation, beyond which frames are no fringes with shifts
_MOST_SIGMA_RAD = 0.5
_MOST_EVALUATIONS = 200


@dataclass(frozen=True)
class ShiftEstimate:
    """Estimated shifts and their standard deviations, in radians; NaN where not `converged`, and `reason` says why.

    A common shift of all frames cannot be told from the phase: the mean difference to the asked shifts is zero.
    """

    shifts_rad: tuple[float, ...]
    sigma_rad: tuple[float, ...]
    iterations: int
    converged: bool
    reason: str


class _Moments(NamedTuple):
    """Second moments (n, n) of frames without their mean: plain, tapered, and both tile by tile (tiles, n, n)."""

    plain: Float64Array
    tapered: Float64Array
    plain_tiles: Float64Array
    tapered_tiles: Float64Array
    pixels: int
    noise_dn2: float


def estimated_shifts(
    frames: Array,
    asked_rad: Sequence[float],
    noise: NoiseModel,
    *,
    saturation_dn: float = float("inf"),
    pixels: int = 200_000,
) -> ShiftEstimate:
    """Return the shifts of `frames` (n, height, width), n >= 3, near those that were asked for.

    About `pixels` pixels on rows picked by chance are used, none that reaches `saturation_dn` in any frame. The asked
    shifts settle the sign and the common offset. The uncertainty is the larger one of the noise's (Cramer-Rao)
    and of what tiles of the picture differ by (jackknife).

    Raises
    ------
    ValueError
        fewer than three frames, or another number of asked shifts.

    References
    ----------
    Wang & Han 2004; Golub & Pereyra 1973; Vargas, Quiroga & Belenguer 2011.

    Examples
    --------
    >>> u = np.arange(400) / 13.0 + np.arange(300)[:, None] / 90.0
    >>> true = np.array([0.0, 1.2, 2.5, 4.0, 5.1])
    >>> frames = 100 + 40 * np.cos(2 * np.pi * u + true[:, None, None])
    >>> found = estimated_shifts(frames, 2 * np.pi * np.arange(5) / 5, NoiseModel(1.0, 0.0))
    >>> bool(found.converged and np.ptp(np.array(found.shifts_rad) - true) < 1e-6)
    True
    """
    asked = np.asarray(asked_rad, np.float64)
    count = len(frames)
    if count < 3 or asked.shape != (count,):
        raise ValueError(f"{count} frames and {asked.size} asked shifts; three frames or more, with a shift each")
    try:
        moments = _moments(frames, noise, saturation_dn, pixels)
        start = first_guess(moments.tapered, moments.noise_dn2 * moments.pixels)
        noises = (moments.noise_dn2, moments.noise_dn2 * moments.pixels)
        found = optimize.least_squares(
            _residuals, start[1:] - start[0], args=(_root(moments.plain), moments.tapered, noises),
            xtol=1e-10, ftol=1e-12, gtol=1e-12, max_nfev=_MOST_EVALUATIONS,
        )  # fmt: skip
        relative = np.concatenate([[0.0], found.x])
        sigma = _deviations(relative, found.jac, moments)
        _check(relative, sigma, moments, found.status)
        shifts = aligned(relative, asked)
    except DegenerateShifts as error:
        unknown = (float("nan"),) * count
        return ShiftEstimate(unknown, unknown, 0, False, str(error))
    reason = f"the shifts stopped changing after {found.nfev} evaluations"
    return ShiftEstimate(tuple(map(float, shifts)), tuple(map(float, sigma)), int(found.nfev), True, reason)


def _moments(frames: Array, noise: NoiseModel, saturation_dn: float, pixels: int) -> _Moments:
    """Sum the sampled pixels' moments, tile by tile."""
    count, height, width = frames.shape
    wanted = min(max(pixels // width, 4 * _TILES), height)
    rows = np.sort(np.random.default_rng(0).choice(height, wanted, replace=False))
    sample = frames[:, rows].astype(np.float64)
    good = np.isfinite(sample).all(axis=0) & (sample.max(axis=0) < saturation_dn)
    number = int(good.sum())
    if number < 10 * count:
        raise DegenerateShifts(
            f"only {number} of {good.size} sampled pixels are below saturation in every frame; at least {10 * count} "
            "are needed: expose less"
        )
    level = float(sample[:, good].mean())
    centred = np.where(good, sample - sample.mean(axis=0), 0.0)
    taper = np.hanning(height + 2)[1:-1][rows, None] * np.hanning(width + 2)[None, 1:-1]
    taper /= taper[good].mean()
    bands = np.array_split(np.arange(len(rows)), _TILES)
    strips = np.array_split(np.arange(width), _TILES)
    plain, tapered = [], []
    for band in bands:
        for strip in strips:
            part = centred[np.ix_(np.arange(count), band, strip)].reshape(count, -1)
            plain.append(part @ part.T)
            tapered.append((part * taper[np.ix_(band, strip)].ravel()) @ part.T)
    variance = noise.constant_dn2 + noise.slope_dn * max(level, 0.0)
    tiles, soft = np.array(plain), np.array(tapered)
    return _Moments(tiles.sum(axis=0), soft.sum(axis=0), tiles, soft, number, variance)


def _residuals(
    relative: Float64Array, root: Float64Array, tapered: Float64Array, noises: tuple[float, float]
) -> Float64Array:
    """Return what the shifts leave of the frames, in standard deviations, and how uneven C and S are.

    `root` root^T are the frames' moments; `noises` is the variance of a pixel, and summed over all of them.
    """
    basis, frame = _spanned(relative)
    left = (root - frame @ (frame.T @ root)) / np.sqrt(noises[0])
    return np.concatenate([left.ravel(), _unevenness(basis, tapered, noises[1]) / _UNEVEN])


def _cost(relative: Float64Array, plain: Float64Array, tapered: Float64Array, noises: tuple[float, float]) -> float:
    """Return the sum of the squared residuals, from the moments alone."""
    basis, frame = _spanned(relative)
    left = np.trace(plain) - np.sum(frame * (plain @ frame))
    return float(left / noises[0] + np.sum(_unevenness(basis, tapered, noises[1]) ** 2) / _UNEVEN**2)


def _spanned(relative: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return cosines and sines (n, 2) of the shifts, and an orthonormal basis of what they and a constant span."""
    basis = _basis(np.concatenate([[0.0], relative]))
    frame, _ = np.linalg.qr(np.concatenate([np.ones((len(basis), 1)), basis], axis=1))
    return basis, frame


def _basis(shifts: Float64Array) -> Float64Array:
    basis: Float64Array = np.stack([np.cos(shifts), -np.sin(shifts)], axis=1)
    return basis


def _root(moments: Float64Array) -> Float64Array:
    """Return R with R R^T = moments."""
    values, vectors = np.linalg.eigh(moments)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)))


def _unevenness(basis: Float64Array, tapered: Float64Array, noise: float) -> Float64Array:
    """Return (CC - SS, 2 CS) / (CC + SS) of the pixels' sums for these shifts; the noise's part is taken off.

    The frames show their own noise from four on; of three it is `noise`.
    """
    count = len(basis)
    inverse = np.linalg.pinv(basis - basis.mean(axis=0))
    if count > 3:
        noise = max(float(np.linalg.eigvalsh(tapered)[1 : count - 2].mean()), 0.0)
    block = inverse @ (tapered - noise * (np.eye(count) - 1 / count)) @ inverse.T
    size = max(block[0, 0] + block[1, 1], 1e-12)
    return np.asarray([(block[0, 0] - block[1, 1]) / size, 2 * block[0, 1] / size])


def _deviations(relative: Float64Array, jacobian: Array, moments: _Moments) -> Float64Array:
    """Return each shift's standard deviation, the common offset taken off."""
    count = len(relative)
    hessian = jacobian.T @ jacobian
    steps = []
    for plain, tapered in zip(moments.plain_tiles, moments.tapered_tiles, strict=True):
        part = 1 - float(np.trace(tapered) / np.trace(moments.tapered))
        noises = (moments.noise_dn2, moments.noise_dn2 * moments.pixels * part)
        rest = (moments.plain - plain, moments.tapered - tapered, noises)
        steps.append(np.linalg.lstsq(hessian, -_gradient(relative[1:], rest), rcond=None)[0])
    moved = np.concatenate([np.zeros((len(steps), 1)), np.array(steps)], axis=1)
    moved -= moved.mean(axis=1, keepdims=True)  # the common offset
    apart = moved - moved.mean(axis=0)
    jackknife = (len(steps) - 1) / len(steps) * (apart**2).sum(axis=0)
    if count < _DETERMINED:  # the Hessian is that of the assumption there, and only the tiles tell how well it holds
        return np.asarray(np.sqrt(jackknife))
    keep = np.eye(count)[:, 1:] - 1 / count
    noise = np.diag(keep @ np.linalg.pinv(hessian) @ keep.T)
    return np.asarray(np.sqrt(np.maximum(jackknife, noise)))


def _gradient(relative: Float64Array, moments: tuple[Any, Any, Any]) -> Float64Array:
    """Return half the gradient of the sum of squared residuals, by central differences."""
    step = 1e-5
    found = []
    for index in range(len(relative)):
        ahead, behind = relative.copy(), relative.copy()
        ahead[index] += step
        behind[index] -= step
        found.append(_cost(ahead, *moments) - _cost(behind, *moments))
    return np.array(found) / (4 * step)


def _check(relative: Float64Array, sigma: Float64Array, moments: _Moments, status: int) -> None:
    """Raise DegenerateShifts for a fit that means nothing."""
    basis = _basis(relative)
    model = np.concatenate([np.ones((len(relative), 1)), basis], axis=1)
    singular = np.linalg.svd(model, compute_uv=False)
    if singular[-1] < 0.02 * singular[0]:
        raise DegenerateShifts("the estimated shifts do not determine a phase: fewer than three of them differ")
    if status <= 0:
        raise DegenerateShifts(
            f"the shifts still changed after {_MOST_EVALUATIONS} evaluations: the frames hardly determine them"
        )
    frame, _ = np.linalg.qr(model)
    left = float(np.trace(moments.plain) - np.trace(frame.T @ moments.plain @ frame))
    fringes = float(np.trace(moments.plain)) - left
    excess = left - (len(relative) - 3) * moments.noise_dn2 * moments.pixels
    if excess > _MOST_MISFIT**2 * fringes:
        raise DegenerateShifts(
            f"no shifts explain the frames: {np.sqrt(left / fringes):.0%} of the fringes are left over, "
            f"{_MOST_MISFIT:.0%} are allowed; did the object move, or are these no sinusoids of one period?"
        )
    if not np.isfinite(sigma).all() or sigma.max() > _MOST_SIGMA_RAD:
        raise DegenerateShifts(
            f"the shifts are uncertain by {sigma.max():.2g} rad, {_MOST_SIGMA_RAD:g} are allowed: use more frames, "
            "more periods in view, or more light"
        )
