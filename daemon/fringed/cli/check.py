"""`fringed check`: every problem of a configuration, plug-ins' names and parameters included.

Owns the checks that need plug-ins; they are loaded in this process, never in the daemon.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import msgspec

from fringed.config import StationConfig, examined, merged, read_toml, validate
from fringed.config.defaults import PIPELINES
from fringed.config.schema import DeviceConfig
from fringed.devices.building import BUILT_IN, DriverContext, built_in
from fringed.devices.camera.base import MachineClock
from fringed.errors import EXIT_OK, EXIT_USAGE, ConfigurationError, FringedError, Problem
from fringed.loading import Catalogue, load_plugins
from fringed.messages import PluginInfo


def check_file(path: Path, plugins: bool = True, as_json: bool = False) -> int:
    """Print every problem and return the exit code; raises ConfigurationError where it cannot be read at all."""
    config, problems = examined(merged(PIPELINES, read_toml(path)))
    problems += _calibration_problems(config) + _board_problems(config)
    if plugins:
        problems += plugin_problems(config)
    if as_json:
        found = {"file": str(path), "good": not problems, "problems": problems}
        click.echo(msgspec.json.format(msgspec.json.encode(found)).decode())
    elif not problems:
        click.echo(f"{path}: good")
    else:
        click.echo(f"{path}: {len(problems)} problem{'s' * (len(problems) > 1)}", err=True)
        for problem in problems:
            click.echo(f"  {problem}", err=True)
    return EXIT_USAGE if problems else EXIT_OK


def _calibration_problems(config: StationConfig) -> list[Problem]:
    """Return why the file of the calibration cannot be used; "simulated" is told with the devices."""
    from fringed.assembly.loading import load_calibration

    if config.calibration == "simulated":
        return []
    try:
        load_calibration(config, None)
    except ConfigurationError as error:
        return list(error.problems)
    return []


def _board_problems(config: StationConfig) -> list[Problem]:
    from fringed.boards import board_of

    try:
        board_of(config.board)
    except ConfigurationError as error:
        return list(error.problems)
    return []


def plugin_problems(config: StationConfig) -> list[Problem]:
    """Return what is wrong with the plug-ins that pipelines, presets and devices name, and with their parameters."""
    folders = [Path(folder).expanduser() for folder in config.workers.plugin_folders]
    catalogue = load_plugins(folders)
    problems = _broken(catalogue, folders)
    for name, pipeline in config.pipelines.items():
        where = f"pipelines.{name}"
        _check(catalogue, "encoder", pipeline.encoder, (f"{where}.encoder", f"{where}.encoder_params"),
               pipeline.encoder_params, problems)  # fmt: skip
        for index, stage in enumerate(pipeline.stages):
            at = f"{where}.stages[{index}]"
            _check(
                catalogue, "processor", stage.processor, (f"{at}.processor", f"{at}.params"), stage.params, problems
            )  # fmt: skip
    for name, preset in config.presets.items():
        chosen = config.pipelines.get(preset.pipeline)
        if chosen is None:  # said already, or left out for what is wrong in it
            continue
        where = f"presets.{name}"
        _check(catalogue, "encoder", chosen.encoder, ("", f"{where}.encoder_params"),
               merged(chosen.encoder_params, preset.encoder_params), problems)  # fmt: skip
        stages = {stage.name or stage.processor: stage for stage in chosen.stages}
        for own, params in preset.stages.items():
            if own not in stages:
                problems.append(Problem(f"{where}.stages.{own}", "this stage", f"one of {', '.join(stages)}"))
                continue
            both = merged(stages[own].params, params)
            _check(catalogue, "processor", stages[own].processor, ("", f"{where}.stages.{own}"), both, problems)
    problems += _scene_problems(config, catalogue)
    problems += _device_problems("camera", config.camera, catalogue)
    problems += _device_problems("projector", config.projector, catalogue)
    return problems


def _device_problems(kind: str, device: DeviceConfig, catalogue: Catalogue) -> list[Problem]:
    """Return what is wrong with a device's driver and, where it is a real one's, its options."""
    provided = catalogue.provided.get(kind, {})
    ours = built_in(kind, device.driver)
    driver: Any = ours or provided.get(device.driver)
    if driver is None:
        if device.driver in ("none", "sim", "replay"):
            return []
        there = ", ".join(["none", "sim", "replay", *BUILT_IN[kind], *sorted(provided)])
        return [Problem(f"{kind}.driver", repr(device.driver), f"one of {there}")]
    try:
        options = validate(device.options, driver.Options, f"{kind}.options")
        if ours is not None:  # built as the daemon builds it, and not opened
            ours.create(options, DriverContext("check", MachineClock()))
    except ConfigurationError as error:
        return list(error.problems)
    except FringedError as error:
        return [Problem(f"{kind}.options", repr(dict(device.options))[:80], error.message)]
    return []


def _scene_problems(config: StationConfig, catalogue: Catalogue) -> list[Problem]:
    from fringed.simulation.shapes import OBJECTS, shape_maker

    scene, problems = config.simulation.scene, list[Problem]()
    path = "simulation.scene"
    if scene.object in catalogue.provided.get("scene", {}):
        _check(catalogue, "scene", scene.object, ("", f"{path}.options"), scene.options, problems)
    elif scene.object not in OBJECTS:
        there = ", ".join([*OBJECTS, *sorted(catalogue.provided.get("scene", {}))])
        problems.append(Problem(f"{path}.object", repr(scene.object), f"one of {there}"))
    else:
        try:
            shape_maker(scene)
        except ConfigurationError as error:
            problems += error.problems
        except FringedError as error:
            problems.append(Problem(f"{path}.options", repr(dict(scene.options))[:80], error.message))
    return problems


def _broken(catalogue: Catalogue, folders: Sequence[Path]) -> list[Problem]:
    """Return the plug-ins of the configured folders that do not load."""
    return [
        Problem("workers.plugin_folders", f"{info.distribution or info.name!r}", f"plug-ins that load ({_last(info)})")
        for info in catalogue.plugins
        if info.error and (Path(info.distribution).parent in folders or Path(info.name) in folders)
    ]


def _last(info: PluginInfo) -> str:
    return info.error.splitlines()[-1]


def _check(
    catalogue: Catalogue, kind: str, plugin: str, paths: tuple[str, str], params: object, problems: list[Problem]
) -> None:
    """Add what is wrong; an empty first path means that the plug-in's name is somebody else's to check."""
    known = catalogue.provided.get(kind, {})
    if plugin not in known:
        if paths[0]:
            problems.append(Problem(paths[0], repr(plugin), f"one of {', '.join(sorted(known)) or 'none'}"))
        return
    try:
        validate(params, known[plugin].Params, paths[1])  # type: ignore[arg-type]
    except ConfigurationError as error:
        problems += error.problems
