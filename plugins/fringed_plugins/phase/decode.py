"""Frames to phase: prepares the fused kernel and runs it over the rows.

Owns the choice of thresholds' units and the range of an absolute phase. Takes plain arrays; what a
frame is comes as `shifts.Group`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase import decode_kernel
from fringed_plugins.phase.cleaning import clean
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group, degrees_of_freedom, phase_variance_factor, plan

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]


def decode(
    frames: Array,
    groups: Sequence[Group],
    noise: NoiseModel,
    thresholds: Thresholds,
    size_px: int | None = None,
    *,
    keep_wrapped: bool = False,
    threads: int = 0,
) -> Decoded:
    """Return phase, noise, modulation, background and mask of `frames` (n, height, width).

    With `size_px`, the projector's width or height, the groups are unwrapped from coarse to fine and
    the phase is absolute: `2 pi u / period_px + initial_rad` of the last group. Where the coarsest
    group has exactly one period the range is a circle, so that noise at the projector's border does
    not throw a point to the opposite one. Without `size_px` there is one group and the phase is
    wrapped. `frames` are uint8, uint16 or float32.

    Raises
    ------
    ValueError
        no group, several without `size_px`, or a coarsest group of more than one period.

    References
    ----------
    Greivenkamp 1984 (least squares); Zuo et al. 2016, section 3 (hierarchical unwrapping).
    """
    if not groups or (size_px is None and len(groups) != 1):
        raise ValueError(f"{len(groups)} groups of frames; a wrapped phase needs exactly one, an absolute one or more")
    shape = frames.shape[1:]
    out = Decoded(
        phase_rad=np.empty(shape, np.float32),
        sigma_rad=np.empty(shape, np.float32),
        modulation=np.empty(shape, np.float32),
        background=np.empty(shape, np.float32),
        wrapped_rad=np.empty(shape if keep_wrapped else (0, 0), np.float32),
        rejected=np.empty(shape, np.uint16),
    )
    stack = frames.view()
    stack.flags.writeable = False  # one compiled kernel for read-only and writable frames
    limits = _limits(groups, noise, thresholds, size_px)
    run_rows(decode_kernel.decode_rows, shape[0], stack, plan(groups), limits, out, threads=threads)
    clean(out, groups[-1], thresholds, size_px, threads)
    return out


def _limits(
    groups: Sequence[Group], noise: NoiseModel, thresholds: Thresholds, size_px: int | None
) -> decode_kernel.Limits:
    dof = max(degrees_of_freedom(groups), 1)
    last = groups[-1]
    absolute = size_px is not None
    cut, first_cut, wrap, low, high = _range(groups, size_px, thresholds.edge_px) if size_px else (0.0,) * 5
    numbers = {
        "noise_constant": noise.constant_dn2,
        "noise_slope": noise.slope_dn,
        "phase_factor": phase_variance_factor(last.shifts_rad),
        "saturation": thresholds.saturation_dn,
        "modulation": thresholds.modulation_dn,
        "modulation_snr2": thresholds.modulation_snr**2,
        "residual_sigma2": _chi_square_limit(dof),
        "residual_part2": dof * thresholds.residual**2,
        "misfit_turns": thresholds.order_turns,
        "drop2": thresholds.modulation_drop**2,
        "first_turns": first_cut,
        "wrap_turns": wrap,
        "cut_turns": cut,
        "low_turns": low,
        "high_turns": high,
        "initial_rad": last.initial_rad,
    }
    return decode_kernel.Limits(**{name: np.float32(n) for name, n in numbers.items()}, absolute=absolute)


def _chi_square_limit(dof: int) -> float:
    """Return what six sigma are for a sum of `dof` squares (Wilson and Hilferty's approximation)."""
    return float(dof * (1 - 2 / (9 * dof) + 6 * np.sqrt(2 / (9 * dof))) ** 3)


def _range(groups: Sequence[Group], size_px: int, edge_px: float) -> tuple[float, float, float, float, float]:
    """Return where phases are cut, the circle's length, and the turns that are on the projector."""
    coarse, fine = groups[0].period_px, groups[-1].period_px
    if size_px > coarse * (1 + 1e-6):
        raise ValueError(
            f"the coarsest fringes have {size_px / coarse:.4g} periods across the projector's {size_px} px; "
            "an absolute phase needs at most one: add a frequency of 1 period, or unwrap spatially"
        )
    counts = [size_px / group.period_px for group in groups]
    circular = counts[0] > 1 - 1e-6 and all(abs(n - round(n)) < 1e-4 for n in counts)
    first_cut = -0.5 / coarse - (1 - counts[0]) / 2
    wrap = float(round(counts[-1])) if circular else 0.0
    return -0.5 / fine, first_cut, wrap, (edge_px - 0.5) / fine, (size_px - 0.5 - edge_px) / fine
