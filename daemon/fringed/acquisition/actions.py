"""What the sequencer is told and what it asks for, as dataclasses.

Owns the vocabulary between the pure state machine and whoever drives devices. Times are seconds on
the rig's clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# Events: what happened.


@dataclass(frozen=True)
class Flipped:
    """The pattern asked for is on its way out since `time_s`."""

    time_s: float


@dataclass(frozen=True)
class Reached:
    """The time waited for has come; it is `time_s`."""

    time_s: float


@dataclass(frozen=True)
class Triggered:
    """The camera was told to integrate at `time_s`."""

    time_s: float


@dataclass(frozen=True)
class FrameArrived:
    """The camera delivered a frame, at `delivered_s`."""

    counter: int
    exposure_start_s: float
    exposure_end_s: float
    delivered_s: float


@dataclass(frozen=True)
class TimedOut:
    """No frame came in time."""

    waited_s: float


@dataclass(frozen=True)
class DeviceFailed:
    """A device raised."""

    reason: str


Event = Flipped | Reached | Triggered | FrameArrived | TimedOut | DeviceFailed

# Actions: what to do next.


@dataclass(frozen=True)
class Show:
    """Show pattern `index`; answer with Flipped."""

    index: int


@dataclass(frozen=True)
class WaitUntil:
    """Let time pass until `time_s`; answer with Reached."""

    time_s: float


@dataclass(frozen=True)
class Trigger:
    """Start one integration; answer with Triggered."""


@dataclass(frozen=True)
class ReadFrame:
    """Read the next frame; answer with FrameArrived or TimedOut."""

    timeout_s: float


@dataclass(frozen=True)
class Keep:
    """The frame that just arrived is the one of pattern `index`, whose flip was at `flip_s`."""

    index: int
    flip_s: float


@dataclass(frozen=True)
class Discard:
    """The frame that just arrived is of no use."""

    reason: str


@dataclass(frozen=True)
class Finished:
    """Every pattern has its frame."""


@dataclass(frozen=True)
class Failed:
    """The set cannot be completed."""

    fault: Literal["stalled", "device", "times"]
    reason: str


Action = Show | WaitUntil | Trigger | ReadFrame | Keep | Discard | Finished | Failed
