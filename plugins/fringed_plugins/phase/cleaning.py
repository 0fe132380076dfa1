"""What happens to a decoded map once every pixel is known: tests that need its neighbours.

Owns the order of these tests; each of them is a module of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fringed_plugins.phase import neighbours
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.shifts import Group

if TYPE_CHECKING:
    from fringed_plugins.phase.temporal.correction import Evidence


def clean(
    decoded: Decoded,
    finest: Group,
    thresholds: Thresholds,
    size_px: int | None,
    threads: int = 0,
    *,
    evidence: Evidence | None = None,
) -> None:
    """Reject, in place, what its neighbours contradict; `finest` is the group whose phase the map holds.

    `size_px` is the projector's width or height where the phase is absolute, None where it is wrapped. With
    `evidence`, the frames behind the map, doubtful fringe orders are first settled by what surrounds them.
    """
    _by_light(decoded, thresholds, threads)
    if size_px is not None:
        _settle(decoded, thresholds, evidence, threads)
    if thresholds.similar_neighbours > 0 or thresholds.border_glow > 0:
        alike_rad = _alike_rad(finest, size_px, decoded.phase_rad.shape)
        limits = (alike_rad, thresholds.similar_neighbours, thresholds.border_glow)
        neighbours.drop_strays(decoded.phase_rad, decoded.modulation, decoded.rejected, limits, threads)
    _by_place(decoded, finest, thresholds, size_px, threads)


def _by_light(decoded: Decoded, thresholds: Thresholds, threads: int) -> None:
    """Flag what light and modulation tell: hot pixels, shadow."""
    limits = thresholds.masks
    if decoded.background.size == 0:
        return  # nobody asked for the light
    maps = (decoded.background, decoded.modulation, decoded.rejected)
    if limits.hot_spread > 0:
        from fringed_plugins.phase.masks.hot import flag_hot

        flag_hot(*maps, (limits.hot_spread, limits.hot_dn), threads)
    if limits.hot_pixels:
        from fringed_plugins.phase.masks.hot import flag_listed

        flag_listed(decoded.rejected, limits.hot_pixels)
    if limits.contrast > 0:
        from fringed_plugins.phase.masks.shadow import flag_shadow

        flag_shadow(*maps, (limits.contrast, limits.dark_dn), threads)
    if limits.hot_spread > 0 or limits.hot_pixels or limits.contrast > 0:
        neighbours.blank(decoded.phase_rad, decoded.rejected, threads)


def _settle(decoded: Decoded, thresholds: Thresholds, evidence: Evidence | None, threads: int) -> None:
    """Choose fringe orders again where that is wanted."""
    if evidence is not None and thresholds.window_snr > 0 and decoded.background.size:
        from fringed_plugins.phase.temporal.correction import correct

        correct(decoded, evidence, thresholds, threads)
    if thresholds.masks.order_median_px > 0:
        from fringed_plugins.phase.masks.order_median import settle_by_median

        settle_by_median(decoded.phase_rad, thresholds.masks.order_median_px, threads)


def _by_place(decoded: Decoded, finest: Group, thresholds: Thresholds, size_px: int | None, threads: int) -> None:
    """Flag what the place of kept pixels tells: small islands, repeated projector pixels."""
    limits = thresholds.masks
    if limits.region_px > 1:
        from fringed_plugins.phase.masks.specks import flag_specks

        flag_specks(decoded.rejected, limits.region_px)
    if limits.repeated and size_px is not None:
        from fringed_plugins.phase.masks.repeated import flag_repeated

        scale = (finest.period_px, finest.initial_rad)
        flag_repeated(decoded.phase_rad, decoded.rejected, scale, down=limits.down, threads=threads)
    if limits.region_px > 1 or limits.repeated:
        neighbours.blank(decoded.phase_rad, decoded.rejected, threads)


def _alike_rad(group: Group, size_px: int | None, shape: tuple[int, ...]) -> float:
    """Return how much neighbours may differ: half a period, or more where the camera is coarser than the fringes.

    A wrapped phase tells only that there is a neighbour.
    """
    if size_px is None:
        return float(2 * np.pi + 1e-3)
    per_pixel_rad = 2 * np.pi * size_px / group.period_px / max(min(shape), 1)
    return float(max(np.pi, 2.5 * per_pixel_rad))
