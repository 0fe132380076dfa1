"""Patterns whose colours one exposure takes apart: may this camera take them, and which sets are judged for what.

Owns both questions; pure. A sequence with shots needs all three channels of a frame, any other needs one.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from fringed.config import CheckConfig
from fringed.data import Array, CameraSettings, PatternSequence
from fringed.errors import UsageError

RGB = ("red", "green", "blue")


def check_channels(sequence: PatternSequence, settings: CameraSettings) -> None:
    """Refuse a sequence that a camera with these settings cannot take.

    Raises
    ------
    UsageError
        shots without a camera of three channels, three channels without shots, or shots that are none.
    """
    plain = sum(frame.shot < 0 for frame in sequence.frames)
    if plain < len(sequence.frames) and settings.channel != "rgb":
        raise UsageError(
            f"the patterns of {sequence.encoder or sequence.family} carry a frame in each colour of one shot, and the "
            f'camera takes {settings.channel!r} alone; set channel = "rgb" in the pipeline\'s camera, or ask for '
            "camera channel=rgb"
        )
    if plain and settings.channel == "rgb":
        raise UsageError(
            f"the camera takes three channels in one exposure (channel 'rgb'), and {plain} of the "
            f"{len(sequence.frames)} patterns of {sequence.encoder or sequence.family} are one frame each; take them "
            "with channel green, red, blue or white, or use a one-shot pipeline"
        )
    for indices in sequence.exposures() if not plain else ():
        _check_shot(sequence, indices)


def _check_shot(sequence: PatternSequence, indices: tuple[int, ...]) -> None:
    frames = [sequence.frames[i] for i in indices]
    channels = [frame.channel for frame in frames]
    first = sequence.patterns[indices[0]]
    same = all(sequence.patterns[i] is first or (sequence.patterns[i] == first).all() for i in indices[1:])
    together = indices == tuple(range(indices[0], indices[-1] + 1))
    if set(channels) <= set(RGB) and len(set(channels)) == len(channels) and same and together:
        return
    raise UsageError(
        f"shot {frames[0].shot} has the frames {list(indices)} of channels {channels}; the frames of a shot follow "
        "each other, are red, green or blue, each once, and share one pattern"
    )


def channel_of(image: Array, channel: str) -> Array:
    """Return one channel `(height, width)` of an image `(height, width, 3)`."""
    return image[:, :, RGB.index(channel)]


def checks_of(role: str, settings: Mapping[str, CameraSettings], limits: CheckConfig) -> CheckConfig:
    """Return what a set is judged by where others of the same thing are taken with other exposures.

    `settings` are those of every role. Of the sets `object`, `object-long` and `object-short` only the shortest
    exposure is judged for saturation, and only the longest for light: that is what the others are there for.
    """
    light = {other: one.exposure_us * 10 ** (one.gain_db / 20) for other, one in settings.items() if _same(role, other)}
    if light[role] > min(light.values()):
        limits = msgspec.structs.replace(limits, saturated_max=1.0)
    if light[role] < max(light.values()):
        limits = msgspec.structs.replace(limits, lit_min=0.0)
    return limits


def _same(role: str, other: str) -> bool:
    """Tell whether two roles see the same thing: their names agree up to a hyphen."""
    return role.partition("-")[0] == other.partition("-")[0]
