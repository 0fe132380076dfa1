"""A smooth, rising curve through measured levels, with its standard deviation.

Owns the fit; knows nothing of frames.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]

_PIECES = 20
_DEGREE = 3
_STRENGTHS = np.logspace(-6, 4, 41)


def monotone_curve(
    greys: Float64Array, light: Float64Array, scatter: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return the light (256,) of each grey level, rising from 0 to 1, and its standard deviation (256,).

    A cubic spline whose coefficients rise, so that it rises too, with a penalty on the third differences of what is no
    power law: most projectors are near one, and only the departure has to be smooth. How strong the penalty is, is
    chosen by generalised cross-validation. Levels weigh by `scatter`. Below the first and above the last level measured
    the spline goes on as it is.

    References
    ----------
    Ramsay 1988 (monotone regression splines); Eilers & Marx 1996 (P-splines); Craven & Wahba 1978 (cross-validation).

    Examples
    --------
    >>> grey = np.linspace(0, 255, 18)
    >>> curve, _ = monotone_curve(grey, (grey / 255) ** 2, np.full(18, 1e-4))
    >>> float(np.abs(curve - (np.arange(256) / 255) ** 2).max().round(3))
    0.0
    """
    from scipy.optimize import nnls

    pieces = max(4, min(_PIECES, len(greys) - 4))
    basis, everywhere = _basis(greys, pieces), _basis(np.arange(256.0), pieces)
    plain = np.linalg.lstsq(everywhere, _power_law(greys, light, scatter), rcond=None)[0]
    penalty = np.diff(np.eye(basis.shape[1]), 3, axis=0)
    weighted, wanted = basis / scatter[:, None], light / scatter
    strength, covariance = _chosen(weighted, wanted - weighted @ plain, penalty)
    rising = np.tril(np.ones((basis.shape[1],) * 2))
    lift = 1.0  # the first coefficient may be a little below 0: nnls wants none negative
    stacked = np.concatenate([weighted, strength * penalty]) @ rising
    target = np.concatenate([wanted + lift * weighted.sum(axis=1), strength * (penalty @ plain)])
    fitted = everywhere @ (rising @ nnls(stacked, target)[0])
    low, high = fitted[0], fitted[-1]
    deviation = np.sqrt(np.einsum("ij,jk,ik->i", everywhere, covariance, everywhere))
    return np.asarray((fitted - low) / (high - low), np.float64), np.asarray(deviation / (high - low), np.float64)


def _power_law(greys: Float64Array, light: Float64Array, scatter: Float64Array) -> Float64Array:
    """Return the best offset + scale (grey / 255)^gamma for 0.3 <= gamma <= 4 at every grey level (256,)."""
    from scipy.optimize import minimize_scalar

    def solved(gamma: float) -> tuple[float, Float64Array]:
        columns = np.stack([np.ones_like(greys), (greys / 255) ** gamma], axis=1) / scatter[:, None]
        solution = np.linalg.lstsq(columns, light / scatter, rcond=None)[0]
        return float(np.sum((columns @ solution - light / scatter) ** 2)), np.asarray(solution, np.float64)

    gamma = float(minimize_scalar(lambda g: solved(float(g))[0], bounds=(0.3, 4.0), method="bounded").x)
    offset, scale = solved(gamma)[1]
    return np.asarray(offset + scale * (np.arange(256) / 255) ** gamma, np.float64)


def _basis(at: Float64Array, pieces: int) -> Float64Array:
    """Return the B-splines (n, pieces + 3) at grey levels (n,)."""
    from scipy.interpolate import BSpline

    inner = np.linspace(0.0, 255.0, pieces + 1)
    knots = np.concatenate([np.zeros(_DEGREE), inner, np.full(_DEGREE, 255.0)])
    # Knots that repeat at the ends carry coefficients at uneven places; averages of the knots are these places, and
    # the penalty's differences are meant over the coefficients' numbers, which is the same but at the very ends.
    return np.asarray(BSpline.design_matrix(at, knots, _DEGREE).toarray(), np.float64)


def _chosen(weighted: Float64Array, wanted: Float64Array, penalty: Float64Array) -> tuple[float, Float64Array]:
    """Return the penalty's strength and the coefficients' covariance, without the constraint."""
    normal, roughness = weighted.T @ weighted, penalty.T @ penalty
    scale = float(np.trace(normal)) / len(normal)
    best, score = 0.0, np.inf
    for strength in np.sqrt(_STRENGTHS * scale):
        hat = weighted @ np.linalg.solve(normal + strength**2 * roughness, weighted.T)
        free = len(wanted) - np.trace(hat)
        value = float(np.sum((wanted - hat @ wanted) ** 2)) * len(wanted) / max(free, 1e-9) ** 2
        if value < score:
            best, score = float(strength), value
    covariance: Float64Array = np.asarray(np.linalg.inv(normal + best**2 * roughness), np.float64)
    return best, covariance
