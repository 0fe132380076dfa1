"""What happens to a decoded map once every pixel is known: tests that need its neighbours.

Owns the order of these tests; each of them is a module of its own.
"""

from __future__ import annotations

import numpy as np

from fringed_plugins.phase import neighbours
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.shifts import Group


def clean(decoded: Decoded, finest: Group, thresholds: Thresholds, size_px: int | None, threads: int = 0) -> None:
    """Reject, in place, what its neighbours contradict; `finest` is the group whose phase the map holds.

    `size_px` is the projector's width or height where the phase is absolute, None where it is wrapped.
    """
    if thresholds.similar_neighbours > 0 or thresholds.border_glow > 0:
        alike_rad = _alike_rad(finest, size_px, decoded.phase_rad.shape)
        limits = (alike_rad, thresholds.similar_neighbours, thresholds.border_glow)
        neighbours.drop_strays(decoded.phase_rad, decoded.modulation, decoded.rejected, limits, threads)


def _alike_rad(group: Group, size_px: int | None, shape: tuple[int, ...]) -> float:
    """Return how much neighbours may differ: half a period, or more where the camera is coarser than the fringes.

    A wrapped phase tells only that there is a neighbour.
    """
    if size_px is None:
        return float(2 * np.pi + 1e-3)
    per_pixel_rad = 2 * np.pi * size_px / group.period_px / max(min(shape), 1)
    return float(max(np.pi, 2.5 * per_pixel_rad))
