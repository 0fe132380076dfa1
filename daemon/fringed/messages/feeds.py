"""What the daemon and a worker say to each other about a set that is still being taken (decision 12).

Owns these messages of `work`; knows no socket. A set of n frames is one `FeedBegin`, n times `FeedFrame`, and a
`Job` with a `FedSet` among its inputs, or `FeedDrop`. The worker answers `FeedTaken` when it has begun and after each
frame, `FeedLost` when it has forgotten a feed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from fringed.data import (
    Array,
    CameraSettings,
    CheckReport,
    FrameStamp,
    Frozen,
    PatternSequence,
    Provenance,
    Role,
)
from fringed.messages.work import StageCall


@dataclass(frozen=True)
class FeedBegin:
    """Frames of a set will come while it is taken, for a job of these `stages` that may follow.

    `feed` is the set's id; a set that is taken again is another feed. There is one frame for each pattern of
    `sequence`, in order, `(height_px, width_px)` of `dtype`. `roles` are all sets that the job takes.
    """

    feed: str
    scan: str
    role: Role
    roles: tuple[Role, ...]
    stages: tuple[StageCall, ...]
    sequence: PatternSequence
    settings: CameraSettings
    height_px: int
    width_px: int
    dtype: Literal["uint8", "uint16"] = "uint8"


@dataclass(frozen=True)
class FeedFrame(Frozen):
    """Frame `index` of a feed, `(height, width)`."""

    feed: str
    index: int
    image: Array


@dataclass(frozen=True)
class FeedDrop:
    """Forget that feed; answered by `FeedLost`."""

    feed: str
    reason: str = ""


@dataclass(frozen=True)
class FedSet:
    """A frame set among a job's inputs whose frames were fed: everything else of it, but its patterns."""

    id: str
    role: Role = "object"
    scan: str = ""
    stamps: tuple[FrameStamp, ...] = ()
    settings: CameraSettings = field(default_factory=CameraSettings)
    check: CheckReport | None = None
    retakes: int = 0
    provenance: Provenance = field(default_factory=Provenance)


@dataclass(frozen=True)
class FeedTaken:
    """That many frames of a feed have been dealt with; 0: it has begun."""

    feed: str
    frames: int


@dataclass(frozen=True)
class FeedLost:
    """A feed is forgotten, and why; a `job` that refers to it was not begun: send it whole."""

    feed: str
    reason: str
    job: str = ""
