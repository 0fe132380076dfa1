"""What a request for a scan or for processing means: which patterns, which sets, which stages.

Owns the merge of pipeline, preset and request; pure. Knows no device, worker or socket.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec

from fringed.config import PipelineConfig, PresetConfig, StageConfig, StationConfig, merged
from fringed.config.defaults import BOARD_PROCESSOR
from fringed.data import CameraSettings
from fringed.errors import NotFound, UsageError
from fringed.messages import StageCall
from fringed.serving.cameras import merged_roles, settings_by_role

Tables = Mapping[str, Any]
STAGE_KINDS = ("processor", "encoder", "exporter", "scene")


@dataclass(frozen=True)
class Plan:
    """One scan or processing job, completely described."""

    pipeline: str
    stages: tuple[StageCall, ...]
    encoder: StageCall | None = None
    roles: tuple[str, ...] = ()
    cameras: Mapping[str, CameraSettings] = field(default_factory=dict)  # by role
    given: Mapping[str, str] = field(default_factory=dict)
    truth: bool = False

    @property
    def to_take(self) -> tuple[str, ...]:
        """The roles whose sets have to be taken."""
        return tuple(role for role in self.roles if role not in self.given)


@dataclass(frozen=True)
class ScanWish:
    """What a client asked for; everything may be left out."""

    pipeline: str = ""
    preset: str = ""
    roles: Sequence[str] | None = None
    encoder_params: Tables = field(default_factory=dict)
    camera: Tables = field(default_factory=dict)
    role_camera: Tables = field(default_factory=dict)
    stages: Tables = field(default_factory=dict)
    frame_sets: Mapping[str, str] = field(default_factory=dict)
    truth: bool | None = None
    process: bool = True


def plan_scan(config: StationConfig, wish: ScanWish) -> Plan:
    """Return what to do.

    Raises
    ------
    NotFound
        no such pipeline or preset.
    UsageError, ConfigurationError
        roles, stages or settings that the pipeline does not have.
    """
    preset = _preset(config, wish)
    name = wish.pipeline or preset.pipeline
    pipeline = pipeline_of(config, name)
    roles = _roles(pipeline, name, wish)
    params = merged(merged(pipeline.encoder_params, preset.encoder_params), wish.encoder_params)
    camera = merged(merged(pipeline.camera, preset.camera), wish.camera)
    by_role = merged_roles(merged_roles(pipeline.role_camera, preset.role_camera), wish.role_camera)
    settings = settings_by_role(config.camera, camera, by_role, pipeline.roles)
    return Plan(
        name,
        stage_calls(pipeline, name, merged(preset.stages, wish.stages), config.board) if wish.process else (),
        StageCall("patterns", "encoder", pipeline.encoder, params),
        roles,
        {role: settings[role] for role in roles},
        dict(wish.frame_sets),
        config.record_truth if wish.truth is None else wish.truth,
    )


def plan_process(config: StationConfig, pipeline: str, stages: Sequence[Any] | None, params: Tables) -> Plan:
    """Return what to do with given inputs: a pipeline's stages, or those that the request lists; raises as above."""
    if stages is None:
        name = pipeline or config.default_pipeline
        return Plan(name, stage_calls(pipeline_of(config, name), name, params, config.board))
    calls = tuple(_stage_call(index, stage) for index, stage in enumerate(stages))
    names = [call.name for call in calls]
    unknown = sorted(set(params) - set(names))
    if not calls or unknown or len(set(names)) != len(names):
        raise UsageError(
            f"process has the stages {names} and parameters for {sorted(params)}; it needs one or more stages, each of "
            f"its own name, and parameters for these only"
        )
    return Plan(pipeline, tuple(replace(call, params=merged(call.params, params.get(call.name, {}))) for call in calls))


def pipeline_of(config: StationConfig, name: str) -> PipelineConfig:
    """Return a configured pipeline; raises NotFound with those that exist."""
    if name not in config.pipelines:
        raise NotFound(f"no pipeline is called {name!r}; there are {', '.join(sorted(config.pipelines))}")
    return config.pipelines[name]


def stage_calls(
    pipeline: PipelineConfig, name: str, params: Tables, board: Tables | None = None
) -> tuple[StageCall, ...]:
    """Return a pipeline's stages with other parameters, and the station's `board` where one looks for it.

    Raises
    ------
    UsageError
        parameters for stages that the pipeline does not have.
    """
    names = [stage.name or stage.processor for stage in pipeline.stages]
    unknown = sorted(set(params) - set(names))
    wrong = sorted(key for key, value in params.items() if not isinstance(value, Mapping))
    if unknown or wrong:
        raise UsageError(
            f"parameters for {', '.join(unknown or wrong)}; pipeline {name!r} has the stages {', '.join(names)}, "
            f"and each takes a table"
        )
    return tuple(
        StageCall(
            own, "processor", stage.processor, merged(_own(stage, board), params.get(own, {})), stage.inputs, stage.keep
        )
        for own, stage in zip(names, pipeline.stages, strict=True)
    )


def _own(stage: StageConfig, board: Tables | None) -> Tables:
    """Return a stage's configured parameters, over the station's board where the stage looks for it."""
    return merged({"board": board}, stage.params) if board and stage.processor == BOARD_PROCESSOR else stage.params


def _preset(config: StationConfig, wish: ScanWish) -> PresetConfig:
    if not wish.preset:
        return PresetConfig(pipeline=wish.pipeline or config.default_pipeline)
    if wish.preset not in config.presets:
        raise NotFound(f"no preset is called {wish.preset!r}; there are {', '.join(sorted(config.presets)) or 'none'}")
    preset = config.presets[wish.preset]
    if wish.pipeline and wish.pipeline != preset.pipeline:
        raise UsageError(
            f"preset {wish.preset!r} belongs to pipeline {preset.pipeline!r}, not {wish.pipeline!r}; give only one"
        )
    return preset


def _roles(pipeline: PipelineConfig, name: str, wish: ScanWish) -> tuple[str, ...]:
    roles = tuple(pipeline.roles if wish.roles is None else wish.roles)
    known = ", ".join(pipeline.roles)
    wrong = sorted({repr(role) for role in (*roles, *wish.frame_sets) if role not in pipeline.roles})
    if wrong:
        raise UsageError(f"pipeline {name!r} has no role {' or '.join(wrong)}; its roles: {known}")
    if not roles or len(set(roles)) != len(roles):
        raise UsageError(f"the roles are {list(roles)}; name at least one of pipeline {name!r} ({known}), each once")
    if wish.process:
        _check_supplied(pipeline, name, {*roles, *wish.frame_sets})
    return tuple(dict.fromkeys((*roles, *wish.frame_sets)))


def _check_supplied(pipeline: PipelineConfig, name: str, roles: set[str]) -> None:
    """Refuse a scan without a set that a stage names, before anything is taken."""
    made: set[str] = set()
    for stage in pipeline.stages:
        own = stage.name or stage.processor
        lacks = sorted({source for source in stage.inputs.values() if source in pipeline.roles} - roles - made)
        if lacks:
            raise UsageError(
                f"stage {own!r} of pipeline {name!r} needs the set {' and '.join(lacks)}, which roles leaves out; take "
                f"{', '.join(pipeline.roles)}, give a recorded set in frame_sets, or ask with process=false"
            )
        made.add(own)


def _stage_call(index: int, raw: Any) -> StageCall:
    if isinstance(raw, StageCall):
        return raw
    try:
        table = dict(raw)
        table.setdefault("kind", "processor")
        table.setdefault("plugin", table.get("name", ""))
        table.setdefault("name", table["plugin"])
        unknown = sorted(set(table) - set(StageCall.__dataclass_fields__))
        if unknown:
            raise ValueError(f"it has {', '.join(unknown)}")
        call = msgspec.convert(table, StageCall)
        if not call.plugin or not call.name:
            raise ValueError("it names no plug-in")
    except (ValueError, TypeError) as error:
        raise UsageError(
            f"stages[{index}] is {str(raw)[:80]}: {error}; a stage has name, kind ({', '.join(STAGE_KINDS)}), plugin, "
            f"params, inputs and keep"
        ) from error
    return call
