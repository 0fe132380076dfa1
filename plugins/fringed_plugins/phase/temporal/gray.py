"""Gray code, alone or with phase-shifted fringes, to an absolute phase.

Owns how a code's position becomes a fringe order, and when a pixel is dropped; bits are read in `graybits`. With
fringes of one period the order is the one whose phase lies nearest to the code's position; with several, the most
likely one (as in `joint`) among those near it. Knows no contract.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.cleaning import clean
from fringed_plugins.phase.decode import Keep, readable
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.projection.graycode import Code
from fringed_plugins.phase.shifts import Group, style_ripple_rad
from fringed_plugins.phase.temporal.absolute import judged, search_for, wrapped_phases
from fringed_plugins.phase.temporal.correction import SURE_SIGMAS, Evidence
from fringed_plugins.phase.temporal.gray_kernel import order_rows, ruler
from fringed_plugins.phase.temporal.gray_windows import Viewer
from fringed_plugins.phase.temporal.graybits import BitFrames, layout_of, positions
from fringed_plugins.phase.temporal.joint import Orders

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]

LOW_MODULATION, FRINGE_ORDER, OUT_OF_RANGE = 2, 4, 16
_SYSTEMATIC_RAD = 0.02  # what no phase is better than, besides the ripples of its harmonics
_NARROW = 0.75  # cells up to this part of a period count fringes without the help of other periods


def decode_gray_fringes(
    frames: Array,
    groups: Sequence[Group],
    bits: BitFrames,
    noise: NoiseModel,
    thresholds: Thresholds,
    size_px: int,
    *,
    keep: Keep = Keep(),  # noqa: B008 (frozen)
    threads: int = 0,
) -> Decoded:
    """Return the absolute phase of the last of `groups`, long period to short, its order counted by a Gray code.

    A pixel is `FRINGE_ORDER` where a bit or the order next to the one taken is less than 4.5 standard deviations away.

    Raises
    ------
    ValueError
        cells of more than the periods can tell apart.

    References
    ----------
    Sansoni, Carocci & Rodella 1999; Zhang et al. 2012 (complementary code).
    """
    check_cells(bits.code, groups)
    seen = wrapped_phases(frames, groups, noise, thresholds, threads)
    several = len(groups) > 1  # one period alone contradicts nothing
    ripple_rad = max(style_ripple_rad(group, thresholds.gamma) for group in groups) if several else 0.0
    systematic_rad = math.hypot(_SYSTEMATIC_RAD, ripple_rad)
    search = search_for(groups, noise, size_px, systematic_rad=systematic_rad, combine=several)
    layout = layout_of(bits, noise, len(groups[-1].frames))
    found = positions(frames, layout, seen.background, thresholds.saturation_dn, threads)
    shape = seen.background.shape
    orders = Orders(*(np.empty(shape, np.float32) for _ in Orders._fields))
    maps = (seen.wrapped_rad, seen.modulation, seen.background)
    rules = (search, ruler(bits.code, groups[-1].period_px))
    run_rows(order_rows, shape[0], maps, found, rules, orders, threads=threads)
    narrow = bits.code.cell_px <= _NARROW * groups[-1].period_px
    stack = readable(frames)
    evidence = Evidence(stack, groups, noise, size_px, view=Viewer(bits, layout, groups[-1], noise), windows=narrow)
    seen = seen._replace(rejected=seen.rejected | found.rejected)
    return judged(seen, orders, evidence, thresholds, keep=keep, threads=threads)


def check_cells(code: Code, groups: Sequence[Group]) -> None:
    """Check that the cells are narrow enough to count the fringes.

    Raises
    ------
    ValueError
        cells of more than one period of the only fringes, or than the periods' beat.
    """
    from fringed_plugins.phase.temporal.sets import repeat_px

    periods = [group.period_px for group in groups]
    beat = periods[0] if len(periods) == 1 else repeat_px(periods, int(4 * code.cell_px)) or 4 * code.cell_px
    if code.cell_px > beat * (1 + 1e-6):
        raise ValueError(
            f"cells of {code.cell_px:.5g} px cannot count fringes that repeat after {beat:.5g} px: a cell holds more "
            f"than one of them; use cells of {beat / 2:.5g} px"
        )


def decode_gray(
    frames: Array, bits: BitFrames, noise: NoiseModel, thresholds: Thresholds, size_px: int, *, threads: int = 0
) -> Decoded:
    """Return a Gray code's own absolute phase: two cells a turn, the middle of the cell or the edge that a pixel is at.

    Raises
    ------
    ValueError
        bits with nothing to compare them with.
    """
    if not bits.compared:
        raise ValueError(
            "the bits have neither complements nor a white and a black frame, so that nothing tells bright from dark; "
            "add one of these, or fringes for the decoder gray-phase-shift"
        )
    found = positions(frames, layout_of(bits, noise), None, thresholds.saturation_dn, threads)
    code = bits.code
    phase = (np.float32(np.pi) * found.position).astype(np.float32)
    least = np.maximum(thresholds.modulation_dn, 0.0)
    rejected = found.rejected
    rejected[(found.modulation < least) | (found.expected < thresholds.modulation_snr)] |= np.uint16(LOW_MODULATION)
    rejected[found.margin + found.expected < SURE_SIGMAS] |= np.uint16(FRINGE_ORDER)
    low, high = (((edge + 0.5 - code.offset_px) * np.pi / code.cell_px) for edge in (
        thresholds.edge_px - 0.5, size_px - 0.5 - thresholds.edge_px))  # fmt: skip
    rejected[(phase < low) | (phase > high)] |= np.uint16(OUT_OF_RANGE)
    phase[rejected != 0] = np.nan
    # Uniform in a cell, or in the part of it that counts as edge.
    sigma = (np.float32(2 * np.pi / np.sqrt(12)) * found.half_width).astype(np.float32)
    sigma[rejected != 0] = np.nan
    nothing = np.empty((0, 0), np.float32)
    out = Decoded(phase, sigma, found.modulation, found.background, nothing, rejected)
    clean(out, Group((), (), code.period_px, code.initial_rad), thresholds, size_px, threads)
    return out
