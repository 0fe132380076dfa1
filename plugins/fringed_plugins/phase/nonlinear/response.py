"""The projector's tone curve from uniform grey pictures on any surface.

Owns the model of such a ramp and its fit; the smooth curve through the levels is in `curve`. Blur does not matter
here: a uniform picture stays uniform, so that what is measured is the pure tone, whatever the focus.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.phase.nonlinear.curve import monotone_curve

Float64Array = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]

MIN_LEVELS = 9
MIN_PIXELS = 200
MOST_PIXELS = 60_000  # more make the curve no better: the lamp's flicker limits it, not the camera's noise
_ROUNDS = 3
_OUTLIER_SIGMAS = 4.0
_STRAY = 0.03  # of the range: a level that far off the curve was not shown when its frame was taken


@dataclass(frozen=True)
class Response:
    """What a ramp tells of the projector.

    `curve` (256,) is the relative light of each grey level, 0 to 1, `deviation` (256,) its standard deviation.
    `greys` (k,), `light` (k,) and `scatter` (k,) are the levels measured, the mean over the pixels, and the
    standard deviation of that mean. `rms` is that of the levels about the curve, `drift` how much the lamp changed from
    first to last frame and `flicker` its standard deviation from frame to frame, all relative to the range.
    """

    greys: Float64Array
    light: Float64Array
    scatter: Float64Array
    curve: Float64Array
    deviation: Float64Array
    rms: float
    drift: float
    flicker: float
    pixels: int


def measure_response(
    frames: npt.NDArray[Any], greys: npt.ArrayLike, saturation_dn: float, min_contrast: float = 0.08
) -> Response:
    """Return the tone curve from `frames` (n, height, width) of uniform pictures of the grey levels `greys` (n,).

    Each pixel sees `a + b d(k) light(greys[k])`: its own offset a (ambient and dark) and scale b (surface, vignetting),
    the lamp's drift d. These three and the light are fitted in turn; pixels that reach `saturation_dn`, whose
    contrast between darkest and brightest level is below `min_contrast` of it, or that do not follow the model (what
    moved, hot pixels), are left out. The drift comes from levels shown several times.

    Raises
    ------
    ValueError
        too few levels or pixels, no repeated brightest and darkest level, or a frame that shows another level.

    References
    ----------
    Guo, He & Chen 2004 (gamma from grey statistics); Zhang & Yau 2007, section 3 (response measured, inverted).

    Examples
    --------
    >>> greys = np.concatenate([[255, 0], np.linspace(0, 255, 33).round(), [255, 0]])
    >>> surface = np.linspace(60, 200, 600).reshape(20, 30)
    >>> frames = 5 + surface * (greys[:, None, None] / 255) ** 2.2
    >>> bool(abs(measure_response(frames, greys, 255.0).curve[128] - (128 / 255) ** 2.2) < 1e-3)
    True
    """
    levels = np.asarray(greys, np.float64)
    _check(frames, levels)
    seen = _chosen(frames, levels, saturation_dn, min_contrast)
    drift, flicker = _drift(seen, levels)
    light, keep = _fit(seen, levels, drift)
    response = _joined(seen[:, keep], levels, (light, drift, flicker))
    _refuse_strays(response, light, levels)
    return response


def _check(frames: npt.NDArray[Any], levels: Float64Array) -> None:
    if frames.ndim != 3 or levels.shape != frames.shape[:1]:
        raise ValueError(f"frames of shape {frames.shape} for {levels.size} grey levels; there is one frame a level")
    different = np.unique(levels)
    if len(different) < MIN_LEVELS:
        raise ValueError(f"{len(different)} different grey levels; a curve needs {MIN_LEVELS} or more: use 33")
    ends = [int((levels == end).sum()) for end in (different[0], different[-1])]
    if min(ends) < 2:
        raise ValueError(
            f"the darkest and the brightest level were shown {ends[0]} and {ends[1]} times; show both at least twice, "
            "so that a drift of the lamp does not look like tone"
        )


def _chosen(frames: npt.NDArray[Any], levels: Float64Array, saturation_dn: float, min_contrast: float) -> Float32Array:
    """Return (n, pixels): those that see the whole range and never saturate, at most MOST_PIXELS."""
    bright = frames[np.flatnonzero(levels == levels.max())].mean(axis=0, dtype=np.float32)
    dark = frames[np.flatnonzero(levels == levels.min())].mean(axis=0, dtype=np.float32)
    contrast = bright - dark
    saturated = frames.max(axis=0) >= saturation_dn
    good = ~saturated & (contrast > min_contrast * min(saturation_dn, 1e30)) if np.isfinite(saturation_dn) else (
        contrast > 0.1 * np.quantile(contrast, 0.95))  # fmt: skip
    found = np.flatnonzero(np.asarray(good).ravel())
    if len(found) < MIN_PIXELS:
        raise ValueError(
            f"{len(found)} of {good.size} pixels see the whole range of grey levels ({saturated.mean():.0%} saturate); "
            f"{MIN_PIXELS} are needed: put a light, matt surface before the rig, and choose the exposure so that its "
            "brightest part is just below saturation"
        )
    taken = found[:: -(-len(found) // MOST_PIXELS)]
    return np.ascontiguousarray(frames.reshape(len(frames), -1)[:, taken], np.float32)


def _drift(seen: Float32Array, levels: Float64Array) -> tuple[Float64Array, float]:
    """Return the lamp's slow drift (n,) and its scatter from frame to frame, from the repeated brightest level."""
    whites = np.flatnonzero(levels == levels.max())
    dark = seen[levels == levels.min()].mean(axis=0)
    scale = seen[whites].mean(axis=0) - dark
    weight = float(scale @ scale)
    brightness = np.array([float((seen[k] - dark) @ scale) / weight for k in whites])
    degree = 0 if len(whites) < 4 else 1 if len(whites) < 7 else 2
    at = np.linspace(-1, 1, len(levels))
    polynomial = np.polynomial.Polynomial.fit(at[whites], brightness, degree, domain=(-1, 1))
    left = brightness - polynomial(at[whites])
    flicker = float(np.sqrt(left @ left / max(len(whites) - degree - 1, 1)))
    drift: Float64Array = np.asarray(polynomial(at), np.float64)
    return drift / drift.mean(), flicker


def _fit(seen: Float32Array, levels: Float64Array, drift: Float64Array) -> tuple[Float64Array, npt.NDArray[np.bool_]]:
    """Return the light of each frame (n,), drift removed, 0 to 1, and which pixels follow the model."""
    offset = seen[levels == levels.min()].mean(axis=0)
    scale = seen[levels == levels.max()].mean(axis=0) - offset
    keep = np.ones(seen.shape[1], bool)
    light = np.zeros(len(levels))
    for _ in range(_ROUNDS):
        b, a, part = scale[keep], offset[keep], seen[:, keep]
        raw = (part @ b - float(a @ b)) / float(b @ b)
        light = _spanned(raw / drift, levels)
        shown = np.asarray(light * drift, np.float32)
        centred = shown - shown.mean()
        mean = seen.mean(axis=0)
        scale = (centred @ seen) / np.float32(centred @ centred)
        offset = mean - scale * shown.mean()
        left = seen - offset - np.outer(shown, scale)
        misfit = np.sqrt((left * left).mean(axis=0)) / np.maximum(scale, 1e-6)
        keep = misfit < _OUTLIER_SIGMAS * np.median(misfit) + 1e-6
    return light, keep


def _spanned(light: Float64Array, levels: Float64Array) -> Float64Array:
    low, high = (float(light[levels == end].mean()) for end in (levels.min(), levels.max()))
    return (light - low) / (high - low)


def _joined(seen: Float32Array, levels: Float64Array, fitted: tuple[Float64Array, Float64Array, float]) -> Response:
    """Average frames of one level, and lay the smooth curve through them."""
    light, drift, flicker = fitted
    noise = float(np.median(np.abs(np.diff(seen[levels == levels.max()][:2], axis=0)))) / 0.6745 / np.sqrt(2)
    scale = float(np.median(seen[levels == levels.max()][0] - seen[levels == levels.min()][0]))
    single = np.hypot(noise / max(scale, 1e-6) / np.sqrt(seen.shape[1]), flicker * np.maximum(light, 0.0))
    different, place, count = np.unique(levels, return_inverse=True, return_counts=True)
    mean = np.bincount(place, light) / count
    scatter = np.sqrt(np.bincount(place, single**2)) / count
    curve, deviation = monotone_curve(different, mean, np.maximum(scatter, 2e-5))
    left = mean - np.interp(different, np.arange(256), curve)
    found = Response(different, mean, scatter, curve, deviation, 0.0, 0.0, flicker, seen.shape[1])
    return replace(found, rms=float(np.sqrt(np.mean(left**2))), drift=float(drift[-1] - drift[0]))


def _refuse_strays(response: Response, light: Float64Array, levels: Float64Array) -> None:
    expected = np.interp(levels, np.arange(256), response.curve)
    off = np.abs(light - expected)
    worst = int(off.argmax())
    if off[worst] > max(_STRAY, 8 * response.flicker):
        raise ValueError(
            f"frame {worst} of grey level {levels[worst]:.0f} shows {light[worst]:.3f} of the range where its "
            f"neighbours say {expected[worst]:.3f}; it was late, or the surface moved: take the ramp again"
        )
