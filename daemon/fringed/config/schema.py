"""The station's configuration as msgspec structs: names, units, limits and help in one place.

Owns what may be configured; `validation` reads and checks it. What hardware.md could not verify is
configurable here and marked in its description.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from fringed.config.simulated import SimulationConfig


def _units(units: str) -> dict[str, Any]:
    return {"units": units}


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every section: unknown keys are errors."""


class LogConfig(Section, frozen=True, kw_only=True):
    """How the daemon logs."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Annotated[Literal["auto", "json", "text"], Meta(description="auto: text on a terminal, else JSON")] = "auto"


class DeviceConfig(Section, frozen=True, kw_only=True):
    """Which driver runs a device, with the driver's own options."""

    driver: Annotated[
        str, Meta(min_length=1, description="none, sim, replay, one of docs/devices.md, or a plug-in's driver")
    ] = "none"
    options: dict[str, Any] = {}


class CameraConfig(DeviceConfig, frozen=True, kw_only=True):
    """The camera and its settings."""

    exposure_us: Annotated[float, Meta(gt=0, le=1e7, extra_json_schema=_units("us"))] = 8333.333
    gain_db: Annotated[float, Meta(ge=0, le=48, extra_json_schema=_units("dB"))] = 0.0
    bits: Literal[8, 10, 12, 16] = 8
    channel: Annotated[
        Literal["white", "red", "green", "blue", "rgb"],
        Meta(description="what a frame holds; rgb: three frames of one exposure, for patterns of one shot"),
    ] = "green"
    trigger: Literal["free-running", "software", "hardware"] = "free-running"


class AcquisitionConfig(Section, frozen=True, kw_only=True):
    """How a set is taken."""

    latency_s: (
        Annotated[
            float,
            Meta(ge=0, le=2, description="flip to light; unset: measured first", extra_json_schema=_units("s")),
        ]
        | None
    ) = None
    settle_s: Annotated[
        float, Meta(ge=0, le=2, description="LCD settling, added to the latency [A]", extra_json_schema=_units("s"))
    ] = 0.012
    retries: Annotated[int, Meta(ge=0, le=100, description="how often a set that fails its check is retaken")] = 3
    frame_timeout_s: Annotated[float, Meta(gt=0, le=60, extra_json_schema=_units("s"))] = 2.0
    reconnect_s: Annotated[
        float, Meta(gt=0, le=60, description="pause between attempts to open a device", extra_json_schema=_units("s"))
    ] = 1.0
    preview_hz: Annotated[float, Meta(ge=0, le=60, extra_json_schema=_units("Hz"))] = 10.0


class CheckConfig(Section, frozen=True, kw_only=True):
    """The station's own check of a set, before it is announced."""

    residual_max: Annotated[
        float,
        Meta(gt=0, le=1, description="largest misfit of an N-step group to a sinusoid, relative to its modulation"),
    ] = 0.08
    saturated_max: Annotated[float, Meta(ge=0, le=1, description="largest fraction of saturated pixels")] = 0.25
    lit_min: Annotated[float, Meta(ge=0, le=1, description="smallest fraction of pixels with fringes")] = 0.005
    grid_px: Annotated[int, Meta(ge=1, le=64, description="check every n-th pixel in both directions")] = 4


class StageConfig(Section, frozen=True, kw_only=True):
    """One processor of a pipeline."""

    processor: Annotated[str, Meta(min_length=1)]
    name: Annotated[str, Meta(description="defaults to the processor's name")] = ""
    params: dict[str, Any] = {}
    inputs: Annotated[dict[str, str], Meta(description="input name -> role or earlier stage; the rest by type")] = {}
    keep: Annotated[bool, Meta(description="record and announce this stage's product too")] = True


class PipelineConfig(Section, frozen=True, kw_only=True):
    """What is projected and what becomes of the frames."""

    encoder: Annotated[str, Meta(min_length=1)]
    encoder_params: dict[str, Any] = {}
    stages: Annotated[list[StageConfig], Meta(min_length=1)]
    roles: Annotated[list[str], Meta(min_length=1, description="sets to take, in order")] = msgspec.field(
        default_factory=lambda: ["object"]
    )
    camera: Annotated[dict[str, Any], Meta(description="camera settings that this pipeline needs")] = {}
    role_camera: Annotated[
        dict[str, dict[str, Any]],
        Meta(description="role -> camera settings of its set; exposure_factor multiplies the exposure"),
    ] = {}
    summary: str = ""


class PresetConfig(Section, frozen=True, kw_only=True):
    """A named scan: a pipeline with other parameters."""

    pipeline: Annotated[str, Meta(min_length=1)]
    encoder_params: dict[str, Any] = {}
    camera: dict[str, Any] = {}
    role_camera: dict[str, dict[str, Any]] = {}
    stages: dict[str, dict[str, Any]] = {}
    summary: str = ""


class WorkerConfig(Section, frozen=True, kw_only=True):
    """The plug-in hosts."""

    count: Annotated[int, Meta(ge=0, le=64)] = 2
    threads: Annotated[int, Meta(ge=0, le=256, description="threads of one worker; 0: one per core")] = 0
    memory_mb: Annotated[
        int, Meta(ge=256, description="a worker that grows beyond it is ended", extra_json_schema=_units("MB"))
    ] = 1800
    job_timeout_s: Annotated[float, Meta(gt=0, le=86400, extra_json_schema=_units("s"))] = 120.0
    attempts: Annotated[int, Meta(ge=1, le=10, description="failures before a set is quarantined")] = 3
    plugin_folders: list[str] = []


class TcpConfig(Section, frozen=True, kw_only=True):
    """Serving other machines: CURVE encrypts, ZAP admits only known clients' keys."""

    bind: Annotated[str, Meta(pattern=r"^[^\s:]+$|^\[[0-9a-fA-F:]+\]$", description="address to bind, such as 0.0.0.0")]
    control_port: Annotated[int, Meta(ge=1, le=65535)] = 7601
    stream_port: Annotated[int, Meta(ge=1, le=65535)] = 7602
    work_port: Annotated[int, Meta(ge=1, le=65535)] = 7603
    keys_dir: Annotated[str, Meta(min_length=1, description="server.key_secret and clients/*.key")]


class StreamConfig(Section, frozen=True, kw_only=True):
    """The lossy stream."""

    high_water_mark: Annotated[int, Meta(ge=1, le=100, description="messages kept for a slow subscriber")] = 2


class StationConfig(Section, frozen=True, kw_only=True):
    """A whole station."""

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9._-]{1,64}$")] = "station"
    data_dir: Annotated[str, Meta(description="recordings; empty: $FRINGED_DATA_DIR, else $XDG_DATA_HOME/fringed")] = ""
    runtime_dir: Annotated[
        str, Meta(description="sockets; empty: $FRINGED_RUNTIME_DIR, else $XDG_RUNTIME_DIR/fringed")
    ] = ""
    calibration: Annotated[
        str,
        Meta(
            description="adopted: the one that `fringe calibration use` put in force, none until then; simulated: the "
            "same, and the simulated rig's own exact one until then; else a calibration's file; empty: none for good"
        ),
    ] = "adopted"
    board: Annotated[
        dict[str, Any], Meta(description="the calibration board that this station has; keys as `fringe board --toml`")
    ] = {}
    record_truth: Annotated[bool, Meta(description="record the simulator's truth with every set")] = False
    log: LogConfig = LogConfig()
    camera: CameraConfig = CameraConfig()
    projector: DeviceConfig = DeviceConfig()
    simulation: SimulationConfig = SimulationConfig()
    acquisition: AcquisitionConfig = AcquisitionConfig()
    checks: CheckConfig = CheckConfig()
    workers: WorkerConfig = WorkerConfig()
    stream: StreamConfig = StreamConfig()
    tcp: TcpConfig | None = None
    default_pipeline: str = "hierarchical"
    pipelines: dict[str, PipelineConfig] = {}
    presets: dict[str, PresetConfig] = {}
