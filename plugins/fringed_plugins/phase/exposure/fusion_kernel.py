"""The loops over pixels that make one phase of several.

Owns the arithmetic of one row; `fusion` says what goes in and what the numbers mean. Each row is worked on map by
map, without branches, so that the inner loops vectorise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_TWO_PI = np.float32(2 * np.pi)
_INVERSE_TWO_PI = np.float32(1 / (2 * np.pi))
_PI = np.float32(np.pi)
_ZERO, _ONE, _TINY, _HUGE = np.float32(0), np.float32(1), np.float32(1e-12), np.float32(1e30)
_KEPT, _SATURATED, _FRINGE_ORDER, _RESIDUAL = np.uint16(0), np.uint16(1), np.uint16(4), np.uint16(8)
_SUMS = 5  # weights, phase, modulation, background, confidence


@njit(cache=True, nogil=True, error_model="numpy")
def _choose(phase: Any, sigma: Any, rejected: Any, variance: Any, best: Any) -> None:
    """Note a map's variance, huge where it drops the pixel, and its phase where it is the best so far.

    `best` (2, width): least variance and the phase that has it.
    """
    for i in range(phase.shape[0]):
        own = sigma[i] * sigma[i]
        own = own if (rejected[i] == _KEPT) & (own < _HUGE) & (phase[i] == phase[i]) else _HUGE
        own = max(own, _TINY)
        variance[i] = own
        better = own < best[0, i]
        best[1, i] = phase[i] if better else best[1, i]
        best[0, i] = own if better else best[0, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _add(arrays: Any, variance: Any, best: Any, numbers: Any, sums: Any, wrong: Any) -> None:
    """Add a map to the sums `(5, width)` of one row, and note in `wrong` where it contradicts the best one."""
    phase, modulation, background, confidence, _ = arrays
    sigmas2, systematic, ignored2, wrapped, gain, offset = numbers
    for i in range(phase.shape[0]):
        own, least = variance[i], best[0, i]
        counts = (own <= ignored2 * least) & (own < _HUGE)
        away = phase[i] - best[1, i]
        away -= wrapped * _TWO_PI * np.rint(away * _INVERSE_TWO_PI)
        size = abs(away)
        clash = counts & (size > np.sqrt(sigmas2 * (own + least)) + systematic)
        kind = _FRINGE_ORDER if size > _PI else _RESIDUAL
        wrong[i] |= kind if clash else _KEPT
        weight = _ONE / own if counts else _ZERO
        sums[0, i] += weight
        sums[1, i] += weight * away if counts else _ZERO
        sums[2, i] += weight * modulation[i] * gain if counts else _ZERO
        sums[3, i] += weight * (background[i] * gain + offset) if counts else _ZERO
        sums[4, i] = max(sums[4, i], confidence[i]) if counts else sums[4, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _finish(best: Any, sums: Any, wrong: Any, wrapped: Any, out: Any) -> None:
    """Write one row of `out`: phase, sigma, modulation, background, rejected; NaN where nothing or a clash is."""
    phase, sigma, modulation, background, rejected = out
    nothing = np.float32(np.nan)
    for i in range(phase.shape[0]):
        share = _ONE / sums[0, i]  # infinite where no map has the pixel
        mean = best[1, i] + sums[1, i] * share
        mean -= wrapped * _TWO_PI * np.rint(mean * _INVERSE_TWO_PI)
        good = (wrong[i] == _KEPT) & (sums[0, i] > _ZERO)
        phase[i] = mean if good else nothing
        sigma[i] = np.sqrt(share) if good else nothing
        modulation[i] = sums[2, i] * share
        background[i] = sums[3, i] * share
        rejected[i] = wrong[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _speak(arrays: Any, numbers: Any, first: bool, told: Any, reasons: Any) -> None:
    """Let a map say what is known of pixels that every map drops; `told` is modulation, background, confidence.

    The brightest map that is not saturated has the last word, else the darkest; maps come from dark to bright.
    """
    _, modulation, background, confidence, flags = arrays
    _, _, _, _, gain, offset = numbers
    for i in range(flags.shape[0]):
        speaks = first | ((flags[i] & _SATURATED) == _KEPT)
        told[0, i] = modulation[i] * gain if speaks else told[0, i]
        told[1, i] = background[i] * gain + offset if speaks else told[1, i]
        told[2, i] = confidence[i] if speaks else told[2, i]
        reasons[i] = flags[i] if speaks else reasons[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _explain(sums: Any, told: Any, reasons: Any, out: Any) -> None:
    """Write what is known of the pixels of one row that every map drops."""
    modulation, background, rejected = out
    for i in range(rejected.shape[0]):
        lost = sums[0, i] == _ZERO
        modulation[i] = told[0, i] if lost else modulation[i]
        background[i] = told[1, i] if lost else background[i]
        sums[4, i] = told[2, i] if lost else sums[4, i]
        why = reasons[i] if reasons[i] != _KEPT else _RESIDUAL  # a phase or a deviation of NaN
        rejected[i] = why if lost else rejected[i]


@njit(cache=True, nogil=True, error_model="numpy")
def fuse_rows(start: int, stop: int, maps: Any, light: Any, numbers: Any, out: Any) -> None:
    """Write rows `start` to `stop`.

    `maps`: for each kind of array (phase, sigma, modulation, background, confidence, rejected) those of every map,
    dark to bright. `light`: their gains and offsets. `numbers`: squared sigmas, systematic difference, squared ratio
    of deviations that is ignored, and 1 where the phase is wrapped.
    """
    phases, sigmas, modulations, backgrounds, confidences, flags = maps
    width = out[0].shape[1]
    variance = np.empty((len(phases), width), np.float32)
    best, sums = np.empty((2, width), np.float32), np.empty((_SUMS, width), np.float32)
    told, unsure = np.empty((3, width), np.float32), np.zeros(width, np.float32)
    wrong, reasons = np.empty(width, np.uint16), np.empty(width, np.uint16)
    for row in range(start, stop):
        best[0], best[1], sums[:], wrong[:] = _HUGE, _ZERO, _ZERO, _KEPT
        for k in range(len(phases)):
            _choose(phases[k][row], sigmas[k][row], flags[k][row], variance[k], best)
        for k in range(len(phases)):
            sure = confidences[k][row] if confidences[k].size else unsure
            arrays = (phases[k][row], modulations[k][row], backgrounds[k][row], sure, flags[k][row])
            own = (numbers[0], numbers[1], numbers[2], numbers[3], light[0][k], light[1][k])
            _add(arrays, variance[k], best, own, sums, wrong)
            _speak(arrays, own, k == 0, told, reasons)
        _finish(best, sums, wrong, numbers[3], (out[0][row], out[1][row], out[2][row], out[3][row], out[5][row]))
        _explain(sums, told, reasons, (out[2][row], out[3][row], out[5][row]))
        if out[4].size:
            out[4][row] = sums[4]
