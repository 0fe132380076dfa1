"""What betrays a bit of a Gray code, or its white and black frame: nothing of them fits a sinusoid.

Owns the frames of two levels that are complements of each other: they add up to the same light everywhere, whatever
the object and the blur. Where there are no complements, `stripes` judges the pictures. Arrays in, findings out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fringed.acquisition import stripes
from fringed.acquisition.sampling import Noise, per_band
from fringed.acquisition.sinusoids import MIN_PIXELS, NOISE_MARGIN, SIGMAS
from fringed.acquisition.stripes import Coded
from fringed.data import Array, CheckFinding, Float32Array, PatternSequence

MIN_SWING = 8.0 / 255.0  # of full scale: what a pixel varies by to be judged


def code_findings(
    grid: Float32Array, sequence: PatternSequence, before: Sequence[int], light: tuple[Noise, float], limit: float
) -> list[CheckFinding]:
    """Return what is wrong with the frames of a code, of each orientation.

    `before` is the frame that came before each, `light` noise and full scale.
    """
    findings = []
    for orientation in ("columns", "rows"):
        frames = sequence.frames
        chosen = tuple(
            i for i, f in enumerate(frames) if f.style == "gray" and f.bit >= 0 and f.orientation == orientation
        )
        coded = _coded(grid, sequence, chosen, light) if chosen else None
        if coded is not None:
            findings += _judged(coded, before, light[0], limit)
    return findings


def _coded(
    grid: Float32Array, sequence: PatternSequence, chosen: tuple[int, ...], light: tuple[Noise, float]
) -> Coded | None:
    noise, top = light
    low, high = grid.min(axis=0).ravel(), grid.max(axis=0).ravel()
    valid = (high - low > MIN_SWING * top) & (high - low > SIGMAS * np.sqrt(noise.variance(high))) & (high < top)
    swing = np.maximum(high - low, np.float32(1e-6))
    return Coded(sequence, chosen, grid, low, swing, valid) if valid.sum() >= MIN_PIXELS else None


def _judged(coded: Coded, before: Sequence[int], noise: Noise, limit: float) -> list[CheckFinding]:
    flat = _flat(coded.sequence)
    pairs = [*_complements(coded), *([flat] if flat else [])]
    if len(pairs) > 1:
        findings = _sums(coded, pairs, before, noise, limit)
        paired = {i for pair in pairs for i in pair}
    else:
        findings, paired = stripes.extremes(coded, flat) if flat else [], set()
    wrong = {i for finding in findings for i in finding.frames}
    for index in coded.indices:
        if index not in paired | wrong:
            findings += stripes.picture(coded, index, before[index])
    return findings or stripes.order(coded)


def _complements(coded: Coded) -> list[tuple[int, int]]:
    """Return the pairs of frames whose patterns add up to one grey level."""
    pairs, left, patterns = [], list(coded.indices), coded.sequence.patterns
    while left:
        one = left.pop(0)
        for other in left:
            if patterns[one].shape == patterns[other].shape:
                total = patterns[one].astype(int) + patterns[other]
                if total.min() == total.max():
                    pairs.append((one, other))
                    left.remove(other)
                    break
    return pairs


def _flat(sequence: PatternSequence) -> tuple[int, int] | None:
    """Return the frames that are dark and bright all over, where there are both."""
    level = {float(pattern.max()): i for i, pattern in enumerate(sequence.patterns) if np.ptp(pattern) == 0}
    return (level[min(level)], level[max(level)]) if len(level) > 1 else None


def _sums(
    coded: Coded, pairs: list[tuple[int, int]], before: Sequence[int], noise: Noise, limit: float
) -> list[CheckFinding]:
    """Return the pairs whose light does not add up to what the others' does."""
    grid = coded.grid.reshape(len(coded.grid), -1)
    sums: Float32Array = np.stack([grid[i] + grid[j] for i, j in pairs]).astype(np.float32)
    total: Float32Array = np.median(sums, axis=0).astype(np.float32)
    rows = coded.grid.shape[1]
    valid: Float32Array = coded.valid.astype(np.float32)
    inflation = np.float32(2 * (1 + 1.6 / len(pairs)))  # a median's is 1.6 / n
    variance: Float32Array = (noise.variance(total / np.float32(2)) * inflation * valid).astype(np.float32)
    signal = np.maximum(per_band(np.square(coded.swing / np.float32(2)) * valid, rows), 1e-9)
    told = per_band(valid, rows) >= MIN_PIXELS
    expected, deviation = per_band(variance, rows), np.sqrt(2.0 * per_band(variance * variance, rows))
    findings = []
    for pair, summed in zip(pairs, sums, strict=True):
        energy = per_band(np.square(summed - total) * valid, rows)
        certain = np.where(told, energy - NOISE_MARGIN * expected - SIGMAS * deviation, 0.0) / signal
        if certain.max() > limit**2:
            findings.append(_blamed(grid, pair, (total, valid), before, float(np.sqrt(certain.max()))))
    return findings


def _blamed(
    grid: Float32Array, pair: tuple[int, int], light: tuple[Array, Array], before: Sequence[int], misfit: float
) -> CheckFinding:
    """Return which of two complements holds the picture before it, and how much of it."""
    total, valid = light
    text = (
        f"frames {pair[0]} and {pair[1]} are complements and do not add up to the light of the others (misfit "
        f"{misfit:.3f} of the modulation); did the object move, or the light change?"
    )
    best, told = 0.0, CheckFinding("misfit", text, pair)
    for index, other in (pair, pair[::-1]):
        if before[index] < 0:
            continue
        predicted = total - grid[other]
        error, towards = (grid[index] - predicted) * valid, (grid[before[index]] - predicted) * valid
        length = float(towards @ towards)
        share = float(error @ towards) / max(length, 1e-9)
        explained = share * share * length / max(float(error @ error), 1e-9)
        if share > 0.15 and explained > max(best, 0.3):
            best, fault = explained, "late" if share > 0.75 else "blended"
            held = f"frame {index} holds {min(share, 1.0):.0%} of frame {before[index]}"
            told = CheckFinding(fault, f"{held}; raise acquisition.latency_s or settle_s", (index,))
    return told
