"""What fringes of each style leave beside a sinusoid, so that no honest pattern is blamed for its shape.

Owns which harmonics a style has, and how a group with them is fitted. Three ways, in this order: the harmonics are
free in every pixel, where the steps leave something to judge then; they have one amplitude in the whole picture, as
a tone curve's have; or nothing can be said of the fit (dots), and only what looks like an earlier picture counts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fringed.acquisition.sampling import Noise
from fringed.acquisition.sinusoids import GroupFit, fit_group, phasor_powers
from fringed.data import Array, Float32Array, PatternFrame, PatternSequence

ODD = frozenset({"triangular", "trapezoidal", "binary", "binary-pulse-width"})
EVERY = frozenset({"sawtooth"})
DOTS = frozenset({"binary-dithered"})  # of a pixel each, another pattern in every frame
HIGHEST = 15  # beyond it a harmonic is under 7 % of the fundamental, and blurred
SHARED_HIGHEST = {"sawtooth": 7}  # where every order counts, those above it hardly do
FEW = 7  # every so many pixels tell the amplitudes
CLEAN = 0.02  # of the modulation in the mean of all steps: less than the checks allow


def is_fringes(frame: PatternFrame) -> bool:
    """Return whether a frame has fringes that differ by their shift."""
    return frame.period_px > 0 and frame.style != "gray"


def judged_groups(sequence: PatternSequence) -> list[tuple[int, ...]]:
    """Return the frames of each group that fits one sinusoid and its harmonics: three or more shifts, one channel."""
    found = []
    for indices in sequence.groups().values():
        frames = [sequence.frames[i] for i in indices]
        shifts = {round(float(np.mod(frame.shift_rad, 2 * np.pi)), 6) for frame in frames}
        one_channel = len({frame.channel for frame in frames}) == 1
        if len(shifts) >= 3 and one_channel and all(map(is_fringes, frames)):
            found.append(indices)
    return found


def orders_of(style: str) -> tuple[int, ...]:
    """Return the harmonics above the first that a style has."""
    if style in ODD:
        return tuple(range(3, HIGHEST + 1, 2))
    return tuple(range(2, HIGHEST + 1)) if style in EVERY else ()


def fit_style(
    grid: Float32Array, indices: tuple[int, ...], frames: list[PatternFrame], noise: Noise, top: float
) -> GroupFit:
    """Fit one group of any style; see the module's text. `indices` say where the frames are on the grid."""
    shifts = np.array([frame.shift_rad for frame in frames])
    style = frames[0].style
    orders = orders_of(style)
    free = fit_group(grid, indices, (shifts, orders), noise, top)
    clean = style not in DOTS and all(abs(np.exp(1j * order * shifts).mean()) * 2 / order < CLEAN for order in orders)
    if len(free.null) or not orders:
        return replace(free, loose=style in DOTS, clean=clean)
    plain = fit_group(grid, indices, (shifts, ()), noise, top)
    if not len(plain.null) or style == "binary-pulse-width":  # its harmonics are high, and blurred unevenly
        return replace(plain, clean=clean, loose=len(plain.null) > 0)
    highest = SHARED_HIGHEST.get(style, HIGHEST)
    return replace(_without_shape(plain, tuple(order for order in orders if order <= highest)), clean=clean)


def _without_shape(fit: GroupFit, orders: tuple[int, ...]) -> GroupFit:
    """Return the fit without harmonics of one amplitude in the whole picture, and how large these are."""
    powers = phasor_powers(fit, max(orders))
    seen = [(fit.null @ np.exp(1j * order * fit.shifts_rad)).astype(np.complex64) for order in orders]
    waves = []
    for order, response in zip(orders, seen, strict=True):
        wave = np.outer(response, powers[order]) * fit.valid
        waves += [wave.real.ravel(), -wave.imag.ravel()]
    design = np.array(waves, np.float32)
    some = np.ascontiguousarray(design[:, ::FEW])
    wanted = some @ (fit.residual * fit.valid).ravel()[::FEW]
    amplitudes = np.linalg.lstsq((some @ some.T).astype(np.float64), wanted, rcond=1e-6)[0]
    removed = (amplitudes.astype(np.float32) @ design).reshape(fit.residual.shape)
    return replace(fit, residual=fit.residual - removed, shape=_size(fit, seen, amplitudes))


def _size(fit: GroupFit, seen: list[Array], amplitudes: Array) -> float:
    """Return the largest deleted residual, over the modulation, of the harmonics that were removed."""
    pairs = amplitudes.reshape(-1, 2)
    parts = [np.abs(fit.null.T @ response) * np.hypot(*pair) for response, pair in zip(seen, pairs, strict=True)]
    return float((np.sqrt(np.sum(np.square(parts), axis=0)) / fit.freedom).max() / 2**0.5)
