"""Branch-cut spatial unwrapping of one wrapped phase map.

Owns the algorithm's outer steps; the loops are in `cuts`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.unwrap import cuts
from fringed_plugins.unwrap.checking import check_range, sealed, wrapped_phase
from fringed_plugins.unwrap.finishing import finish


class BranchCut(NamedTuple):
    """An unwrapped phase, its regions as in `Unwrapped`, and what the cuts were made from.

    `residues` is their number; `charged` counts the clusters of residues that found no balance within the
    longest cut: around each of them the result depends on the path.
    """

    phase_rad: npt.NDArray[np.floating[Any]]
    regions: npt.NDArray[np.int32]
    sizes: tuple[int, ...]
    residues: int
    charged: int


def unwrap_branch_cut(
    wrapped_rad: npt.NDArray[Any], longest_cut_px: int = 200, min_region_px: int = 1, threads: int = 0
) -> BranchCut:
    """Unwrap a phase (height, width) in [-pi, pi] rad along paths that cross no cut between residues.

    Residues are corners of four pixels around which the wrapped differences add up to a turn. Cuts join
    them in growing boxes of up to `longest_cut_px` until each cluster's charge is 0 or the cluster reaches
    the edge of the picture or of what is known; only residues without a partner are taken, which keeps
    cuts short. Within what the cuts leave connected every path gives the same phase. What they enclose is
    a region of its own, at a multiple of 2 pi that nobody knows; where two regions touch, the pixels of
    the smaller one become NaN, and so do regions of fewer than `min_region_px` pixels.

    Raises
    ------
    ValueError
        no picture; a phase beyond [-pi, pi].

    References
    ----------
    Goldstein, Zebker, Werner 1988, Radio Science 23, 713.

    Examples
    --------
    >>> ramp = np.linspace(0, 20, 50)[None, :] + np.zeros((5, 1))
    >>> result = unwrap_branch_cut(np.angle(np.exp(1j * ramp)))
    >>> bool(np.ptp(result.phase_rad - ramp) < 1e-5), result.residues
    (True, 0)
    """
    original = wrapped_phase(wrapped_rad)
    phase = sealed(np.where(np.isfinite(original), original, np.nan).astype(np.float32))
    check_range(float(np.nanmax(np.abs(phase), initial=0.0)))
    height, width = phase.shape
    charge = np.zeros((height - 1, width - 1), np.int8)
    run_rows(cuts.charge_rows, height - 1, phase, charge, threads=threads)
    blocked = np.zeros(phase.shape, np.uint8)
    residues = int(np.count_nonzero(charge & 1))
    charged = cuts.place_cuts(charge, longest_cut_px, blocked) if residues else 0
    first, turns = np.empty(phase.shape, np.int32), np.empty(phase.shape, np.int32)
    count = cuts.fill(phase.ravel(), width, blocked.ravel(), (first.ravel(), turns.ravel()))
    if count > 1:
        apart = np.zeros(phase.shape, np.uint8)
        cuts.part(first, np.bincount(first.ravel() + 1, minlength=count + 1)[1:], apart)
        first[apart != 0] = -1
    alone = (count, np.arange(count, dtype=np.int32), np.zeros(count, np.int32))
    done = finish(original, (first, turns), alone, min_region_px, threads)
    return BranchCut(done.phase_rad, done.regions, done.sizes, residues, charged)
