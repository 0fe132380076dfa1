"""A calibrated rig from views: the adjustment, again and again, until what does not fit is out and deviations are real.

Owns the order of it, the factors that make the stated deviations true, and the choice of the lenses' models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.solve.adjustment import (
    Adjusted,
    Tick,
    Weights,
    adjust,
    all_used,
    free_numbers,
    lens_numbers,
    lens_with,
)
from fringed_plugins.calibration.solve.initial import Size, initial_rig
from fringed_plugins.calibration.solve.observations import Observation, Rig
from fringed_plugins.calibration.solve.projection import CAMERA, PROJECTOR

Float64Array = npt.NDArray[np.float64]

OUTLIER = 6.0  # deviations of the pose's own points from which one is left out
SIGNIFICANT = 4.0  # of its own deviations: a coefficient that is kept
_FLOOR_PX = 1e-4


@dataclass(frozen=True)
class Settings:
    """`k3`: whether the sixth-order distortion is estimated, None: where the data show it."""

    k3: bool | None = None
    rounds: int = 4


def estimate(
    seen: Sequence[Observation], camera_size: Size, projector_size: Size, settings: Settings | None = None,
    *, start: Rig | None = None, tick: Tick | None = None,
) -> Adjusted:  # fmt: skip
    """Return the rig that explains the views, with its covariance; points that do not fit are left out.

    The deviations that came with the points are multiplied by a factor for each side, so that the residuals agree
    with them; the covariance is that of the factors so found. The third radial coefficient of a lens is estimated
    only where it turns out to be four of its own deviations and more.

    Raises
    ------
    ValueError
        views from which no rig can be told.
    """
    chosen = settings or Settings()
    rig = _held(start, chosen) if start else initial_rig(seen, camera_size, projector_size)[0]
    weights = all_used(seen, free_numbers(camera_k3=bool(chosen.k3), projector_k3=bool(chosen.k3)))
    found = adjust(seen, rig, weights, robust=True, tick=tick)
    for _ in range(chosen.rounds):
        weights = refined(seen, found)
        same = _same_points(weights, found.weights) and _near(weights, found.weights)
        found = adjust(seen, found.rig, weights, robust=False, tick=tick)
        if same:
            break
    if chosen.k3 is None:
        found = _with_significant(seen, found, tick)
    return found


def _held(rig: Rig, chosen: Settings) -> Rig:
    """Return where to begin: a third radial coefficient that is not estimated is 0, whatever was found before."""
    if chosen.k3:
        return rig
    lenses = (lens_with(lens, np.append(lens_numbers(lens)[:8], 0.0)) for lens in (rig.camera, rig.projector))
    return rig.with_(**dict(zip(("camera", "projector"), lenses, strict=True)))


def refined(seen: Sequence[Observation], found: Adjusted) -> Weights:
    """Return weights without what is far off, and with factors that make the residuals' deviations true."""
    camera, projector = _sizes(seen, found)
    share = _freedom(seen, found)
    factors = []
    used: list[tuple[npt.NDArray[np.bool_], ...]] = []
    for sizes, able in ((camera, [np.ones(len(o.board_mm), bool) for o in seen]), (projector, [o.lit for o in seen])):
        every = np.concatenate([size[ok] for size, ok in zip(sizes, able, strict=True)])
        typical = float(np.median(every)) / 1.1774 if every.size else 1.0  # the median of a Rayleigh distribution
        kept = tuple(ok & (size < OUTLIER * max(typical, 1e-12)) for size, ok in zip(sizes, able, strict=True))
        left = np.concatenate([size[ok] for size, ok in zip(sizes, kept, strict=True)])
        factors.append(max(float(np.sqrt(np.mean(left**2) / 2 / share)), 1e-9) if left.size else 1.0)
        used.append(kept)
    return Weights(found.weights.free, factors[0], factors[1], used[0], used[1])


def _sizes(seen: Sequence[Observation], found: Adjusted) -> tuple[list[Float64Array], list[Float64Array]]:
    """Return the residuals' lengths (n,) in the deviations that came with the points."""
    camera, projector = [], []
    for observed, part in zip(seen, found.residuals, strict=True):
        camera.append(np.linalg.norm(part.camera / np.maximum(observed.camera_sigma_px, _FLOOR_PX)[:, None], axis=1))
        with np.errstate(invalid="ignore"):
            off = np.linalg.norm(part.projector / np.maximum(observed.projector_sigma_px, _FLOOR_PX), axis=1)
        projector.append(np.nan_to_num(off, nan=np.inf))
    return camera, projector


def _freedom(seen: Sequence[Observation], found: Adjusted) -> float:
    """Return the share of the residuals that is not taken up by the numbers that were estimated."""
    counted = sum(int(used.sum()) for used in (*found.weights.camera_used, *found.weights.projector_used)) * 2
    numbers = int(found.weights.free.sum()) + 6 * len(seen)
    return max((counted - numbers) / max(counted, 1), 0.05)


def _same_points(a: Weights, b: Weights) -> bool:
    pairs = zip((*a.camera_used, *a.projector_used), (*b.camera_used, *b.projector_used), strict=True)
    return all(np.array_equal(one, other) for one, other in pairs)


def _near(a: Weights, b: Weights) -> bool:
    return bool(np.allclose([a.camera_factor, a.projector_factor], [b.camera_factor, b.projector_factor], rtol=1e-3))


def _with_significant(seen: Sequence[Observation], found: Adjusted, tick: Tick | None) -> Adjusted:
    """Free the third radial coefficients, and keep those that are more than their own uncertainty."""
    freed = replace(found.weights, free=free_numbers(camera_k3=True, projector_k3=True))
    tried = adjust(seen, found.rig, freed, robust=False, tick=tick)
    kept = []
    for lens, place in ((tried.rig.camera, CAMERA.start + 8), (tried.rig.projector, PROJECTOR.start + 8)):
        kept.append(abs(lens.distortion[4]) > SIGNIFICANT * np.sqrt(tried.covariance[place, place]))
    if not any(kept):
        return found
    again = replace(found.weights, free=free_numbers(camera_k3=bool(kept[0]), projector_k3=bool(kept[1])))
    settled = adjust(seen, found.rig, again, robust=False, tick=tick)
    return adjust(seen, settled.rig, refined(seen, settled), robust=False, tick=tick)
