"""A pattern as the light that reaches a surface: tone curve, colours, pixel aperture and blur.

Owns the projector's image formation; knows nothing of scenes and time. A pattern of one row or one column stays
one: its light is a line, exact at any position between pixels but for an interpolation error below 1e-3 of a
sinusoid of 16 pixels. Beyond the panel it is dark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import erf, sqrt

import numpy as np

from fringed.data import Array, Channel, Float32Array, Float64Array

LINE_SAMPLES = 8  # per projector pixel
PICTURE_SAMPLES = 2
_LUMINANCE = np.array([0.299, 0.587, 0.114])
_NO_LINE = np.zeros((0, 0), np.float32)
_NO_PICTURE = np.zeros((0, 0, 0), np.float32)


@dataclass(frozen=True)
class Light:
    """What columns, rows and the whole picture give; empty where they give nothing.

    `columns` (levels, width x 8 + 2) and `rows` start half a pixel before the first pixel's centre; `picture` is
    (levels, 2 height, 2 width).
    """

    columns: Float32Array
    rows: Float32Array
    picture: Float32Array


def channel_mix(crosstalk: Sequence[Sequence[float]], channel: Channel) -> Float64Array:
    """Return how much of the projector's red, green and blue (3,) a camera channel sees; "white" is luminance."""
    matrix = np.array(crosstalk)
    if channel == "white":
        return np.asarray(_LUMINANCE @ matrix)
    return np.asarray(matrix[("red", "green", "blue").index(channel)])


def light_of(
    pattern: Array, mix: Float64Array, response: Float64Array, optics: tuple[Array, tuple[float, float]]
) -> Light:
    """Return the light of `pattern` (height or 1, width or 1, 1 or 3) uint8 as one camera channel sees it.

    `response` (256,) is the light of each grey level; `optics` the blur (levels,) in pixels and the displacement of
    red and of blue against green, along columns and rows alike.
    """
    sigmas, (red, blue) = optics
    light = response[pattern]
    if pattern.shape[2] == 1:
        light = np.broadcast_to(light, (*pattern.shape[:2], 3))
    parts: list[tuple[float, Array]] = [(0.0, light @ mix)]
    if red or blue:
        parts = [(shift, light[..., c] * mix[c]) for c, shift in enumerate((red, 0.0, blue))]
    if pattern.shape[0] > 1 and pattern.shape[1] > 1:
        return Light(_NO_LINE, _NO_LINE, sum(_picture(part, sigmas, shift) for shift, part in parts))  # type: ignore[arg-type]
    line = sum(_line(part.reshape(-1), tuple(sigmas), shift) for shift, part in parts)
    if pattern.shape[0] > 1:
        return Light(_NO_LINE, line, _NO_PICTURE)  # type: ignore[arg-type]
    return Light(line, _NO_LINE, _NO_PICTURE)  # type: ignore[arg-type]


def blend(parts: Sequence[tuple[float, Light]]) -> Light:
    """Return the weighted sum of lights."""
    if len(parts) == 1 and parts[0][0] == 1.0:
        return parts[0][1]
    return Light(*(_sum([(w, getattr(light, name)) for w, light in parts]) for name in ("columns", "rows", "picture")))


def _sum(parts: Sequence[tuple[float, Float32Array]]) -> Float32Array:
    given = [(weight, array) for weight, array in parts if array.size]
    if not given:
        return parts[0][1]
    return np.asarray(sum(np.float32(weight) * array for weight, array in given), dtype=np.float32)


def widened(pattern: Array, width_px: int) -> Array:
    """Return a uniform pattern (1, 1, c) as a line, so that it ends where the panel does."""
    if pattern.shape[:2] == (1, 1):
        return np.broadcast_to(pattern, (1, width_px, pattern.shape[2]))
    return pattern


@lru_cache(maxsize=8)
def _taps(sigmas: tuple[float, ...], shift: float) -> Float64Array:
    """Return the weights (levels, 8, window) of a pixel's neighbours: a box blurred by a Gaussian."""
    reach = int(np.ceil(4.5 * max(sigmas) + abs(shift))) + 1
    weights = np.empty((len(sigmas), LINE_SAMPLES, 2 * reach + 1))
    for level, sigma in enumerate(sigmas):
        scale = 1 / (sqrt(2) * max(sigma, 1e-4))
        for sample in range(LINE_SAMPLES):
            at = sample / LINE_SAMPLES - 0.5 - shift
            edges = np.array([erf((m - 0.5 - at) * scale) for m in range(-reach, reach + 2)])
            weights[level, sample] = np.diff(edges) / 2
    return weights


def _line(values: Array, sigmas: tuple[float, ...], shift: float) -> Float32Array:
    taps = _taps(sigmas, shift)
    reach = taps.shape[2] // 2
    padded = np.pad(values, (reach, reach + 1))
    table = np.empty((len(sigmas), len(values) + 1, LINE_SAMPLES), np.float32)
    for level in range(len(sigmas)):
        for sample in range(LINE_SAMPLES):
            table[level, :, sample] = np.correlate(padded, taps[level, sample], "valid")
    return table.reshape(len(sigmas), -1)


def _picture(values: Array, sigmas: Array, shift: float) -> Float32Array:
    import cv2

    fine = np.repeat(np.repeat(values.astype(np.float32), PICTURE_SAMPLES, axis=0), PICTURE_SAMPLES, axis=1)
    if shift:
        move = np.array([[1, 0, shift * PICTURE_SAMPLES], [0, 1, shift * PICTURE_SAMPLES]], np.float64)
        fine = np.asarray(cv2.warpAffine(fine, move, fine.shape[::-1]), dtype=np.float32)
    stack = np.empty((len(sigmas), *fine.shape), np.float32)
    for level, sigma in enumerate(sigmas * PICTURE_SAMPLES):
        cv2.GaussianBlur(fine, (0, 0), max(sigma, 0.05), dst=stack[level], borderType=cv2.BORDER_CONSTANT)
    return stack
