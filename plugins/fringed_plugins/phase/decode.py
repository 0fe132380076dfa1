"""Frames to phase: prepares the fused kernel and runs it over the rows.

Owns the choice of thresholds' units and the range of an absolute phase. Takes plain arrays; what a
frame is comes as `shifts.Group`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.cleaning import clean
from fringed_plugins.phase.closed_forms import Sums
from fringed_plugins.phase.decode_kernel import Job, Part, absolute_blocks, wrapped_blocks
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.level_kernel import BLOCK_PX, Limits, State
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import (
    MISFIT,
    Group,
    Plan,
    degrees_of_freedom,
    phase_variance_factor,
    plan,
    style_residual,
)
from fringed_plugins.phase.temporal.correction import Evidence

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]
_LINE_BYTES = 64
_TOGETHER_BYTES = 32 * 1024 * 1024  # what glibc's malloc maps anew each time, whatever it was told


@dataclass(frozen=True)
class Keep:
    """Which maps to return besides phase, modulation and mask; each takes time to write."""

    sigma: bool = True
    background: bool = True
    wrapped: bool = False
    residual: bool = False
    confidence: bool = False


STANDARD = Keep()
LEAN = Keep(sigma=False, background=False)


def decode(
    frames: Array,
    groups: Sequence[Group],
    noise: NoiseModel,
    thresholds: Thresholds,
    size_px: int | None = None,
    *,
    keep: Keep = STANDARD,
    keep_wrapped: bool = False,
    threads: int = 0,
) -> Decoded:
    """Return phase, noise, modulation, background and mask of `frames` (n, height, width).

    With `size_px`, the projector's width or height, the groups are unwrapped from coarse to fine and
    the phase is absolute: `2 pi u / period_px + initial_rad` of the last group. Where the coarsest
    group has exactly one period the range is a circle, so that noise at the projector's border does
    not throw a point to the opposite one. Without `size_px` there is one group and the phase is
    wrapped. `frames` are uint8, uint16 or float32; anything else is converted to float32 first. A pixel
    whose frames are not finite is dropped.

    Raises
    ------
    ValueError
        no group, several without `size_px`, or a coarsest group of more than one period.

    References
    ----------
    Greivenkamp 1984 (least squares); Zuo et al. 2016, section 3 (hierarchical unwrapping).
    """
    keep = replace(keep, wrapped=keep.wrapped or keep_wrapped)
    stack = readable(frames)
    layout, limits = prepare(tuple(groups), noise, thresholds, size_px)
    out = empty(stack.shape[1:], keep, absolute=size_px is not None)
    if out.rejected.size == 0:
        return out
    part = Part(0, len(groups), finishes=True, kept=False, summed=False)
    run(
        stack,
        layout,
        Job(part, new_state(0, margin=False), no_sums(stack.dtype), limits, out),
        size_px is not None,
        threads,
    )
    cleaned(out, stack, tuple(groups), noise, thresholds, size_px=size_px, threads=threads)
    return out


def cleaned(
    out: Decoded,
    stack: Array | None,
    groups: tuple[Group, ...],
    noise: NoiseModel,
    thresholds: Thresholds,
    *,
    size_px: int | None,
    threads: int,
) -> None:
    """Do, in place, what needs a pixel's neighbours; with `stack`, the set's frames, orders may be settled too."""
    evidence = None
    if size_px is not None and stack is not None:
        evidence = Evidence(stack, groups, noise, size_px, windows=len(groups) > 1)
    clean(out, groups[-1], thresholds, size_px, threads, evidence=evidence)


def run(stack: Array, layout: Plan, job: Job, absolute: bool, threads: int) -> None:
    """Run the kernel over all pixels of `stack` (n, height, width) with the job's maps (height, width)."""
    flat = Job(job.part, job.state, job.sums, job.limits, Decoded(*[plane.reshape(-1) for plane in job.out]))
    pixels = stack.shape[1] * stack.shape[2]
    kernel = absolute_blocks if absolute else wrapped_blocks
    run_rows(kernel, -(-pixels // BLOCK_PX), stack.reshape(len(stack), pixels), layout, flat, threads=threads)


def readable(frames: Array) -> Array:
    """Return frames as the kernel takes them: C-ordered, native, read-only uint8, uint16 or float32."""
    kind = frames.dtype.newbyteorder("=")
    kept = kind if kind in (np.uint8, np.uint16, np.float32) else np.dtype(np.float32)
    stack = np.ascontiguousarray(frames, kept).view()
    stack.flags.writeable = False  # one compiled kernel for read-only and writable frames
    return stack


def empty(shape: tuple[int, ...], keep: Keep, *, absolute: bool) -> Decoded:
    """Return the arrays that the kernel fills, in one piece of memory where that is not too large.

    One piece costs half the time where memory is new: most of it then comes in pages of 2 MB. Planes begin where the
    processor's cache lines do.
    """
    wanted = (True, keep.sigma, True, keep.background, keep.wrapped, keep.residual, keep.confidence and absolute)
    pixels = shape[0] * shape[1]
    room = -(-4 * pixels // _LINE_BYTES) * _LINE_BYTES
    nbytes = room * sum(wanted) + 2 * pixels + _LINE_BYTES
    together = np.empty(nbytes if nbytes < _TOGETHER_BYTES else 0, np.uint8)
    begin = -together.ctypes.data % _LINE_BYTES

    def plane(kind: type[Any], is_wanted: bool = True) -> Array:
        nonlocal begin
        if not is_wanted or not together.size:
            return np.empty(shape if is_wanted else (0, 0), kind)
        piece = together[begin : begin + pixels * np.dtype(kind).itemsize]
        begin += room
        found: Array = piece.view(kind).reshape(shape)
        return found

    phase, sigma, modulation, background, wrapped, residual, confidence = (plane(np.float32, w) for w in wanted)
    rejected = plane(np.uint16)
    return Decoded(phase, sigma, modulation, background, wrapped, rejected, residual, confidence)


def new_state(pixels: int, margin: bool) -> State:
    """Return an empty state of so many pixels."""
    turns, coarsest = (np.empty(pixels, np.float32) for _ in range(2))
    room, inverse = (np.empty(pixels if margin else 0, np.float32) for _ in range(2))
    return State(turns, coarsest, np.empty(pixels, np.uint8), room, inverse)


def no_sums(kind: np.dtype[Any]) -> Sums:
    """Return the sums of no pixels."""
    nothing = np.empty(0, np.float32)
    return Sums(np.empty(0, kind), nothing, nothing, nothing, nothing, nothing, nothing)


@lru_cache(maxsize=32)  # half a millisecond, and a station decodes the same sets all day
def prepare(
    groups: tuple[Group, ...], noise: NoiseModel, thresholds: Thresholds, size_px: int | None
) -> tuple[Plan, Limits]:
    """Return what the kernel needs to know of the groups and of the thresholds.

    Raises
    ------
    ValueError
        as `decode` does.
    """
    if not groups or (size_px is None and len(groups) != 1):
        raise ValueError(f"{len(groups)} groups of frames; a wrapped phase needs exactly one, an absolute one or more")
    last = groups[-1]
    cut, centre, wrap, low, high = _range(groups, size_px, thresholds.edge_px) if size_px else (0.0,) * 5
    numbers = {
        "noise_constant": noise.constant_dn2,
        "noise_slope": noise.slope_dn,
        "phase_factor": phase_variance_factor(last.shifts_rad),
        "saturation": thresholds.saturation_dn,
        "modulation2": thresholds.modulation_dn**2,
        "least_constant": thresholds.modulation_snr**2 * noise.constant_dn2,
        "least_slope": thresholds.modulation_snr**2 * noise.slope_dn,
        "per_residual": 1 / max(degrees_of_freedom([last]), 1),
        "misfit_turns": thresholds.order_turns,
        "drop2": thresholds.modulation_drop**2,
        "wrap_turns": wrap,
        "cut_turns": cut,
        "low_turns": low,
        "high_turns": high,
        "initial_rad": last.initial_rad,
    }
    limits = Limits(**{name: np.float32(n) for name, n in numbers.items()})
    layout = plan(groups, centre, absolute=size_px is not None)
    layout.numbers[:, MISFIT:] = [_largest_misfit(group, noise, thresholds) for group in groups]
    return layout, limits


def _largest_misfit(group: Group, noise: NoiseModel, thresholds: Thresholds) -> tuple[float, float, float]:
    """Return the largest sum of squared residuals: a constant, and parts of background and squared modulation."""
    count = degrees_of_freedom([group])
    if count == 0:
        return np.inf, 0.0, 0.0  # three frames fit anything
    variances = _chi_square_limit(count)
    part = count * thresholds.residual**2 + style_residual(group, thresholds.gamma)
    return variances * noise.constant_dn2, variances * noise.slope_dn, part


def _chi_square_limit(dof: int) -> float:
    """Return what six sigma are for a sum of `dof` squares (Wilson and Hilferty's approximation)."""
    return float(dof * (1 - 2 / (9 * dof) + 6 * np.sqrt(2 / (9 * dof))) ** 3)


def _range(groups: Sequence[Group], size_px: int, edge_px: float) -> tuple[float, float, float, float, float]:
    """Return where phases are cut, the middle of the coarsest, the circle's length, the turns on the projector."""
    coarse, fine = groups[0].period_px, groups[-1].period_px
    if size_px > coarse * (1 + 1e-6):
        raise ValueError(
            f"the coarsest fringes have {size_px / coarse:.4g} periods across the projector's {size_px} px; "
            "an absolute phase needs at most one: add a frequency of 1 period, or unwrap spatially"
        )
    counts = [size_px / group.period_px for group in groups]
    circular = counts[0] > 1 - 1e-6 and all(abs(n - round(n)) < 1e-4 for n in counts)
    centre = (counts[0] / 2) - 0.5 / coarse
    wrap = float(round(counts[-1])) if circular else 0.0
    return -0.5 / fine, centre, wrap, (edge_px - 0.5) / fine, (size_px - 0.5 - edge_px) / fine
