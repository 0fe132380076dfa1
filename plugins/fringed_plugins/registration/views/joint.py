"""The poses of all views at once, on the surfaces themselves: no pair is better off than another.

Owns the loop over pairs, the step of all poses, and the joint covariance. Starts where a graph or a chain of pairs
has ended. Knows nothing of how that was found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fringed_plugins.registration.plane import motion
from fringed_plugins.registration.result import Iteration, Report, silent
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray, checked, inverse, orthonormal, translation
from fringed_plugins.registration.views.holding import held, inverted, step
from fringed_plugins.registration.views.motions import adjoint
from fringed_plugins.registration.views.pairing import (
    Meeting,
    Sayings,
    View,
    by_closest_points,
    count_of,
    overlapping,
    rms_of,
    sharp_patches,
)
from fringed_plugins.registration.views.robust import Sums

STILL = 0.05  # of the motions' own standard errors
SWING = 0.3  # the same for three steps in a row: feet at the rim come and go
EXACT = 1e-7  # of the extent: motions below are rounding
WORSE = 1.02  # of the start's residual: feet come and go
LOST = 0.8  # of the start's pairs

Poses = dict[int, FloatArray]
Pairs = Sequence[tuple[int, int]]


@dataclass(frozen=True)
class Wish:
    """How to refine: points a view in both stages, their iterations, and which pairs of views count.

    `least_share` is the part of a view that has to lie on another one for the two to be a pair.
    """

    coarse_points: int = 2000
    coarse_iterations: int = 8
    fine_points: int = 20_000
    fine_iterations: int = 15
    least_share: float = 0.15
    threads: int = 1


@dataclass(frozen=True)
class PairFit:
    """How well a pair fits in the end: the RMS of its pairs and what the noise alone would give, in mm."""

    i: int
    j: int
    points: int
    rms_mm: float
    expected_mm: float


@dataclass(frozen=True)
class Joint:
    """The refined poses by view; see `refine_all`.

    `covariance` (6 n, 6 n) belongs to the small motions (rotation vector in rad, translation in mm) of the views of
    `order`, in the model's frame about its origin, made after their poses; None where `converged` is not.
    """

    T_model_view: dict[int, FloatArray]
    order: tuple[int, ...]
    covariance: FloatArray | None
    pairs: tuple[PairFit, ...]
    rms_before_mm: float
    rms_mm: float
    converged: bool
    reason: str
    history: tuple[Iteration, ...]

    def covariance_of(self, view: int) -> FloatArray | None:
        """Return the covariance (6, 6) of one view's pose, zero for the reference."""
        if view not in self.order or self.covariance is None:
            return None if self.covariance is None or view not in self.T_model_view else np.zeros((6, 6))
        at = 6 * self.order.index(view)
        return self.covariance[at : at + 6, at : at + 6]


def refine_all(
    surfaces: Sequence[Surface],
    T_model_view: Mapping[int, FloatArray],
    reference: int = 0,
    pairs: Pairs | None = None,
    wish: Wish | None = None,
    report: Report = silent,
) -> Joint:
    """Return the poses that bring all overlapping surfaces together best, from `T_model_view` on.

    Distances along normals of every pair of views enter one linear system over all poses, so that the error of a
    closed loop is shared out by what the surfaces say. A few closest points first, then smoothed points at the feet
    of their perpendiculars on the other views' patches, in both directions, under Tukey's weights. Nothing is
    better than the start: then the start is returned, and said.

    Parameters
    ----------
    surfaces
        prepared views.
    T_model_view
        poses (4, 4) by view, within some resolutions of the right ones; views without one take no part.
    reference
        the view that stays.
    pairs
        which views overlap; found from the poses when left out.
    wish
        points, iterations and the least overlap.
    report
        hears (fraction, text) several times a second and may raise to stop the work.

    Raises
    ------
    ValueError
        fewer than two poses, a reference without one, pairs of views that have none, no overlap.

    References
    ----------
    Chen & Medioni 1992; all views in one system: Bergevin, Soucy, Gagnon & Laurendeau 1996, Pulli 1999.
    """
    wish = wish or Wish()
    poses = {view: checked(T, f"T_model_view of view {view}") for view, T in T_model_view.items()}
    _require(len(surfaces), poses, reference, pairs)
    return _Refinement(surfaces, poses, reference, wish, report).run(pairs)


def _require(count: int, poses: Mapping[int, FloatArray], reference: int, pairs: Pairs | None) -> None:
    strange = [view for view in poses if not 0 <= view < count]
    if len(poses) < 2 or strange or reference not in poses:
        raise ValueError(
            f"poses of the views {sorted(poses)} with view {reference} as the reference; expected two or more of "
            f"{count} views, counted from 0, the reference among them"
        )
    for i, j in pairs or ():
        if i == j or i not in poses or j not in poses:
            raise ValueError(f"pair {i}-{j}; expected two different views that have a pose: {sorted(poses)}")


@dataclass(frozen=True)
class _Stage:
    name: str
    iterations: int


class _Refinement:
    """Poses between the surfaces' origins and the model's middle: there rotations and translations part."""

    def __init__(
        self, surfaces: Sequence[Surface], poses: Mapping[int, FloatArray], reference: int, wish: Wish, report: Report
    ) -> None:
        self.surfaces, self.reference, self.wish, self.report = surfaces, reference, wish, report
        self.T_reference = poses[reference]
        self.middle = np.mean([(T @ np.append(surfaces[view].origin, 1.0))[:3] for view, T in poses.items()], axis=0)
        self.start = {
            view: translation(-self.middle) @ T @ translation(surfaces[view].origin) for view, T in poses.items()
        }
        self.order = tuple(view for view in sorted(poses) if view != reference)
        self.size = max(surfaces[view].diagonal_mm for view in poses)
        self.history: list[Iteration] = []
        self.views: dict[int, View] = {}

    def run(self, pairs: Pairs | None) -> Joint:
        """Find the pairs, go through both stages, and compare with the start."""
        for number, view in enumerate(sorted(self.start)):
            self.report(0.2 * number / len(self.start), f"patches of the {self.surfaces[view].name}")
            self.views[view] = View(sharp_patches(self.surfaces[view]), self.wish.fine_points)
        known = (
            overlapping(self.views, self.start, self.wish.least_share, self.report)
            if pairs is None
            else sorted({(min(p), max(p)) for p in pairs})
        )
        if not known:
            raise ValueError(
                f"no two views overlap by {self.wish.least_share:.0%} where their poses put them; "
                "check the poses, or name the pairs"
            )
        meetings = {(i, j): Meeting(self.views[i], self.views[j]) for p in known for i, j in (p, p[::-1])}
        before = self._fine(self.start, meetings)
        coarse, _, _ = self._descend(self.start, _Stage("joint coarse", self.wish.coarse_iterations), known)
        reached, settled, reason = self._descend(coarse, _Stage("joint fine", self.wish.fine_iterations), meetings)
        said = self._fine(reached, meetings)
        first, last = rms_of(before), rms_of(said)
        worse = last > WORSE * first or count_of(said) < LOST * count_of(before)
        if worse:
            reason = (
                f"the residual is {last:.4g} RMS of {count_of(said)} pairs; the start has {first:.4g} of "
                f"{count_of(before)} and is kept"
            )
            reached, said = self.start, before
        covariance, loose = self._covariance(reached, said)
        converged = settled and not worse and not loose
        self.report(1.0, "all poses refined" if converged else "poses not refined")
        return Joint(
            self._full(reached), self.order, covariance if converged else None, _fits(said), first, rms_of(said),
            converged, loose or reason, tuple(self.history),
        )  # fmt: skip

    def _coarse(self, poses: Poses, pairs: Pairs) -> Sayings:
        """Return what closest points say of every pair."""
        said = {}
        for i, j in pairs:
            self.report(0.3, f"joint coarse: pair {i}-{j}")
            T = inverse(poses[i]) @ poses[j]
            found = by_closest_points(self.surfaces[i], self.surfaces[j], T, self.wish.coarse_points, self.wish.threads)
            if found is not None:
                said[i, j] = found
        return said

    def _fine(self, poses: Poses, meetings: Mapping[tuple[int, int], Meeting]) -> Sayings:
        """Return what feet say of every pair, in both directions."""
        counts, seen_by = {}, {view: np.ones(len(self.views[view])) for view in poses}
        for (i, j), meeting in meetings.items():
            self.report(0.7, f"joint fine: pair {i}-{j}")
            counts[i, j] = meeting.meet(inverse(poses[i]) @ poses[j])
            seen_by[j] += counts[i, j]
        said = {}
        for (i, j), meeting in meetings.items():
            self.report(0.7, f"joint fine: pair {i}-{j}")
            found = meeting.say(counts[i, j], seen_by[j])
            if found is not None:
                said[i, j] = found
        return said

    def _descend(
        self, poses: Poses, stage: _Stage, pairs: Pairs | Mapping[tuple[int, int], Meeting]
    ) -> tuple[Poses, bool, str]:
        """Return the poses after the steps of one stage, whether they stand still, and why it stopped."""
        still = 0
        for _ in range(stage.iterations):
            said = self._fine(poses, pairs) if isinstance(pairs, Mapping) else self._coarse(poses, pairs)
            if not said:
                return poses, False, f"{stage.name}: no pair of views meets any more"
            H, g = self._system(poses, said)
            small = step(H, g)
            poses = self._moved(poses, small)
            each = small.reshape(-1, 6)
            turn, shift = (float(np.linalg.norm(each[:, k : k + 3], axis=1).max()) for k in (0, 3))
            self.history.append(Iteration(rms_of(said), count_of(said), 0.0, turn, shift, stage.name))
            self.report(0.7, f"{stage.name}: {rms_of(said):.4g} RMS of {len(said)} pairs")
            errors = float(np.sqrt(max(float(small @ H @ small), 0.0) / len(small)))
            still = still + 1 if errors < SWING else 0
            if errors < STILL or still == 3 or turn * self.size + shift < EXACT * self.size:
                return poses, True, "the motions fell below their own uncertainty"
        return poses, False, f"{stage.iterations} steps without standing still"

    def _system(self, poses: Poses, said: Sayings) -> tuple[FloatArray, FloatArray]:
        """Return the normal equations of the motions of the views of `order`, in the model's frame about its middle."""
        sums = Sums(self.order)
        for (i, j), one in said.items():
            J = adjoint(inverse(poses[i]))
            sums.add(i, j, J.T @ one.H @ J, J.T @ one.g)
        return sums.H, sums.g

    def _moved(self, poses: Poses, small: FloatArray) -> Poses:
        moved = dict(poses)
        for view, one in zip(self.order, small.reshape(-1, 6), strict=True):
            moved[view] = orthonormal(motion(one) @ poses[view])
        return moved

    def _full(self, poses: Poses) -> Poses:
        """Return the poses between the views' own frames and the reference's."""
        back = translation(self.middle)
        full = {view: back @ T @ translation(-self.surfaces[view].origin) for view, T in poses.items()}
        return full | {self.reference: self.T_reference}

    def _covariance(self, poses: Poses, said: Sayings) -> tuple[FloatArray | None, str]:
        """Return the joint covariance about the model's origin, or which view nothing holds."""
        H, _ = self._system(poses, said)
        for at, view in enumerate(self.order):
            weight = sum(one.weight for pair, one in said.items() if view in pair)
            block = H[6 * at : 6 * at + 6, 6 * at : 6 * at + 6]
            found, needed = held(block, poses[view], self.views[view], weight)
            if found < needed:
                return None, (
                    f"the {self.surfaces[view].name} is not held in every direction by the others "
                    f"(information {found:.1e}, needed {needed:.1e})"
                )
        C = inverted(H)
        if C is None:
            return None, "views are held among each other, but not by the reference"
        J = np.kron(np.eye(len(self.order)), adjoint(translation(self.middle)))
        covariance: FloatArray = J @ C @ J.T
        return 0.5 * (covariance + covariance.T), ""


def _fits(said: Sayings) -> tuple[PairFit, ...]:
    return tuple(PairFit(i, j, one.count, one.rms_mm, one.expected_mm) for (i, j), one in said.items())
