"""A table of the phase error against the phase, measured on one surface.

Owns its measurement, from many steps or from a plane, and its use. Right for the fringes, steps, grey levels and blur
it was measured with; on a surface that is blurred otherwise it takes too much or too little. The ways of
`response` and `regional` know no such limit.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

ENTRIES = 256
MULTIPLES = 4
MIN_PIXELS = 500
_DEGREE = 6
_MOST_PIXELS = 100_000
_LEAST_EIGENVALUE = 1e-3  # of the waves' products, each 1/2 where every phase is seen alike


def error_series(
    error_rad: npt.NDArray[np.floating], phase_rad: npt.NDArray[np.floating], steps: int
) -> tuple[Float64Array, float]:
    """Return cosine and sine amplitudes (4, 2) of k N phase, k = 1 ... 4, in `error_rad`, and the RMS of what is left.

    Both arrays may have any shape; NaN is left out, and so are errors beyond five times the median's deviation.

    Raises
    ------
    ValueError
        fewer than 500 pixels, or a phase that covers less than a ripple.

    References
    ----------
    Zhang & Huang 2007, section 3.2 (the error depends on the phase alone); Pan et al. 2009, eq. 11 (its harmonics).
    """
    good = np.isfinite(error_rad) & np.isfinite(phase_rad)
    error, phase = (values[good].astype(np.float64) for values in (error_rad, phase_rad))
    if len(error) < MIN_PIXELS:
        raise ValueError(f"{len(error)} pixels have a phase and a reference; {MIN_PIXELS} or more make a table")
    step = -(-len(error) // _MOST_PIXELS)
    error, phase = error[::step], phase[::step]
    k = np.arange(1, MULTIPLES + 1)
    angles = steps * phase[:, None] * k
    columns = np.concatenate([np.cos(angles), np.sin(angles), np.ones((len(error), 1))], axis=1)
    keep = np.ones(len(error), bool)
    for _ in range(2):
        normal = columns[keep].T @ columns[keep] / max(int(keep.sum()), 1)
        if np.linalg.eigvalsh(normal)[0] < _LEAST_EIGENVALUE:
            raise ValueError(
                "the phases cover less than one ripple of the error; use finer fringes or a larger surface"
            )
        solution = np.linalg.solve(normal, columns[keep].T @ error[keep] / max(int(keep.sum()), 1))
        left = error - columns @ solution
        keep = np.abs(left) < 5 * 1.4826 * np.median(np.abs(left)) + 1e-9
    amplitudes = np.stack([solution[:MULTIPLES], solution[MULTIPLES:-1]], axis=1)
    return amplitudes, float(np.sqrt(np.mean(left[keep] ** 2)))


def series_error(amplitudes: Float64Array, steps: int, phase_rad: npt.ArrayLike) -> Float64Array:
    """Return the error (rad) at true phases; `amplitudes` as `error_series` gives them."""
    phase = np.asarray(phase_rad, np.float64)
    k = np.arange(1, len(amplitudes) + 1)
    angles = steps * phase[..., None] * k
    return np.asarray(np.cos(angles) @ amplitudes[:, 0] + np.sin(angles) @ amplitudes[:, 1])


def table_of(amplitudes: Float64Array, steps: int, entries: int = ENTRIES) -> Float64Array:
    """Return the error (entries,) at the *measured* phases 2 pi i / entries - pi: what a decoder subtracts.

    Examples
    --------
    >>> table = table_of(np.array([[0.0, -0.2]]), 3)
    >>> measured = np.pi / 6 - 0.2  # true phase pi / 6
    >>> bool(abs(measured - np.interp(measured, 2 * np.pi * np.arange(256) / 256 - np.pi, table) - np.pi / 6) < 1e-3)
    True
    """
    true = np.linspace(-2 * np.pi, 2 * np.pi, 16 * entries + 1)
    error = series_error(amplitudes, steps, true)
    measured = 2 * np.pi * np.arange(entries) / entries - np.pi
    order = np.argsort(true + error)
    return np.interp(measured, (true + error)[order], error[order])


def subtract_table(phase_rad: Float32Array, table: Float64Array) -> Float32Array:
    """Return the phase, wrapped or absolute, less the table's error at it; linear between entries, NaN stays."""
    entries = len(table)
    at = (np.asarray(phase_rad, np.float64) + np.pi) * (entries / (2 * np.pi))
    whole = np.floor(np.nan_to_num(at))
    left = np.mod(whole, entries).astype(np.int64)
    closed = np.append(table, table[0])
    error = closed[left] + (closed[left + 1] - closed[left]) * (at - whole)
    return np.asarray(phase_rad - error, np.float32)


def plane_error(phase_rad: Float32Array) -> Float32Array:
    """Return the departure (height, width) of an absolute phase on a plane from a smooth surface, NaN where none.

    A plane's phase is a ratio of linear functions, bent a little by the lenses: a polynomial of degree 6 in both
    directions follows it to less than 1 mrad and cannot follow ripples of many periods.

    Raises
    ------
    ValueError
        fewer than 500 pixels.
    """
    good = np.isfinite(phase_rad)
    rows, columns = np.nonzero(good)
    if len(rows) < MIN_PIXELS:
        raise ValueError(f"{len(rows)} pixels have a phase; {MIN_PIXELS} or more make a plane")
    step = -(-len(rows) // _MOST_PIXELS)
    y, x = (2 * values / max(n - 1, 1) - 1 for values, n in zip((rows, columns), phase_rad.shape, strict=True))
    degrees = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    basis = _chebyshev(x, y, degrees)
    values = phase_rad[good].astype(np.float64)
    keep = np.arange(0, len(values), step)
    for _ in range(2):
        solution = np.linalg.lstsq(basis[keep], values[keep], rcond=None)[0]
        left = values - basis @ solution
        limit = 5 * 1.4826 * float(np.median(np.abs(left))) + 1e-9
        keep = keep[np.abs(left[keep]) < limit]
    out = np.full(phase_rad.shape, np.nan, np.float32)
    out[good] = left
    return out


def _chebyshev(x: Float64Array, y: Float64Array, degrees: list[tuple[int, int]]) -> Float64Array:
    across = np.polynomial.chebyshev.chebvander(x, _DEGREE)
    down = np.polynomial.chebyshev.chebvander(y, _DEGREE)
    return np.stack([across[:, i] * down[:, j] for i, j in degrees], axis=1)
