"""Name the frame and the fault behind a group that fits no sinusoid.

Owns the hypotheses: a frame holds, wholly or in part, in all bands or in some, what the frame before it
showed. Runs only once something was found wrong; arrays in, findings out.
"""

from __future__ import annotations

import numpy as np

from fringed.acquisition.sampling import per_band
from fringed.acquisition.sinusoids import MIN_PIXELS, NOISE_MARGIN, GroupFit, misfit_of
from fringed.data import Array, CheckFinding, Float32Array

EXPLAINED = 0.6  # the share of the misfit that a hypothesis must explain
WHOLE = 0.75  # the share of the earlier frame from which it counts as that frame
TRACE = 0.15
CERTAIN = 6.0  # standard deviations
NOTABLE = 0.01  # of the modulation: smaller errors are nobody's fault


def blame_group(grid: Float32Array, fit: GroupFit, relative: Array, limit: float) -> CheckFinding:
    """Return the most likely fault of a group whose misfit `relative` (n, bands) exceeds `limit`."""
    worst = float(relative.max())
    best = max(((*_held(grid, fit, k), k) for k in range(len(fit.indices))), key=lambda item: item[0])
    explained, shares, told, position = best
    frame = fit.indices[position]
    bands = int((relative.max(axis=0) > limit).sum())
    measured = f"misfit {worst:.3f} of the modulation, allowed {limit:.3f}, in {bands} of {relative.shape[1]} bands"
    if explained < EXPLAINED:
        text = f"frames {_range(fit.indices)} fit no sinusoid ({measured}); did the object move, or the light change?"
        return CheckFinding("misfit", text, fit.indices)
    earlier = fit.before[position]
    before = f"frame {earlier}" if earlier >= 0 else "what was shown before the sequence"
    seen = shares[told]
    middle = float(np.median(seen))
    if np.all(seen >= WHOLE):
        return CheckFinding("late", f"frame {frame} shows {before} ({measured}); raise acquisition.latency_s", (frame,))
    if np.any(seen >= 0.5) and np.mean((seen > TRACE) & (seen < WHOLE)) <= 0.25:
        edge = int(np.argmax(np.abs(np.diff(seen)))) + 1 if len(seen) > 1 else 0
        text = f"frame {frame} shows {before} in part of its rows, torn near band {edge} of {len(seen)} ({measured})"
        return CheckFinding("torn", text, (frame,))
    text = f"frame {frame} holds {middle:.0%} of {before} ({measured}); raise acquisition.latency_s or settle_s"
    return CheckFinding("blended", text, (frame,))


def _held(grid: Float32Array, fit: GroupFit, position: int) -> tuple[float, Array, Array]:
    """Return how much of frame `position`'s misfit its predecessor explains, its share by band, the bands told."""
    index, rows, valid = fit.indices[position], fit.rows, fit.valid
    error = fit.deleted(position)
    predicted = grid[index].ravel() - error
    towards = _before(grid, fit, position) - predicted
    cross = per_band(error * towards * valid, rows)
    length = np.maximum(per_band(towards * towards * valid, rows), 1e-9)
    energy = per_band(error * error * valid, rows)
    told = per_band(valid, rows) >= MIN_PIXELS
    shares = np.where(told, np.maximum(cross, 0.0) / length, 0.0)
    explained = float((shares[told] * cross[told]).sum() / max(float(energy[told].sum()), 1e-9))
    return explained, shares, told


def blame_held(
    grid: Float32Array, fit: GroupFit, positions: tuple[int, ...], error: Float32Array, inflation: float
) -> CheckFinding | None:
    """Return the finding when one of the frames at `positions` holds some of the picture before it.

    That fault has a shape of its own, so it is seen where the misfit is below any limit: in a first pattern
    that is dark where the object is, or in a group of three. `error` (p,) is that frame minus what it
    should be, its variance the pixel's times `inflation`.
    """
    best, found = 0.0, None
    for position in positions:
        index = fit.indices[position]
        share, weight = _share_held(grid, fit, position, error, inflation)
        if weight <= best:
            continue
        best = weight
        earlier = fit.before[position]
        before = f"frame {earlier}" if earlier >= 0 else "the black picture shown before it"
        text = f"frame {index} holds {min(share, 1.0):.0%} of {before}; raise acquisition.latency_s or settle_s"
        found = CheckFinding("late" if share >= WHOLE else "blended", text, (index,))
    return found


def _share_held(
    grid: Float32Array, fit: GroupFit, position: int, error: Float32Array, inflation: float
) -> tuple[float, float]:
    """Return how much of the picture before it a frame holds, and what that explains; zeros unless it is certain.

    Looked for in the whole picture and, since a frame may be torn, in all rows from or up to any band.
    What a fit predicts is independent of what it leaves over; a comparison with siblings is not, so its
    noise has to be taken out.
    """
    index, rows, valid = fit.indices[position], fit.rows, fit.valid
    freedom = 1.0 if fit.fits_always else float(fit.freedom[position])
    fitted = grid[index].ravel() - np.float32(freedom) * error
    towards = (_before(grid, fit, position) - fitted) * valid
    noise = NOISE_MARGIN * inflation * per_band(fit.variance * valid, rows) if fit.fits_always else 0.0
    cross = _parts(per_band(towards * error, rows) - noise)
    length = np.maximum(_parts(per_band(towards * towards, rows)), 1e-9)
    variance = inflation * fit.variance
    if fit.loose or not fit.clean:  # more than noise is left over: take all of it for noise
        variance = np.maximum(variance, np.float32((error * error * valid).sum() / max(float(valid.sum()), 1.0)))
    deviation = np.sqrt(_parts(per_band(towards * towards * variance, rows))) / length
    signal = np.maximum(_parts(per_band(fit.power * valid, rows)), 1e-9)
    share = cross / length
    certain = (share > CERTAIN * deviation) & (share * np.sqrt(length / signal) > NOTABLE)
    share = share / np.maximum(1.0 + (1.0 - freedom) * share, 1e-3)  # the fit itself went some of the way
    weight = np.where(certain & (share > TRACE + fit.tone + fit.shape), share * share * length, 0.0)
    best = int(np.argmax(weight))
    return (float(share[best]), float(weight[best])) if weight[best] > 0 else (0.0, 0.0)


def _parts(by_band: Array) -> Array:
    """Return the sums over all bands, over those up to each, and over those from each."""
    return np.concatenate([[by_band.sum()], np.cumsum(by_band)[:-1], np.cumsum(by_band[::-1])[:-1]])


def _before(grid: Float32Array, fit: GroupFit, position: int) -> Float32Array:
    """Return what was shown before the frame at `position`: before the first, the idle picture, which is black."""
    earlier = fit.before[position]
    return grid[earlier].ravel() if earlier >= 0 else np.maximum(fit.mean - np.sqrt(fit.power), np.float32(0))


def all_late(fits: list[GroupFit], shifted: list[GroupFit], limit: float) -> CheckFinding | None:
    """Return the finding when every frame shows the pattern before its own.

    `fits` are the groups as ordered, `shifted` the same groups made of the frames one later.
    """
    own = [float(misfit_of(fit).relative.max()) for fit in fits if not (fit.fits_always or fit.loose)]
    later = [float(misfit_of(fit).relative.max()) for fit in shifted if not (fit.fits_always or fit.loose)]
    if not own or not later or min(own) <= limit or max(later) > limit:
        return None
    return CheckFinding(
        "late",
        f"every frame shows the pattern before its own (misfit {max(own):.3f}, allowed {limit:.3f}); the delay from "
        "flip to light is longer than assumed: measure it (the latency request), or raise acquisition.latency_s",
        (0,),
    )


def _range(indices: tuple[int, ...]) -> str:
    return f"{indices[0]} to {indices[-1]}"
