"""What client, daemon and worker say to each other, as frozen dataclasses.

Owns the vocabulary of the three sockets; `wire` turns it into bytes. Knows no socket.

control: `Request` -> `Reply`.  stream: `StationState`, `Event`, `Preview`, and every recorded type.
work: `WorkerReady`, `WorkerAlive`, `JobProgress`, `StageDone`, `JobDone`, `JobFailed`, `FeedTaken`, `FeedLost` ->
`Job`, `JobCancel`, `StageTaken`, `WorkerStop`, `FeedBegin`, `FeedFrame`, `FeedDrop`.
"""

from __future__ import annotations

from fringed.messages.feeds import (
    FedSet,
    FeedBegin,
    FeedDrop,
    FeedFrame,
    FeedLost,
    FeedTaken,
)
from fringed.messages.station import (
    DeviceState,
    DeviceStateName,
    ErrorInfo,
    Event,
    LeaseState,
    Pixels,
    Preview,
    QuarantineEntry,
    Reply,
    Request,
    ScanState,
    StationState,
    WorkerState,
)
from fringed.messages.work import (
    Job,
    JobCancel,
    JobDone,
    JobFailed,
    JobProgress,
    PluginInfo,
    StageCall,
    StageDone,
    StageTaken,
    WorkerAlive,
    WorkerReady,
    WorkerStop,
)

__all__ = [
    "MESSAGES",
    "DeviceState",
    "DeviceStateName",
    "ErrorInfo",
    "Event",
    "FedSet",
    "FeedBegin",
    "FeedDrop",
    "FeedFrame",
    "FeedLost",
    "FeedTaken",
    "Job",
    "JobCancel",
    "JobDone",
    "JobFailed",
    "JobProgress",
    "LeaseState",
    "Pixels",
    "PluginInfo",
    "Preview",
    "QuarantineEntry",
    "Reply",
    "Request",
    "ScanState",
    "StageCall",
    "StageDone",
    "StageTaken",
    "StationState",
    "WorkerAlive",
    "WorkerReady",
    "WorkerState",
    "WorkerStop",
]

MESSAGES: tuple[type, ...] = (
    Request, Reply, ErrorInfo, StationState, DeviceState, LeaseState, WorkerState, QuarantineEntry, Event,
    Preview, ScanState, StageCall, Job, JobCancel, StageTaken, WorkerStop, PluginInfo, WorkerReady, WorkerAlive,
    JobProgress, StageDone, JobDone, JobFailed, FeedBegin, FeedFrame, FeedDrop, FedSet, FeedTaken, FeedLost, Pixels,
)  # fmt: skip
