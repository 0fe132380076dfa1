"""What the acquisition thread is asked for, and to whom it reports.

Owns the requests and the two protocols that the daemon implements: `Listener` and `SetSink`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from fringed.data import Array, CameraSettings, FrameSet, PatternSequence, Truth
from fringed.errors import FringedError
from fringed.messages import DeviceState, Event, Preview


@dataclass(frozen=True)
class AcquisitionRequest:
    """One scan's worth of frame sets: the same patterns for each of `roles`.

    Sets that the scan takes from recordings instead are not among `roles`. A role's settings are those of
    `by_role`, else `settings`. `truth` asks a simulated rig for its truth with every set.
    """

    scan: str
    sequence: PatternSequence
    roles: tuple[str, ...] = ("object",)
    settings: CameraSettings = field(default_factory=CameraSettings)
    truth: bool = False
    by_role: Mapping[str, CameraSettings] = field(default_factory=dict)

    def settings_of(self, role: str) -> CameraSettings:
        """Return the camera's settings for the set of `role`."""
        return self.by_role.get(role, self.settings)


@dataclass(frozen=True)
class LatencyRequest:
    """One measurement of the delay from flip to light, with these settings."""

    scan: str
    settings: CameraSettings


@dataclass(frozen=True)
class SetUnderWay:
    """A set that is being taken; each attempt at it has an id of its own. `settings` are those in force."""

    id: str
    scan: str
    role: str
    sequence: PatternSequence
    settings: CameraSettings


class SetSink(Protocol):
    """Where a set goes while it is taken."""

    def write(self, index: int, image: Array) -> None:
        """Take frame `index`; raises StorageError."""

    def commit(self, frame_set: FrameSet, /) -> Any:
        """Make the set lasting; raises StorageError."""

    def abort(self) -> None:
        """Forget the set; harmless when done before."""


# set id, patterns, shape (n, height, width), dtype
OpenSet = Callable[[str, PatternSequence, tuple[int, int, int], npt.DTypeLike], SetSink]


class Listener(Protocol):
    """Whoever is told. Called in the acquisition thread: every method returns at once."""

    def device_state(self, which: str, state: DeviceState) -> None:
        """Hear how "camera" or "projector" is now."""

    def progress(self, scan: str, fraction: float, text: str) -> None:
        """Hear how far a scan's acquisition is, 0 to 1."""

    def preview(self, preview: Preview) -> None:
        """See a small picture."""

    def frame(self, of: SetUnderWay, index: int, image: Array) -> None:
        """See frame `index`, `(height, width)`, of a set that may not pass its check; it never changes."""

    def set_taken(self, frame_set: FrameSet, last_frame_delivered_monotonic_s: float, sink: SetSink) -> None:
        """Take over a checked set, written to `sink` and not committed yet: that is the listener's from here."""

    def discarded(self, count: int) -> None:
        """Hear how many frames of an attempt, good or not, came and were of no use: too early, mostly."""

    def truth(self, truth: Truth) -> None:
        """Take what the simulated rig knows of the set `truth.frame_set`."""

    def event(self, event: Event) -> None:
        """Hear what happened."""

    def finished(self, scan: str) -> None:
        """Hear that every set of a scan was taken (or its calibration is done)."""

    def failed(self, scan: str, error: FringedError) -> None:
        """Hear that a scan was given up."""


def small_picture(image: Array, top: float, width_px: int = 350) -> Array:
    """Return every n-th pixel of `image` (h, w) as uint8, at most `width_px` wide."""
    step = max(1, -(-image.shape[1] // width_px))
    small = image[::step, ::step]
    if small.dtype == np.uint8:
        return small.copy()
    return np.minimum(small * np.float32(255.0 / top), 255).astype(np.uint8)
