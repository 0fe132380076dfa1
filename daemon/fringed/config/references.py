"""Names of a configuration that refer to each other: what one value cannot tell alone.

Owns these checks; they take a configuration, or the sound part of one.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from fringed.config.schema import PipelineConfig, StationConfig
from fringed.errors import Problem


def reference_problems(
    config: StationConfig, pipelines: Collection[str], wrong: Collection[str] = frozenset()
) -> list[Problem]:
    """Return every problem. `pipelines` are the names that are given, `wrong` the paths of values that are left out."""
    problems = [
        Problem(f"presets.{name}.pipeline", repr(preset.pipeline), _one_of(pipelines))
        for name, preset in config.presets.items()
        if preset.pipeline not in pipelines
    ]
    if config.default_pipeline not in pipelines:
        problems.append(Problem("default_pipeline", repr(config.default_pipeline), _one_of(pipelines)))
    for name, pipeline in config.pipelines.items():
        roles_wrong = any(path.startswith(f"pipelines.{name}.roles") for path in wrong)
        problems += () if roles_wrong else _stages(f"pipelines.{name}", pipeline)
    return problems + list(_devices(config, wrong))


def _stages(where: str, pipeline: PipelineConfig) -> Iterator[Problem]:
    known = set(pipeline.roles) | {"calibration"}
    for index, stage in enumerate(pipeline.stages):
        for input_name, source in stage.inputs.items():
            if source not in known:
                yield Problem(f"{where}.stages[{index}].inputs.{input_name}", repr(source), _one_of(known))
        own = stage.name or stage.processor
        if own in known:
            yield Problem(f"{where}.stages[{index}].name", repr(own), "a name not used before")
        known.add(own)


def _devices(config: StationConfig, wrong: Collection[str]) -> Iterator[Problem]:
    camera, projector = config.camera.driver, config.projector.driver
    if {"camera", "camera.driver"} & set(wrong):
        return
    if config.calibration == "simulated" and camera != "sim":
        yield Problem("calibration", "'simulated'", "a calibration file, since the camera is not simulated")
    if {"projector", "projector.driver"} & set(wrong):
        return
    if (camera == "sim") != (projector == "sim") and camera != "replay":
        yield Problem(
            "projector.driver", f"camera {camera!r} with projector {projector!r}", "both simulated or neither"
        )


def _one_of(names: Collection[str]) -> str:
    return f"one of {', '.join(sorted(names))}"
