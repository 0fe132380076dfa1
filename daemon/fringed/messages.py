"""What client, daemon and worker say to each other, as frozen dataclasses.

Owns the vocabulary of the three sockets; `wire` turns it into bytes. Knows no socket.

control: `Request` -> `Reply`.  stream: `StationState`, `Event`, `Preview`, and every recorded type.
work: `WorkerReady`, `WorkerAlive`, `JobProgress`, `StageDone`, `JobDone`, `JobFailed` -> `Job`,
`JobCancel`, `StageTaken`, `WorkerStop`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from fringed.data import Array, UInt8Array, _Frozen

DeviceStateName = Literal[
    "ABSENT", "CONNECTING", "IDLE", "ARMED", "ACQUIRING", "DEGRADED", "FAULT", "STANDBY", "WARMING", "ON", "COOLING"
]


@dataclass(frozen=True)
class ErrorInfo:
    """An error on its way: `code` is a class name of `errors`, `detail` its problems or a trace."""

    code: str
    message: str
    detail: tuple[str, ...] = ()


@dataclass(frozen=True)
class Request:
    """One question to the daemon; `params` may hold data objects at any depth."""

    id: str
    verb: str
    params: Mapping[str, Any] = field(default_factory=dict)
    deadline_s: float = 5.0
    lease: str = ""
    client: str = ""


@dataclass(frozen=True)
class Reply:
    """The answer to the request of the same id: a result or an error."""

    id: str
    result: Any = None
    error: ErrorInfo | None = None


@dataclass(frozen=True)
class DeviceState:
    """How one device is, and why."""

    state: DeviceStateName
    driver: str
    identity: str = ""
    detail: str = ""


@dataclass(frozen=True)
class LeaseState:
    """Who holds the rig."""

    holder: str
    scope: str
    expires_in_s: float


@dataclass(frozen=True)
class WorkerState:
    """How one worker is."""

    worker: str
    pid: int
    state: Literal["starting", "idle", "busy", "restarting"]
    job: str = ""
    restarts: int = 0
    memory_mb: float = 0.0
    detail: str = ""


@dataclass(frozen=True)
class QuarantineEntry:
    """A frame set (or other input) and pipeline that are not tried again, and why."""

    subject: str
    pipeline: str
    reason: str
    attempts: int
    created: str


@dataclass(frozen=True)
class StationState:
    """What `fringe status` shows. `simulated` and `replayed` are never silent."""

    name: str
    version: str
    pid: int
    uptime_s: float
    simulated: bool
    replayed: bool
    rig: str
    calibration: str
    camera: DeviceState
    projector: DeviceState
    lease: LeaseState | None = None
    workers: tuple[WorkerState, ...] = ()
    quarantine: tuple[QuarantineEntry, ...] = ()
    scan: str = ""
    pipelines: tuple[str, ...] = ()
    counters: Mapping[str, int] = field(default_factory=dict)
    memory_mb: float = 0.0
    data_dir: str = ""
    free_disk_mb: float = 0.0
    config_path: str = ""


@dataclass(frozen=True)
class Event:
    """Something that happened: `name` such as "scan.progress", with its details."""

    name: str
    time: str
    level: Literal["debug", "info", "warning", "error"] = "info"
    text: str = ""
    detail: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Preview(_Frozen):
    """A small picture `(height, width)` uint8 of a frame, and what it is."""

    image: UInt8Array
    role: str
    index: int
    count: int
    scan: str = ""


@dataclass(frozen=True)
class ScanState:
    """How one scan or processing job is.

    `products` lists ids with their type and stage, `warnings` what plug-ins doubt.
    """

    id: str
    state: Literal["queued", "encoding", "acquiring", "processing", "done", "failed", "cancelled"]
    pipeline: str
    progress: float = 0.0
    text: str = ""
    frame_sets: Mapping[str, str] = field(default_factory=dict)
    products: tuple[Mapping[str, Any], ...] = ()
    timings_s: Mapping[str, float] = field(default_factory=dict)
    retakes: int = 0
    error: ErrorInfo | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class StageCall:
    """One step of a job: which plug-in, with which parameters, on which named inputs.

    `inputs` maps the plug-in's input names to job inputs or earlier stages; a name left out is
    matched by type. `keep` records its product too.
    """

    name: str
    kind: Literal["processor", "encoder", "exporter", "scene"]
    plugin: str
    params: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    keep: bool = True


@dataclass(frozen=True)
class Job:
    """Work for one worker; `inputs` holds data objects by name, `pipeline` names it for people."""

    id: str
    stages: tuple[StageCall, ...]
    inputs: Mapping[str, Any] = field(default_factory=dict)
    pipeline: str = ""
    scan: str = ""
    simulated: bool = False
    replayed: bool = False
    attempt: int = 1


@dataclass(frozen=True)
class JobCancel:
    """Stop that job at its next check."""

    job: str


@dataclass(frozen=True)
class StageTaken:
    """That stage's product is recorded and announced: a worker that held others back may send them."""

    job: str
    stage: str


@dataclass(frozen=True)
class WorkerStop:
    """Finish and go."""

    reason: str = ""


@dataclass(frozen=True)
class PluginInfo:
    """One loaded or broken plug-in. `provides` maps hooks to names, `error` tells why it is broken."""

    name: str
    distribution: str
    version: str
    api_version: int
    provides: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    error: str = ""


@dataclass(frozen=True)
class WorkerReady:
    """A worker asks for `credits` jobs."""

    worker: str
    pid: int
    credits: int = 1
    plugins: tuple[PluginInfo, ...] = ()
    schemas: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class WorkerAlive:
    """A sign of life, sent each second by the worker's own I/O thread."""

    worker: str
    job: str = ""


@dataclass(frozen=True)
class JobProgress:
    """How far a job is, 0 to 1, and in which stage; a `fraction` below 0 marks a line for the log."""

    job: str
    fraction: float
    text: str = ""
    level: Literal["debug", "info", "warning", "error"] = "info"
    stage: str = ""


@dataclass(frozen=True)
class StageDone:
    """One stage's product (None where `keep` is off), and how long it took."""

    job: str
    stage: str
    seconds: float
    product: Any = None


@dataclass(frozen=True)
class JobDone:
    """Every stage has answered."""

    job: str
    seconds: float = 0.0


@dataclass(frozen=True)
class JobFailed:
    """A stage raised; `retry` tells whether trying again can help."""

    job: str
    stage: str
    error: ErrorInfo
    retry: bool = True


@dataclass(frozen=True)
class Pixels(_Frozen):
    """A bare array, for whoever asks for one."""

    array: Array


MESSAGES: tuple[type, ...] = (
    Request, Reply, ErrorInfo, StationState, DeviceState, LeaseState, WorkerState, QuarantineEntry, Event,
    Preview, ScanState, StageCall, Job, JobCancel, StageTaken, WorkerStop, PluginInfo, WorkerReady, WorkerAlive,
    JobProgress, StageDone, JobDone, JobFailed, Pixels,
)  # fmt: skip
