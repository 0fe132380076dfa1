"""Several phase maps of the same fringes, taken with different amounts of light, made one.

Owns the weights, what contradicts what, and the common scale of light; the loop over pixels is in
`fusion_kernel`. Knows nothing of cameras: which light a map had is measured from the pixels it shares.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows

Float32Array = npt.NDArray[np.float32]
SHARED_MIN = 200  # pixels of a sample that two maps have to share for their light to be compared
SAMPLE = 200_000
SATURATED = np.uint16(1)
CONTRAST = 8.0  # how far dark and bright backgrounds are apart, over their spread, for their ratio to tell


class ExposedMap(NamedTuple):
    """One map: arrays (height, width), float32, and the uint16 mask; `confidence` may be (0, 0)."""

    phase_rad: Float32Array
    sigma_rad: Float32Array
    modulation: Float32Array
    background: Float32Array
    confidence: Float32Array
    rejected: npt.NDArray[np.uint16]


class FusionLimits(NamedTuple):
    """When two maps contradict each other, and when one of them has no say.

    They may differ by `sigmas` standard deviations and `systematic_rad` besides, for what noise does not explain (tone
    curve, lamp). A map whose standard deviation is over `ignored` times the best one's is left out: it could change
    the mean by less than `1 / ignored^2` of its own difference.
    """

    sigmas: float = 6.0
    systematic_rad: float = 0.05
    ignored: float = 4.0


class Light(NamedTuple):
    """`gain * x + offset` takes a map's grey levels to those of the darkest map; guessed unless `measured`."""

    gain: float
    offset: float
    measured: bool = True


def fuse(
    maps: Sequence[ExposedMap],
    wrapped: bool,
    light: Sequence[Light] | None = None,
    limits: FusionLimits | None = None,
    threads: int = 0,
) -> ExposedMap:
    """Return one map, each pixel the mean of those that have it, weighted by 1 / sigma^2.

    A pixel is dropped where every map drops it, with the reasons of the brightest map that is not saturated, else of
    the darkest; and where maps contradict each other: FRINGE_ORDER (4) beyond half a period, RESIDUAL (8) below.
    A wrapped phase is averaged on the circle. Modulation and background are on the darkest map's scale.

    Parameters
    ----------
    maps
        two or more, of one shape. Pixels with a flag in `rejected` are not read.
    wrapped
        whether phases are known up to 2 pi.
    light
        each map's light; measured by `relative_light` where it is left out.

    Raises
    ------
    ValueError
        fewer than two maps, shapes that differ, or light that cannot be compared.

    References
    ----------
    Inverse-variance weighting is the maximum-likelihood mean of independent normal estimates. Several exposures of
    fringes: Zhang & Yau, Opt. Eng. 48 (2009) 033604, who keep the brightest unsaturated one instead.

    Examples
    --------
    >>> one = ExposedMap(*(np.full((1, 2), x, np.float32) for x in (1.0, 0.3, 10, 20)),
    ...                  np.zeros((0, 0), np.float32), np.array([[0, 2]], np.uint16))
    >>> two = ExposedMap(*(np.full((1, 2), x, np.float32) for x in (1.3, 0.6, 5, 10)),
    ...                  np.zeros((0, 0), np.float32), np.array([[0, 0]], np.uint16))
    >>> fused = fuse([one, two], False, [Light(0.5, 0.0), Light(1.0, 0.0)])
    >>> fused.phase_rad.round(2), fused.sigma_rad.round(3)
    (array([[1.06, 1.3 ]], dtype=float32), array([[0.268, 0.6  ]], dtype=float32))
    """
    from fringed_plugins.phase.exposure import fusion_kernel

    limits = limits or FusionLimits()
    _check(maps)
    light = relative_light(maps) if light is None else light
    order = np.argsort([-one.gain for one in light])  # dark first: the darkest map needs the largest gain
    given = [_readable(maps[i]) for i in order]
    gains = np.array([light[i].gain for i in order], np.float32)
    offsets = np.array([light[i].offset for i in order], np.float32)
    shape = maps[0].phase_rad.shape
    confident = all(one.confidence.size for one in maps)
    sure = np.empty(shape if confident else (0, 0), np.float32)
    phase, sigma, modulation, background = (np.empty(shape, np.float32) for _ in range(4))
    out = ExposedMap(phase, sigma, modulation, background, sure, np.empty(shape, np.uint16))
    numbers = np.array([limits.sigmas**2, limits.systematic_rad, limits.ignored**2, float(wrapped)], np.float32)
    columns = tuple(tuple(getattr(one, name) for one in given) for name in ExposedMap._fields)
    run_rows(fusion_kernel.fuse_rows, shape[0], columns, (gains, offsets), numbers, tuple(out), threads=threads)
    return out


def relative_light(maps: Sequence[ExposedMap]) -> list[Light]:
    """Return how each map's grey levels go over to the darkest one's, from the pixels that maps share.

    The modulation knows no black level, so its ratio is that of the light; the background then gives the offset.
    Where too few pixels are valid in both, the backgrounds of those that neither saturates give both. Maps are
    compared in pairs, those first that share most pixels. A map that cannot be compared with any other is given the
    light of the one that is saturated as often, and is not `measured`: only its grey levels are wrong then.

    Raises
    ------
    ValueError
        fewer than two maps, or shapes that differ.
    """
    _check(maps)
    samples = _samples(maps)
    found = _linked(samples)
    for index in range(len(maps)):
        if index not in found:
            kin = min(found, key=lambda i: abs(samples[i].saturated - samples[index].saturated))
            found[index] = Light(found[kin].gain, found[kin].offset, measured=False)
    darkest = max(found.values(), key=lambda one: one.gain)
    return [
        Light(one.gain / darkest.gain, (one.offset - darkest.offset) / darkest.gain, one.measured)
        for one in (found[i] for i in range(len(maps)))
    ]


def _linked(samples: Sequence[_Sample]) -> dict[int, Light]:
    """Return the light, on the scale of one of them, of all maps that pixels link to it."""
    pairs = sorted(
        ((_compared(samples[i], samples[j]), i, j) for i, j in combinations(range(len(samples)), 2)),
        key=lambda pair: -pair[0][1],
    )
    found = {pairs[0][1]: Light(1.0, 0.0)}
    while True:
        link = next(((one, i, j) for (one, _), i, j in pairs if one is not None and (i in found) != (j in found)), None)
        if link is None:
            return found
        one, i, j = link  # takes the grey levels of j to those of i
        if i in found:
            found[j] = _after(found[i], one)
        else:
            found[i] = _after(found[j], Light(1 / one.gain, -one.offset / one.gain))


class _Sample(NamedTuple):
    """Some pixels of a map, and the share of them that is saturated."""

    modulation: npt.NDArray[Any]
    background: npt.NDArray[Any]
    rejected: npt.NDArray[Any]
    saturated: float


def _samples(maps: Sequence[ExposedMap]) -> list[_Sample]:
    step = max(1, maps[0].phase_rad.size // SAMPLE)
    return [
        _Sample(
            one.modulation.reshape(-1)[::step],
            one.background.reshape(-1)[::step],
            one.rejected.reshape(-1)[::step],
            float(np.mean(one.rejected.reshape(-1)[::step] & SATURATED > 0)),
        )
        for one in maps
    ]


def _compared(one: _Sample, other: _Sample) -> tuple[Light | None, int]:
    """Return what takes the grey levels of `other` to those of `one`, None where nothing tells, and by how much."""
    least = max(1, min(SHARED_MIN, one.rejected.size // 100))
    valid = (one.rejected == 0) & (other.rejected == 0) & (one.modulation > 0) & (other.modulation > 0)
    count = int(valid.sum())
    if count >= least:
        gain = float(np.median(one.modulation[valid] / other.modulation[valid]))
        return Light(gain, float(np.median(one.background[valid] - np.float32(gain) * other.background[valid]))), count
    free = ((one.rejected | other.rejected) & SATURATED) == 0
    free &= np.isfinite(one.background) & np.isfinite(other.background)
    return (_line(one.background[free], other.background[free]) if free.sum() >= least else None), 0


def _line(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> Light | None:
    """Return the line through backgrounds, by the medians of their darkest and brightest fifth; None if they agree."""
    order = np.argsort(one + other)
    ends = order[: len(order) // 5 + 1], order[-(len(order) // 5) - 1 :]
    (low, high), (dark, bright) = ([float(np.median(values[end])) for end in ends] for values in (one, other))
    spread = max(float(np.median(np.abs(one[ends[0]] - low))), float(np.median(np.abs(other[ends[0]] - dark))), 0.05)
    if high - low < CONTRAST * spread or bright - dark < CONTRAST * spread:
        return None
    gain = (high - low) / (bright - dark)
    return Light(gain, low - gain * dark)


def _after(outer: Light, inner: Light) -> Light:
    return Light(outer.gain * inner.gain, outer.gain * inner.offset + outer.offset)


def _check(maps: Sequence[ExposedMap]) -> None:
    if len(maps) < 2:
        raise ValueError(f"{len(maps)} phase maps; at least two are fused")
    shapes = sorted({one.phase_rad.shape for one in maps})
    if len(shapes) > 1:
        raise ValueError(f"the phase maps have shapes {shapes}; they have to be of one camera and one region")


def _readable(one: ExposedMap) -> ExposedMap:
    """Return it with arrays that the kernel takes: C order and read-only, whatever they are now."""
    floats = (one.phase_rad, one.sigma_rad, one.modulation, one.background, one.confidence)
    phase, sigma, modulation, background, sure = (_fixed(array, np.float32) for array in floats)
    return ExposedMap(phase, sigma, modulation, background, sure, _fixed(one.rejected, np.uint16))


def _fixed(array: npt.NDArray[Any], dtype: type[np.generic]) -> npt.NDArray[Any]:
    view = np.ascontiguousarray(array, dtype).view()
    view.flags.writeable = False
    return view
