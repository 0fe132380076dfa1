"""What the daemon and a worker say to each other about jobs.

Owns these messages of `work`; knows no socket.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from fringed.messages.station import ErrorInfo


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
    """Work for one worker; `inputs` holds data objects by name, `pipeline` names it for people.

    An input may be a `FedSet`, in the place of the frame set that this worker was fed.
    """

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
    """A worker asks for `credits` jobs; `feeds`: it takes frames while they arrive."""

    worker: str
    pid: int
    credits: int = 1
    plugins: tuple[PluginInfo, ...] = ()
    schemas: Mapping[str, Any] = field(default_factory=dict)
    feeds: bool = False


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
