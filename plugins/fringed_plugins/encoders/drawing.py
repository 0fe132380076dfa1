"""Pictures of fringes: one line where all lines are alike, the whole panel where dots vary.

Owns the way from a frame's description to the picture that shows it; the arithmetic is in `phase`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fringed.data import Channel, PatternFrame, UInt8Array
from fringed_plugins.phase.projection import profiles
from fringed_plugins.phase.projection.patterns import Float64Array, Greys

_CHANNELS: dict[Channel, int] = {"red": 0, "green": 1, "blue": 2}
_MOST_BYTES = 256 * 1024 * 1024


def images(frames: Sequence[PatternFrame], greys: Greys, size_px: tuple[int, int], dither: str) -> list[UInt8Array]:
    """Return the picture of each frame, `(height or 1, width or 1, 1 or 3)`.

    Parameters
    ----------
    greys
        the grey levels at full light; a frame's `level` is a share of that.
    size_px
        height and width of the projector's panel.
    dither
        how whole grey levels vary: "none", "quiet", "ordered" or "error-diffusion".

    Raises
    ------
    ValueError
        a tone curve that does not rise, or pictures of more than 256 MiB together.
    """
    whole = dither not in ("none", "quiet") or any(frame.style == "binary-dithered" for frame in frames)
    depth = 1 if all(frame.channel == "white" for frame in frames) else 3
    total = len(frames) * size_px[0] * size_px[1] * depth
    if whole and total > _MOST_BYTES:
        raise ValueError(
            f"{len(frames)} dithered patterns of {size_px[1]} x {size_px[0]} px take {total / 2**20:.0f} MiB, more "
            f"than {_MOST_BYTES / 2**20:.0f}: use fewer frames, or dither = none"
        )
    return [_image(frame, replace(greys, level=frame.level), size_px, dither) for frame in frames]


def _image(frame: PatternFrame, greys: Greys, size_px: tuple[int, int], dither: str) -> UInt8Array:
    """Return one frame's picture. A complement is made of the pattern before it, which is half a turn away."""
    columns = frame.orientation == "columns"
    length, lines = (size_px[1], size_px[0]) if columns else size_px
    shift = frame.shift_rad - np.pi * frame.inverted
    u = np.arange(length, dtype=np.float64)
    phase = 2 * np.pi * u / frame.period_px + frame.initial_phase_rad + shift
    light = profiles.profile(frame.style, phase, frame.period_px)
    if frame.style == "binary-dithered":
        from fringed_plugins.phase.projection import dithering

        light = dithering.diffuse(_panel(light, lines), np.array([0.0, 1.0])).astype(np.float64)
    elif dither not in ("none", "quiet"):
        light = _panel(light, lines)
    else:
        light = light[None, :]
    if dither == "quiet":
        equal = abs(frame.shift_rad - 2 * np.pi * frame.step / frame.steps) < 1e-9
        wanted = 1 - light[0] if frame.inverted else light[0]
        grey = greys.sparing(wanted, frame.period_px, frame.steps if equal else 0)[None, :]
        return coloured(grey if columns else grey.T, frame.channel)
    grey = greys.of(light, dither)
    if frame.inverted:
        grey = greys.complement(light, grey, dither)
    return coloured(grey if columns else grey.T, frame.channel)


def _panel(line: Float64Array, lines: int) -> Float64Array:
    """Return (lines, length), each row the same line."""
    return np.broadcast_to(line, (lines, len(line)))


def coloured(grey: UInt8Array, channel: Channel) -> UInt8Array:
    """Return (height, width, 1), or with three channels where light is coloured, so that it cannot be mistaken."""
    if channel == "white":
        return np.ascontiguousarray(grey[:, :, None])
    image = np.zeros((*grey.shape, 3), np.uint8)
    image[:, :, _CHANNELS[channel]] = grey
    return image
