"""What a client and the daemon say to each other, and what the daemon tells everybody.

Owns the messages of `control` and `stream`; knows no socket.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from fringed.data import Array, Frozen, UInt8Array

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
    """What `fringe status` shows. `simulated` and `replayed` are never silent; `calibration` is its hash."""

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
    calibration_origin: str = ""


@dataclass(frozen=True)
class Event:
    """Something that happened: `name` such as "scan.progress", with its details."""

    name: str
    time: str
    level: Literal["debug", "info", "warning", "error"] = "info"
    text: str = ""
    detail: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Preview(Frozen):
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
class Pixels(Frozen):
    """A bare array, for whoever asks for one."""

    array: Array
