"""How long a flip takes to become light, from exposures around black-white transitions.

Owns the model, where to sample next, and the estimate; pure. After a flip the light stays as it was for
`latency_s`, then goes exponentially to its new level; a frame holds the mean over its exposure. Times of
a sample are seconds after its flip; its fraction is 0 at the old level and 1 at the new one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringed.data import Array
from fringed.errors import QualityError

DARK, LIT = 0.02, 0.98
OUTLIER = 0.1  # a sample that the model misses by more says no more than that
ACCURACY = 0.01  # of a fraction: flicker, noise
SETTLED = 1e-3
MAX_MISFIT = 0.05
MIN_SAMPLES = 4


@dataclass(frozen=True)
class LatencyResult:
    """`latency_s` from flip to the first light, within `uncertainty_s`; `settle_s` until it is within 0.1 %."""

    latency_s: float
    uncertainty_s: float
    settle_s: float
    samples: int


class LatencyEstimator:
    """Collect samples and say where the next one helps most."""

    def __init__(self, exposure_s: float, longest_s: float = 0.5) -> None:
        self._exposure_s = exposure_s
        self._samples: list[tuple[float, float, float]] = []
        self.earliest_s, self.latest_s = 0.0, longest_s
        self._turn = 0

    @property
    def transition_s(self) -> float:
        """The span after a flip that is not known to be dark or lit."""
        return max(self.latest_s - self.earliest_s, 0.0)

    def add(self, start_s: float, end_s: float, fraction: float) -> None:
        """Take a frame exposed from `start_s` to `end_s` after the flip."""
        if end_s <= 0.0 or not np.isfinite(fraction):
            return
        self._samples.append((start_s, end_s, fraction))
        if fraction < DARK:
            self.earliest_s = max(self.earliest_s, min(end_s, self.latest_s))
        elif fraction > LIT:
            self.latest_s = min(self.latest_s, max(start_s, self.earliest_s))

    def next_offset_s(self) -> float:
        """Return when after its flip the next exposure should begin: spread over what is not known."""
        self._turn += 1
        spread = (0.5 + 0.618034 * (self._turn - 1)) % 1.0
        return self.earliest_s + spread * self.transition_s - self._exposure_s / 2

    def result(self) -> LatencyResult:
        """Return the estimate.

        Raises
        ------
        QualityError
            the samples are too few, or fit no single delay.
        """
        samples = np.array(self._samples)
        if len(samples) < MIN_SAMPLES or samples[:, 2].max() < LIT:
            raise QualityError(
                f"the delay from flip to light cannot be told from {len(samples)} frames, none of them lit; set "
                "acquisition.latency_s by hand, or check that the camera sees the projector"
            )
        latencies = np.linspace(max(self.earliest_s - 0.02, 0.0), self.latest_s, 800)
        decay_s, costs = _fit(samples, latencies)
        misfit = float(np.sqrt(costs.min() / len(samples)))
        if misfit > MAX_MISFIT:
            raise QualityError(
                f"the frames around the flips fit no single delay (misfit {misfit:.3f} of the light, allowed "
                f"{MAX_MISFIT}); measure again, or set acquisition.latency_s by hand"
            )
        likely = latencies[costs <= costs.min() + 4 * max(ACCURACY, misfit) ** 2]
        middle_s, reach_s = float(likely.min() + likely.max()) / 2, float(np.ptp(likely)) / 2
        return LatencyResult(middle_s, max(reach_s, 1e-4), float(-decay_s * np.log(SETTLED)), len(samples))


def light(start_s: Array, end_s: Array, latency_s: Array, decay_s: Array) -> Array:
    """Return the mean light, 0 to 1, of exposures around a transition at `latency_s` with time constant `decay_s`."""
    begin = np.maximum(start_s, latency_s)
    lit = np.maximum(end_s - begin, 0.0)
    missing = decay_s * (np.exp(-(begin - latency_s) / decay_s) - np.exp(-(begin - latency_s + lit) / decay_s))
    mean: Array = (lit - missing) / np.maximum(end_s - start_s, 1e-9)
    return mean


def _fit(samples: Array, latencies: Array) -> tuple[float, Array]:
    """Return the best time constant, and for each delay the least sum of squares."""
    decays = np.geomspace(5e-5, 8e-3, 24)
    costs = np.zeros((len(latencies), len(decays)))
    for start_s, end_s, fraction in samples:
        expected = light(start_s, end_s, latencies[:, None], decays[None, :])
        costs += np.minimum((fraction - expected) ** 2, OUTLIER**2)
    return float(decays[int(np.argmin(costs)) % len(decays)]), costs.min(axis=1)
