"""What serving needs of its siblings: acquisition, recording and workers.

Owns protocols only, so that none of the siblings imports another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from fringed.data import Array, CameraSettings, FrameSet, PatternSequence
from fringed.errors import FringedError
from fringed.messages import (
    ErrorInfo,
    FeedBegin,
    Job,
    JobDone,
    JobProgress,
    PluginInfo,
    QuarantineEntry,
    StageDone,
    WorkerState,
)
from fringed.wire import Encoded

T = TypeVar("T")


class Thread(Protocol):
    """A thread that does what it is given, in order; the callbacks run in that thread."""

    def submit(
        self, work: Callable[[], T], on_done: Callable[[T], None], on_error: Callable[[FringedError], None]
    ) -> None:
        """Queue work; raises StorageError when too much waits."""


class Records(Protocol):
    """The store."""

    def save(self, product: Any, record_id: str = "", encoded: Encoded | None = None) -> Any:
        """Record a product."""

    def load(self, record_id: str, verify: bool = True) -> Any:
        """Return what was recorded."""

    def list(
        self, kind: str | None = None, scan: str | None = None, limit: int = 100, before: str | None = None
    ) -> list[dict[str, Any]]:
        """Return what there is, newest first."""

    def free_bytes(self) -> int:
        """Return the room left."""


@dataclass(frozen=True)
class JobWatcher:
    """Who wants to know about one job; `on_failed` or `on_done` comes exactly once, and last."""

    on_stage: Callable[[StageDone], None]
    on_done: Callable[[JobDone], None]
    on_failed: Callable[[ErrorInfo, bool], None]
    on_progress: Callable[[JobProgress], None]


class Jobs(Protocol):
    """The work socket."""

    def submit(self, job: Job, watcher: Any, timeout_s: float | None = None) -> None:
        """Queue a job; raises Quarantined or UsageError."""

    def cancel(self, job: str) -> bool:
        """Stop a job."""

    def taken(self, job: str, stage: str) -> None:
        """Tell a job's worker that a product of it is announced."""

    def feed_begin(self, begin: FeedBegin) -> None:
        """Feed a set to an idle worker, if there is one."""

    def feed_frame(self, feed: str, index: int, image: Array) -> None:
        """Send its next frame; harmless where nobody is fed."""

    def feed_drop(self, feed: str, reason: str) -> None:
        """Have its frames forgotten; harmless where nobody is fed, or a job has them."""


class Hosts(Protocol):
    """What is known of workers and their plug-ins."""

    def states(self) -> tuple[WorkerState, ...]:
        """Return how every worker is."""

    def plugins(self) -> tuple[PluginInfo, ...]:
        """Return what they loaded."""

    def schemas(self) -> dict[str, dict[str, Any]]:
        """Return the parameters of everything, by kind and name."""

    def quarantined(self) -> tuple[QuarantineEntry, ...]:
        """Return what is not tried again."""

    def clear_quarantine(self, subject: str) -> int:
        """Allow a subject (empty: all) again."""


class Rig(Protocol):
    """The thread that touches the devices; what it has to tell comes to `Scans`, in the reactor's thread."""

    def take(
        self,
        scan: str,
        roles: tuple[str, ...],
        sequence: PatternSequence,
        settings: Mapping[str, CameraSettings],
        truth: bool,
    ) -> None:
        """Queue the sets of one scan, `settings` by role; raises DeviceAbsent where there is no rig."""

    def cancel(self, scan: str) -> None:
        """Stop taking sets of a scan."""

    def calibrate_latency(self, scan: str) -> None:
        """Queue a measurement of the delay from display to camera; raises DeviceAbsent."""

    def size_px(self) -> tuple[int, int]:
        """Return the projector's size; raises DeviceAbsent."""


class SetUnderWay(Protocol):
    """A set that is being taken; it has not passed its check, and may never. Each attempt has an id of its own."""

    @property
    def id(self) -> str:
        """What the set will be called if it is good."""

    @property
    def scan(self) -> str:
        """The scan that it is for."""

    @property
    def role(self) -> str:
        """Its role there."""

    @property
    def sequence(self) -> PatternSequence:
        """Its patterns."""

    @property
    def settings(self) -> CameraSettings:
        """What the camera was told."""


@dataclass(frozen=True)
class AcquiredSet:
    """A set that passed its check, not yet on the disk.

    `commit` puts it there, in the recorder's thread; `discard` drops it instead. Times are the reactor's.
    """

    frame_set: FrameSet
    commit: Callable[[Encoded], Any]
    discard: Callable[[], None]
    last_frame_s: float
    checked_s: float
