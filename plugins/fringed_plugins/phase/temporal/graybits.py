"""Gray code frames to positions: bits with their margins, and the cell or the edge that they mean.

Owns the decision of the bits; `gray` makes fringe orders of the positions. The layout is that of
`phase.projection.graycode`.

A bit is compared with its complement, else with the mean of a white and a black frame, else with the mean light of the
fringes; its margin is the difference over that difference's noise. Near the edge of a stripe a bit is weak, and its
two readings are neighbours in the code: the pixel then is at that edge, which is known better than the
middle of a cell (the boundary problem, turned round).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.projection.graycode import MAX_BITS, Code

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]

NEAR_EDGE = 0.4  # a bit below this share of the others' mean is at the edge of its stripe
_ZERO = np.float32(0)
_HALF = np.float32(0.5)
_TINY = np.float32(1e-12)
_FAR = np.float32(1e9)
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


@dataclass(frozen=True)
class BitFrames:
    """Where a code's frames are in the stack: `bits` coarse to fine, their complements, white and black; -1: none."""

    code: Code
    bits: tuple[int, ...]
    inverses: tuple[int, ...]
    white: int = -1
    black: int = -1

    @property
    def compared(self) -> bool:
        """Whether the code's own frames tell what a bit is compared with."""
        return all(index >= 0 for index in self.inverses) or (self.white >= 0 and self.black >= 0)


class Layout(NamedTuple):
    """The same for the kernel, with the noise."""

    bits: npt.NDArray[np.int64]
    inverses: npt.NDArray[np.int64]
    white: int
    black: int
    noise_constant: np.float32
    noise_slope: np.float32
    threshold_part: np.float32  # variance of what bits are compared with, over one frame's, where that is fringes' mean


class Positions(NamedTuple):
    """What the code says, `(height, width)` float32."""

    position: Float32Array  # in cells from the first cell's beginning
    half_width: Float32Array  # how far from it the pixel may be, in cells
    margin: Float32Array  # of the weakest bit that matters, in standard deviations
    expected: Float32Array  # what that margin is for a bit far from any edge
    modulation: Float32Array  # mean difference of the bits from what they are compared with, in grey levels
    background: Float32Array  # mean of what they are compared with
    rejected: npt.NDArray[np.uint16]  # SATURATED


def bit_frames(frames: Sequence[Any], indices: Sequence[int]) -> BitFrames:
    """Return the layout of a Gray group's frame descriptions: `bit`, `inverted`, `period_px`, `initial_phase_rad`.

    Raises
    ------
    ValueError
        bits that are missing or double, or frames of different cells.
    """
    members = [frames[index] for index in indices]
    cells = {(member.period_px, member.initial_phase_rad) for member in members}
    if len(cells) != 1:
        raise ValueError(f"the frames of one Gray code have periods and phases {sorted(cells)}; they must be the same")
    place = {(member.bit, member.inverted): index for member, index in zip(members, indices, strict=True)}
    count = 1 + max(member.bit for member in members)
    missing = [bit for bit in range(count) if (bit, False) not in place]
    if count < 1 or count > MAX_BITS or missing or len(place) != len(members):
        raise ValueError(
            f"a Gray code of {count} bits with bits {missing} missing and {len(members) - len(place)} frames twice; "
            f"expected each bit from 0 (the coarsest) once, {MAX_BITS} at most"
        )
    period_px, initial_rad = next(iter(cells))
    if not period_px > 0:
        raise ValueError(f"a Gray code whose frames have period {period_px}; expected twice the width of a cell, in px")
    return BitFrames(
        Code.of(count, period_px, initial_rad),
        tuple(place[bit, False] for bit in range(count)),
        tuple(place.get((bit, True), -1) for bit in range(count)),
        place.get((-1, False), -1),
        place.get((-1, True), -1),
    )


def layout_of(found: BitFrames, noise: NoiseModel, fringe_frames: int = 0) -> Layout:
    """Return the kernel's layout; `fringe_frames` is how many frames the fringes' mean is of, 0 without fringes."""
    return Layout(
        np.array(found.bits, np.int64),
        np.array(found.inverses, np.int64),
        found.white,
        found.black,
        np.float32(noise.constant_dn2),
        np.float32(noise.slope_dn),
        np.float32(1 / fringe_frames if fringe_frames else 0),
    )


@njit(**_options)
def differences(frames: Any, y: int, mean: Any, layout: Layout, out: Any, level: Any) -> np.float32:
    """Write, for a row, each bit's difference from what it is compared with; return its variance over a frame's."""
    compared = layout.white >= 0 and layout.black >= 0
    width = level.size
    level[:] = _ZERO
    part = np.float32(1) + (_HALF if compared else layout.threshold_part)
    for b in range(layout.bits.size):
        bit, inverse, row = frames[layout.bits[b], y], layout.inverses[b], out[b]
        if inverse >= 0:
            other = frames[inverse, y]
            for x in range(width):
                row[x] = (np.float32(bit[x]) - np.float32(other[x])) * _HALF
                level[x] += (np.float32(bit[x]) + np.float32(other[x])) * _HALF
            part = _HALF
        elif compared:
            white, black = frames[layout.white, y], frames[layout.black, y]
            for x in range(width):
                middle = (np.float32(white[x]) + np.float32(black[x])) * _HALF
                row[x] = np.float32(bit[x]) - middle
                level[x] += middle
        else:
            for x in range(width):
                row[x] = np.float32(bit[x]) - mean[x]
                level[x] += mean[x]
    scale = np.float32(1) / np.float32(layout.bits.size)
    for x in range(width):
        level[x] *= scale
    return part


@njit(**_options)
def _read(row: Any, x: int) -> Any:
    """Return code, mean difference, and index and size of the weakest and of the next bit."""
    value, code, total = 0, 0, _ZERO
    weakest, weak, next_weak = 0, _FAR, _FAR
    for b in range(row.shape[0]):
        d = row[b, x]
        size = abs(d)
        value ^= 1 if d > _ZERO else 0  # bits of the binary number are running parities of Gray's
        code = 2 * code + value
        total += size
        if size < weak:
            weakest, weak, next_weak = b, size, weak
        elif size < next_weak:
            next_weak = size
    return code, total, weakest, weak, next_weak


@njit(**_options)
def _flipped(code: int, bit: int, bits: int) -> int:
    """Return the code with Gray bit `bit` (0 coarsest) read the other way: all binary bits from there on turn."""
    return code ^ ((1 << (bits - bit)) - 1)


@njit(**_options)
def place(row: Any, x: int, sigma: np.float32) -> Any:
    """Return position, half width, margin, expected margin and mean difference of one pixel."""
    bits = row.shape[0]
    code, total, weakest, weak, next_weak = _read(row, x)
    others = (total - weak) / np.float32(max(bits - 1, 1)) if bits > 1 else weak
    other_code = _flipped(code, weakest, bits)
    at_edge = bits > 1 and abs(other_code - code) == 1 and weak < np.float32(NEAR_EDGE) * others
    deciding = next_weak if at_edge else weak
    position = np.float32(max(code, other_code)) if at_edge else np.float32(code) + _HALF
    half_width = np.float32(0.15) if at_edge else _HALF
    return position, half_width, deciding / (sigma + _TINY), others / (sigma + _TINY), others


@njit(**_options)
def _position_rows(start: int, stop: int, frames: Any, mean: Any, layout: Layout, out: Any) -> None:
    width = frames.shape[2]
    row, level = np.empty((layout.bits.size, width), np.float32), np.empty(width, np.float32)
    # Arrays are taken out of their tuples once: each time is counted.
    positions_, halves, margins, expecteds = out.position, out.half_width, out.margin, out.expected
    sizes, lights = out.modulation, out.background
    for y in range(start, stop):
        part = differences(frames, y, mean[y if mean.shape[0] > 1 else 0], layout, row, level)
        for x in range(width):
            light = level[x] if level[x] > _ZERO else _ZERO
            sigma = np.sqrt(part * (layout.noise_constant + layout.noise_slope * light))
            position, half, margin, expected, size = place(row, x, sigma)
            positions_[y, x], halves[y, x] = position, half
            margins[y, x], expecteds[y, x] = margin, expected
            sizes[y, x], lights[y, x] = size, light


def positions(
    frames: Array, layout: Layout, mean: Float32Array | None, saturation_dn: float, threads: int = 0
) -> Positions:
    """Return where the code puts every pixel; `mean` (height, width) is the fringes' mean light, where it is needed.

    References
    ----------
    Sansoni, Carocci & Rodella 1999; Inokuchi, Sato & Matsuda 1984.
    """
    shape = frames.shape[1:]
    # A bright bit at the top of the scale is still bright; both a bit and its complement there are not.
    rejected = np.zeros(shape, np.uint16)
    if np.isfinite(saturation_dn):
        darkest = frames[layout.bits[0]]
        for index in (*layout.bits, *layout.inverses[layout.inverses >= 0]):
            darkest = np.minimum(darkest, frames[index])
        rejected[darkest >= saturation_dn] = 1
    position, half, margin, expected, light, level = (np.empty(shape, np.float32) for _ in range(6))
    out = Positions(position, half, margin, expected, light, level, rejected)
    reference = np.zeros((1, shape[1]), np.float32) if mean is None else mean
    run_rows(_position_rows, shape[0], frames, reference, layout, out, threads=threads)
    return out
