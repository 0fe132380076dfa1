"""Overlapping surfaces as normal equations of their relative motion: by closest points, and foot to foot.

Owns one view's samples, where they fall on the others, and the sums over them. Knows no poses but those it is
given, relative between the surfaces' origins.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.icp import MIN_PAIRS, Settings, pair, weigh
from fringed_plugins.registration.matching import ClosestPoint
from fringed_plugins.registration.patch_kernels import SUMS, accumulate, walk
from fringed_plugins.registration.patches import Patches, sharp, slope_noise, worth
from fringed_plugins.registration.plane import information, jacobian
from fringed_plugins.registration.projective import variance_at
from fringed_plugins.registration.rejection import TUKEY, mad_scale
from fringed_plugins.registration.result import Report
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray, inverse

MIN_FEET = 60
NEAR = 3.0  # resolutions
MOST_PIXELS = 150_000
FEW = 1500  # samples a view that tell which views overlap


@dataclass(frozen=True)
class Said:
    """What a pair says of the small motion of its model, in the reference's frame about its origin.

    `H` (6, 6) and `g` (6,) of half the squared residuals over their variance, `weight` the sum of its inverses;
    `rms_mm` and `expected_mm`, from the noise alone, of the `count` pairs.
    """

    H: FloatArray
    g: FloatArray
    weight: float
    count: int
    rms_mm: float
    expected_mm: float


Sayings = dict[tuple[int, int], Said]  # by (reference, model)


def by_closest_points(reference: Surface, model: Surface, T: FloatArray, points: int, threads: int) -> Said | None:
    """Return what levels of about `points` say; None where they hardly meet."""
    p, q = reference.level(points), model.level(points)
    pairs = pair(p, q, T, ClosestPoint(p, threads), Settings())
    if len(pairs) < MIN_PAIRS:
        return None
    weights, _ = weigh(pairs, 1e-6 * p.spacing_mm)
    rows = jacobian(0.5 * (pairs.points + pairs.partners), pairs.normals)
    g = np.einsum("ni,n->i", rows, weights * pairs.residual_mm)
    rms = float(np.sqrt(np.average(pairs.residual_mm**2, weights=weights)))
    return Said(
        information(rows, weights),
        g,
        float(weights.sum()),
        len(pairs),
        rms,
        float(np.sqrt(np.median(pairs.variance_mm2))),
    )


class View:
    """Samples of one view's patches; `worth` is how many points' information each of them has."""

    def __init__(self, patches: Patches, most_points: int) -> None:
        self.patches = patches
        self.samples, pixels, stands_for = patches.sample(most_points)
        self.variance = variance_at(patches, pixels, self.samples[:, 3:6])
        self.worth = worth(patches.window_px, round(float(np.sqrt(stands_for))))
        self.middle = self.samples[:, :3].mean(0)
        self.radius = float(np.sqrt(((self.samples[:, :3] - self.middle) ** 2).sum(1).mean()))

    @property
    def slope_noise(self) -> float:
        """The standard deviation of a patch's slope."""
        return slope_noise(self.patches.surface, self.patches.window_px)

    def __len__(self) -> int:
        return len(self.samples)


def sharp_patches(surface: Surface) -> Patches:
    """Return the `sharp` patches, at most `MOST_PIXELS` of them: of means where there are more."""
    return sharp(surface.thinned(MOST_PIXELS))


@dataclass
class Meeting:
    """Samples of `model` on the patches of `reference`: `found` (n,) flat pixels or -1, `rows` (n, 8) as `walk` has."""

    reference: View
    model: View
    found: npt.NDArray[np.int64] = field(init=False)
    rows: FloatArray = field(init=False)
    scale: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        self.found = np.full(len(self.model), -1, np.int64)
        self.rows = np.zeros((len(self.model), 8))

    def meet(self, T: FloatArray) -> npt.NDArray[np.bool_]:
        """Walk to the feet at `T`, and return which samples count (n,): all False where they are too few."""
        fixed = self.reference.patches
        walk(self.model.samples, np.vstack([T, fixed.projection]), fixed.table, fixed.usable, self.found, self.rows)
        met = self.found >= 0
        if int(met.sum()) < MIN_FEET:
            self.found[:] = -1
            return np.zeros(len(met), np.bool_)
        self.scale = max(mad_scale(self.rows[met, 6]), 1e-9 * fixed.surface.spacing_mm)
        counts: npt.NDArray[np.bool_] = met & (np.abs(np.where(met, self.rows[:, 6], np.inf)) < TUKEY * self.scale)
        return counts

    def say(self, counts: npt.NDArray[np.bool_], seen_by: FloatArray) -> Said | None:
        """Return what the samples that count say; each is seen by `seen_by` (n,) views, itself included.

        Every pair of views is asked in both directions, and k views of a point make k (k - 1) / 2 pairs of k - 1
        independent distances: the variance is taken k times, twice the half of k.
        """
        at = np.flatnonzero(counts)
        if len(at) < MIN_FEET:
            return None
        fixed = self.reference.patches
        own = self.model.variance[at]
        other = variance_at(fixed, self.found[at], self.rows[at, 3:6])
        expected2 = fixed.gain * float(np.median(own + other))
        # a point of the reference meets as many of the model's as lie in its area
        single = own + other * (self.rows[at, 7] / self.model.samples[at, 6])
        more = max(self.scale**2 - expected2, 0.0) / fixed.gain  # what noise does not explain
        variance = np.full(len(self.model), np.inf)
        variance[at] = (single + more + 1e-30) * seen_by[at]
        sums = np.zeros(SUMS)
        accumulate(self.found, self.rows, variance, self.scale, 0.0, sums)
        H = np.zeros((6, 6))
        H[np.triu_indices(6)] = sums[:21]
        H = (H + np.triu(H, 1).T) * self.model.worth
        rms = float(np.sqrt(sums[28] / sums[27])) if sums[27] > 0 else float("inf")
        each = self.model.worth
        return Said(H, sums[21:27] * each, float(sums[27]) * each, len(at), rms, float(np.sqrt(expected2)))


def overlapping(
    views: Mapping[int, View], poses: Mapping[int, FloatArray], least_share: float, report: Report
) -> list[tuple[int, int]]:
    """Return the pairs of views of which one lies on the other by the least share, where the poses put them."""
    few = {view: View(one.patches, FEW) for view, one in views.items()}
    found: list[tuple[int, int]] = []
    for b in sorted(few):
        report(0.2, f"overlaps of the {few[b].patches.surface.name}")
        for a in sorted(few):
            T = inverse(poses[a]) @ poses[b]
            if a < b and max(share(few[a], few[b], T), share(few[b], few[a], inverse(T))) >= least_share:
                found.append((a, b))
    return found


def share(reference: View, model: View, T: FloatArray) -> float:
    """Return the part of the model's samples that lie on the reference within some resolutions, at `T`."""
    meeting = Meeting(reference, model)
    meeting.meet(T)
    met = meeting.found >= 0
    near = np.abs(meeting.rows[met, 6]) < NEAR * reference.patches.surface.spacing_mm
    return float(near.sum()) / max(len(met), 1)


def count_of(said: Sayings) -> int:
    """Return how many pairs of points all pairs of views have."""
    return sum(one.count for one in said.values())


def rms_of(said: Sayings) -> float:
    """Return the RMS distance over all of them, infinite where there are none."""
    squares = sum(one.count * one.rms_mm**2 for one in said.values())
    return float(np.sqrt(squares / count_of(said))) if said else float("inf")
