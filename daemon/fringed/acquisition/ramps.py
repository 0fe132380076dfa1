"""What betrays a uniform picture, such as one step of a grey ramp: more grey is more light.

Owns two tests. The light of each band, as a share of the band's brightest and darkest, has to rise with the grey
level: a frame that holds an earlier one's light is out of line. And red, green and blue alone add up to white, as
each sensor sees it. Arrays in, findings out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fringed.acquisition.sampling import Noise, per_band
from fringed.acquisition.sinusoids import MIN_PIXELS
from fringed.data import Array, CheckFinding, Float32Array, PatternSequence

MIN_LEVELS = 5
MIN_SWING = 8.0 / 255.0  # of full scale
TOLERANCE = 0.02  # of the range: flicker and drift of the lamp
SIGMAS = 6.0
ADDED = 0.08  # of white: a projector's colours add up but for its black level and lamp


def ramp_findings(
    grid: Float32Array, sequence: PatternSequence, before: Sequence[int], light: tuple[Noise, float]
) -> list[CheckFinding]:
    """Return what is wrong with the uniform frames.

    `before` is the frame that came before each, `light` noise and full scale.
    """
    found = []
    for indices in _ramps(sequence):
        levels = np.array([float(sequence.patterns[i].max()) for i in indices])
        if len(np.unique(levels)) >= MIN_LEVELS:
            found += _judged(grid, indices, levels, before, light)
    for indices in _colours(sequence):
        found += _added(grid, indices, light)
    return found


def _colours(sequence: PatternSequence) -> list[tuple[int, ...]]:
    """Return black, red, green, blue and white of one grey level, for each sensor that sees them all."""
    by_sensor: dict[str, dict[tuple[int, ...], int]] = {}
    for index, pattern in enumerate(sequence.patterns):
        if pattern.shape[2] == 3 and not np.ptp(pattern, axis=(0, 1)).any():
            shown = tuple(int(c) for c in pattern[0, 0])
            by_sensor.setdefault(sequence.frames[index].channel, {})[shown] = index
    found = []
    for places in by_sensor.values():
        full = max(max(colour) for colour in places)
        wanted = [(0, 0, 0), (full, 0, 0), (0, full, 0), (0, 0, full), (full, full, full)]
        if full and all(colour in places for colour in wanted):
            found.append(tuple(places[colour] for colour in wanted))
    return found


def _added(grid: Float32Array, indices: tuple[int, ...], light: tuple[Noise, float]) -> list[CheckFinding]:
    black, red, green, blue, white = grid[list(indices)].reshape(5, -1)
    noise, top = light
    rows = grid.shape[1]
    swing: Float32Array = white - black
    valid: Float32Array = ((np.abs(swing) > MIN_SWING * top) & (grid[list(indices)].max(axis=0).ravel() < top)).astype(
        np.float32
    )
    told = per_band(valid, rows) >= MIN_PIXELS
    length = np.maximum(np.abs(per_band(swing * valid, rows)), 1e-9)
    away = np.abs(per_band((red + green + blue - 2 * black - white) * valid, rows)) / length
    allowed = ADDED + SIGMAS * np.sqrt(8 * per_band(noise.variance(white) * valid, rows)) / length
    if not np.any(told & (away > allowed)):
        return []
    text = (
        f"what a sensor sees of red, green and blue (frames {', '.join(map(str, indices[1:4]))}) does not add up to "
        f"white (frame {indices[4]}), by {away[told].max():.0%} of it; one of these frames is late, blended or torn"
    )
    return [CheckFinding("misfit", text, indices)]


def _ramps(sequence: PatternSequence) -> list[tuple[int, ...]]:
    """Return the uniform frames of each light: the projector's colours that are on, and the sensor that sees them."""
    ramps: dict[tuple[object, ...], list[int]] = {}
    dark = []
    for index, pattern in enumerate(sequence.patterns):
        if np.ptp(pattern, axis=(0, 1)).any():
            continue
        colours = pattern[0, 0]
        lit = colours[colours > 0]
        if len(lit) == 0:
            dark.append(index)
        elif np.ptp(lit) == 0:
            on = tuple(bool(c) for c in colours) if len(colours) == 3 else (True,) * 3
            sensor = sequence.frames[index].channel if sequence.frames[index].shot >= 0 else ""
            ramps.setdefault((on, sensor), []).append(index)
    return [tuple(sorted([*indices, *dark])) for indices in ramps.values()]


def _judged(
    grid: Float32Array, indices: tuple[int, ...], levels: Array, before: Sequence[int], light: tuple[Noise, float]
) -> list[CheckFinding]:
    noise, top = light
    frames = grid[list(indices)].reshape(len(indices), -1)
    rows = grid.shape[1]
    low, high = frames.min(axis=0), frames.max(axis=0)
    valid = ((high - low > MIN_SWING * top) & (high < top)).astype(np.float32)
    told = per_band(valid, rows) >= MIN_PIXELS
    if not told.any():
        return []
    sums = per_band(frames * valid, rows)[:, told]
    swing = np.maximum(per_band((high - low) * valid, rows)[told], 1e-9)
    share = (sums - per_band(low * valid, rows)[told]) / swing
    deviation = np.sqrt(per_band(noise.variance(high) * valid, rows)[told]) / swing
    return _out_of_line(indices, levels, share, TOLERANCE + SIGMAS * deviation, before)


def _out_of_line(
    indices: tuple[int, ...], levels: Array, share: Array, allowed: Array, before: Sequence[int]
) -> list[CheckFinding]:
    """Name the frames whose light is not between that of the levels below and above, the worst first, one by one."""
    kept = list(range(len(indices)))
    found = []
    while len({levels[k] for k in kept}) >= MIN_LEVELS:
        suspects = [k for k in kept if np.any(_outside(k, kept, levels, share) > allowed)]
        if not suspects:
            break
        near = sorted({other for k in suspects for other in _neighbours(k, kept, levels)})
        costs = [_cost([other for other in near if other != k], kept, k, (levels, share, allowed)) for k in near]
        worst = near[int(np.argmin(costs))]
        index = indices[worst]
        away = np.abs(_outside(worst, kept, levels, share))
        part = "" if np.all(away > allowed) else f" in {np.mean(away > allowed):.0%} of its bands"
        text = (
            f"frame {index} of grey level {levels[worst]:.0f} is {away.max():.1%} of the range off what its neighbours "
            f"of the ramp say{part}; it holds some of frame {before[index]}, or the lamp is not steady: raise "
            "acquisition.latency_s or settle_s"
        )
        found.append(CheckFinding("torn" if part else "blended", text, (index,)))
        kept.remove(worst)
    return found


def _outside(k: int, kept: list[int], levels: Array, share: Array) -> Array:
    """Return, by band, how far a frame's light is outside what the nearest levels below and above allow."""
    others = [other for other in kept if other != k]
    same = [other for other in others if levels[other] == levels[k]]
    if same:
        distance: Array = np.abs(share[k] - np.median(share[same], axis=0))
        return distance
    below = [other for other in others if levels[other] < levels[k]]
    above = [other for other in others if levels[other] > levels[k]]
    low = share[[o for o in below if levels[o] == max(levels[below])]].max(axis=0) if below else -np.inf
    high = share[[o for o in above if levels[o] == min(levels[above])]].min(axis=0) if above else np.inf
    outside: Array = np.maximum(np.maximum(low - share[k], share[k] - high), 0.0)
    return outside


def _neighbours(k: int, kept: list[int], levels: Array) -> list[int]:
    """Return a frame, and those of the same level and of the nearest ones below and above."""
    below = [levels[other] for other in kept if levels[other] < levels[k]]
    above = [levels[other] for other in kept if levels[other] > levels[k]]
    near = {levels[k], max(below, default=levels[k]), min(above, default=levels[k])}
    return [other for other in kept if levels[other] in near]


def _cost(judged: list[int], kept: list[int], without: int, about: tuple[Array, Array, Array]) -> float:
    """Return how much of the frames `judged` is out of line without one of them: least without the wrong one."""
    levels, share, allowed = about
    rest = [k for k in kept if k != without]
    return float(sum(np.maximum(_outside(k, rest, levels, share) - allowed, 0.0).max() for k in judged))
