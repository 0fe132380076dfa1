"""The least squares behind `regional`: coefficients of every frequency's error from the differences of their maps.

Owns the linear algebra on a sample of the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
Complex64Array = npt.NDArray[np.complex64]
Complex128Array = npt.NDArray[np.complex128]

MULTIPLES = 3  # of N: harmonics N - 1, 2 N - 1, 3 N - 1, together with their mirror images N + 1, ...
POWERS = 3
MOST_PIXELS = 60_000
MIN_PIXELS = 500
_LEAST_SPREAD = 0.01  # of the indicator: below it the blur is the same everywhere
_LARGEST = 0.3  # of the fundamental: what a harmonic is before anything is measured
_INVERSIONS = 12
_OUTLIER = 5 * 1.4826  # medians of absolute deviations


@dataclass(frozen=True)
class Fringes:
    """One frequency: `vector` (height, width) complex64 is modulation exp(i wrapped phase), of `steps` equal steps."""

    vector: Complex64Array
    steps: int
    period_px: float
    initial_rad: float = 0.0


@dataclass(frozen=True)
class _Rows:
    """One frequency's equations, weighted to unit deviation; `first` (rad) are the differences without correction."""

    matrix: Float64Array
    right: Float64Array
    off_rad: Float64Array
    first_rad: Float64Array


class Fit:
    """Coefficients `series` (frequencies, MULTIPLES, POWERS), the finest first; `improve` them round by round."""

    def __init__(self, groups: tuple[Fringes, ...], phase_rad: Float32Array) -> None:
        fine = groups[0]
        found = np.flatnonzero((np.isfinite(phase_rad) & (np.abs(fine.vector) > 0)).ravel())
        if len(found) < MIN_PIXELS:
            raise ValueError(f"{len(found)} pixels have a phase; {MIN_PIXELS} or more tell harmonics apart")
        self._at = found[:: -(-len(found) // MOST_PIXELS)]
        self._groups = groups
        self._measured = phase_rad.ravel()[self._at].astype(np.float64)
        self._vectors = [group.vector.ravel()[self._at].astype(np.complex128) for group in groups]
        self._place = np.zeros(len(self._at))
        self._true = self._measured.copy()
        self._trust: dict[int, tuple[npt.NDArray[np.bool_], float]] = {}
        self.settled = False  # outliers and weights stay as they are from then on
        self.series = np.zeros((len(groups), MULTIPLES, POWERS))
        self.centre, self.spread = 0.0, 1.0
        self.error_rad = np.zeros(len(self._at))
        self.deviation_rad = 0.0
        self.disagreement_rad = (0.0, 0.0)

    @property
    def pixels(self) -> int:
        """How many pixels the fit looks at."""
        return len(self._at)

    def place_blur(self, indicator: Float32Array) -> None:
        """Take the blur indicator (height, width): -1 ... 1 over all but the 0.2 % at either end."""
        values = indicator.ravel()[self._at].astype(np.float64)
        low, high = (float(value) for value in np.percentile(values, (0.2, 99.8)))
        self.centre, self.spread = (low + high) / 2, max((high - low) / 2, _LEAST_SPREAD)
        self._place = np.clip((values - self.centre) / self.spread, -1, 1)

    def largest(self) -> float:
        """Return the largest first harmonic of the finest frequency, over the middle 96 % of the pixels."""
        return float(np.percentile(np.abs(self._harmonics()[0, 0]), 98))

    def improve(self, terms: int) -> float:
        """Do one round of Gauss-Newton with `terms` powers of the indicator; return the error's RMS change (rad)."""
        values, powers = self._harmonics(), self._powers(terms)
        true = self._undone(values)
        waves = self._waves(0, true)
        slope = _slopes(values[0], waves) / (1 + self._turn(0, values[0], waves))
        equations = [self._equations(g, values, (true, slope), powers) for g in range(1, len(self._groups))]
        matrix = np.concatenate([rows.matrix for rows in equations])
        right = np.concatenate([rows.right for rows in equations])
        normal = matrix.T @ matrix
        current = self.series[:, :, :terms].reshape(-1)
        variance = float(right @ right) / max(len(right) - len(current), 1)
        prior = variance / _LARGEST**2
        inverse = np.linalg.inv(normal + prior * np.eye(len(normal)))
        change = inverse @ (matrix.T @ right - prior * current)
        self.series[:, :, :terms] += change.reshape(len(self._groups), MULTIPLES, terms)
        count = MULTIPLES * terms
        design = (slope.T[:, :, None] * powers[:, None, :]).reshape(-1, count)
        covariance = inverse[:count, :count] * variance
        self.deviation_rad = float(np.sqrt(np.mean(np.sum((design @ covariance) * design, axis=1))))
        self.error_rad = self._measured - true
        first, last = (np.concatenate([getattr(rows, name) for rows in equations]) for name in ("first_rad", "off_rad"))
        self.disagreement_rad = (float(np.sqrt(np.mean(first**2))), float(np.sqrt(np.mean(last**2))))
        return float(np.sqrt(np.mean((design @ change[:count]) ** 2)))

    def _equations(
        self, g: int, values: Float64Array, fine: tuple[Float64Array, Float64Array], powers: Float64Array
    ) -> _Rows:
        """Return how the difference of frequency `g` to the finest depends on both frequencies' coefficients."""
        true, slope = fine
        scale = self._groups[0].period_px / self._groups[g].period_px
        expected = self._scaled(g, true)
        waves = self._waves(g, expected)
        off = np.angle(self._vectors[g] * np.exp(-1j * expected) * np.conj(_error_vector(values[g], waves)))
        first = np.angle(self._vectors[g] * np.exp(-1j * self._scaled(g, self._measured)))
        if not self.settled or g not in self._trust:
            keep = np.abs(off) < max(_OUTLIER * float(np.median(np.abs(off))), 1e-4)
            self._trust[g] = keep, 1.0 / max(1.4826 * float(np.median(np.abs(off[keep]))), 1e-5)
        keep, weight = self._trust[g]
        own = _slopes(values[g], waves)
        rows = np.zeros((int(keep.sum()), len(self._groups), MULTIPLES, powers.shape[1]))
        seen = -scale * (1 + self._turn(g, values[g], waves)) * slope
        rows[:, 0] = seen[:, keep].T[:, :, None] * powers[keep, None, :]
        rows[:, g] = own[:, keep].T[:, :, None] * powers[keep, None, :]
        return _Rows(rows.reshape(len(rows), -1) * weight, off[keep] * weight, off[keep], first[keep])

    def _scaled(self, g: int, phase: Float64Array) -> Float64Array:
        """Return the phase of frequency `g` where the finest one's is `phase`."""
        fine, group = self._groups[0], self._groups[g]
        return (phase - fine.initial_rad) * (fine.period_px / group.period_px) + group.initial_rad

    def _powers(self, terms: int) -> Float64Array:
        return np.stack([self._place**j for j in range(terms)], axis=1)

    def _harmonics(self) -> Float64Array:
        """Return q of every frequency and multiple at the samples (frequencies, multiples, samples)."""
        return np.asarray(np.einsum("gkj,sj->gks", self.series, self._powers(POWERS)))

    def _undone(self, values: Float64Array) -> Float64Array:
        """Return the finest true phase at the samples; begins where the last round ended."""
        true = self._true.copy()
        for _ in range(_INVERSIONS):
            waves = self._waves(0, true)
            total = _error_vector(values[0], waves)
            off = true + np.angle(total) - self._measured
            true -= off / (1 + self._turn(0, values[0], waves))
            if np.abs(off).max() < 1e-7:
                break
        self._true = true
        return true

    def _waves(self, g: int, phase: Float64Array) -> Complex128Array:
        """Return exp(-i k N phase) for k = 1, 2, 3 (multiples, samples)."""
        turn = np.exp(-1j * self._groups[g].steps * phase)
        return np.stack([turn, turn * turn, turn * turn * turn])

    def _turn(self, g: int, values: Float64Array, waves: Complex128Array) -> Float64Array:
        """Return how the error changes with the true phase (samples,)."""
        k = np.arange(1, MULTIPLES + 1) * self._groups[g].steps
        change = -1j * np.einsum("k,ks,ks->s", k, values, waves)
        return np.asarray((change / _error_vector(values, waves)).imag)


def _error_vector(values: Float64Array, waves: Complex128Array) -> Complex128Array:
    """Return 1 + sum q_k exp(-i k N phase), whose angle is the error."""
    return np.asarray(1 + np.einsum("ks,ks->s", values, waves))


def _slopes(values: Float64Array, waves: Complex128Array) -> Float64Array:
    """Return how the measured phase changes with each q at one true phase (multiples, samples)."""
    return np.asarray((waves / _error_vector(values, waves)).imag)
