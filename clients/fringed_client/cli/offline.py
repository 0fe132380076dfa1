"""`fringe process`, `simulate` and `register`: work that needs no running station."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs, staged, triple
from fringed_client.cli.records import _CONFIG, ID, a_file

if TYPE_CHECKING:
    from fringed.data import FrameSet
    from fringed_client.results import ScanResult
    from fringed_client.station import Station

_FOLDER = click.Path(file_okay=False, path_type=Path)


@click.command("process")
@click.argument("sources", nargs=-1, required=True, metavar="FOLDER|[ROLE=]ID...")
@click.option("--pipeline", help="The station's pipeline; chosen by the sets when left out.")
@click.option("--param", "params", multiple=True, callback=staged, metavar="STAGE.KEY=VALUE", help="Of a stage.")
@click.option("--calibration", metavar="ID|FILE", help="Other than the capture's own or the station's.")
@click.option("--output", "-o", "folder", type=_FOLDER, help="Write what was made.")
@click.option("--timeout", default=300.0, show_default=True, type=click.FloatRange(min=1), help="Seconds.")
@_CONFIG
@common
def process_command(
    sources: tuple[str, ...], folder: Path | None, config: Path | None, options: Options, timeout: float, **wish: Any
) -> int:
    """Run a pipeline on recordings, or on a folder of images that a capture.toml describes.

    Ids are given with their roles where a pipeline needs several: reference=ID object=ID.
    Ends with code 5 where a capture folder keeps less than 0.1 % of its pixels; what there is, is written.
    """
    from fringed.errors import EXIT_OK, EXIT_QUALITY
    from fringed_client.cli.scanning import report
    from fringed_client.private import any_station
    from fringed_client.quality import gate

    inputs, plan = _inputs(sources, wish["calibration"])
    with any_station(options.station, output.say, config) as station:
        asked = _plan(station, inputs, plan, wish["pipeline"])
        with output.steps() as steps:
            show = steps.scan("process")
            params = wish["params"] or None
            result = station.process(inputs, **asked, params=params, on_progress=show, timeout_s=timeout)
        quality = report(station, result, folder, options)
    if plan is None or gate(quality):
        return EXIT_OK
    output.say("hardly any pixel is left: check capture.toml (order, periods, steps, shifts) and the light")
    return EXIT_QUALITY


def _inputs(sources: tuple[str, ...], calibration: str | None) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Return the job's inputs, and how a capture folder wants to be processed."""
    from fringed.errors import UsageError
    from fringed_client.calibration_file import load_calibration
    from fringed_client.capture import DESCRIPTION
    from fringed_client.capture_images import load_capture
    from fringed_client.capture_plan import pipeline_of

    inputs: dict[str, Any] = {}
    plan = None
    if calibration:
        known = ID.match(calibration)
        inputs["calibration"] = calibration if known else load_calibration(_there(Path(calibration), "--calibration"))
    for source in sources:
        if Path(source).is_dir():
            described, sets = load_capture(Path(source))
            own = described.capture.calibration
            if own and not calibration:
                named_by = f"capture.calibration in {Path(source) / DESCRIPTION}"
                inputs["calibration"] = load_calibration(_there(Path(source) / own, named_by))
            plan = pipeline_of(described, "calibration" in inputs)
            inputs |= sets
            continue
        role, sign, item_id = source.rpartition("=")
        if not ID.match(item_id):
            raise UsageError(f"{source!r} is neither a folder nor [ROLE=]ID of a recording; `fringe list` shows ids")
        inputs[role if sign else "object"] = item_id
    return inputs, plan


def _there(path: Path, named_by: str) -> Path:
    from fringed.errors import UsageError

    if not path.is_file():
        raise UsageError(f"{named_by}: there is no file {path}; name a calibration .json or .h5, or leave it out")
    return path


def _plan(
    station: Station, inputs: Mapping[str, Any], plan: dict[str, Any] | None, pipeline: str | None
) -> dict[str, Any]:
    """Return which pipeline or stages to run: as asked, as the capture wants, or as the sets' family needs."""
    if plan is not None:
        chosen = {"pipeline": pipeline} if pipeline else plan
        _check_roles(station, inputs, chosen.get("pipeline"))
        return chosen
    if pipeline:
        return {"pipeline": pipeline}
    if "reference" in inputs:
        return {"pipeline": "thesis"}
    return {}


def _check_roles(station: Station, inputs: Mapping[str, Any], pipeline: str | None) -> None:
    """Refuse a capture folder that lacks a set of the pipeline before anything is queued."""
    from fringed.errors import UsageError

    roles = station.config()["pipelines"].get(pipeline, {}).get("roles", []) if pipeline else []
    missing = [role for role in roles if role not in inputs]
    if missing:
        given = ", ".join(name for name in inputs if name != "calibration") or "none"
        raise UsageError(
            f"the pipeline {pipeline!r} needs the sets {', '.join(roles)}; the capture folder has {given}: "
            f"add {', '.join(missing)} to [sets], or choose another --pipeline"
        )


@click.command("simulate")
@click.argument("scene", default="face")
@click.option("--output", "-o", "folder", type=_FOLDER, required=True, help="The capture folder to write.")
@click.option("--pipeline", default="hierarchical", show_default=True, help="Whose patterns are projected.")
@click.option("--option", "scene_options", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Of the scene.")
@click.option("--rotation", callback=triple, metavar="X,Y,Z", help="Degrees about x, then y, then z.")
@click.option("--encoder", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Of the patterns.")
@click.option("--camera", metavar="WIDTHxHEIGHT", default="1392x1040", show_default=True)
@click.option("--projector", metavar="WIDTHxHEIGHT", default="1024x768", show_default=True)
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0))
@click.option("--no-noise", is_flag=True, help="Leave out the sensor's noise.")
@common
def simulate_command(folder: Path, options: Options, **wish: Any) -> None:
    """Write a capture folder of a simulated SCENE with its truth and its exact calibration.

    SCENE is plane, sphere, steps, freeform, face, hand, mesh (with --option path=FILE), or a plug-in's.
    """
    from fringed_client.private import PrivateStation

    output.say("simulating with a private station")
    with PrivateStation(_rig(wish)) as station, output.steps() as steps:
        result = station.scan(
            wish["pipeline"], truth=True, encoder_params=wish["encoder"] or None, on_progress=steps.scan("simulate")
        )
        files = _write(station, result, folder)
    if options.json:
        output.emit({"folder": str(folder), "files": [str(path) for path in files], "simulated": True})
    else:
        output.facts({"written  SIMULATED": "\n".join(str(path) for path in files)})


def _rig(wish: Mapping[str, Any]) -> dict[str, Any]:
    from fringed.config import merged
    from fringed.errors import UsageError
    from fringed_client.private import SIMULATED_RIG

    mesh = wish["scene_options"].get("path")
    if wish["scene"] == "mesh" and mesh and not Path(str(mesh)).is_file():
        raise UsageError(f"--option path={mesh}: there is no such file; name a mesh (.stl, .ply or .obj)")

    scene = {"object": wish["scene"], "options": wish["scene_options"]}
    if wish["rotation"]:
        scene["rotation_deg"] = list(wish["rotation"])
    simulation = {
        "seed": wish["seed"], "noise": not wish["no_noise"], "scene": scene,
        "sensor": _size(wish["camera"], "--camera"), "projector": _size(wish["projector"], "--projector"),
    }  # fmt: skip
    return merged(SIMULATED_RIG, {"simulation": simulation})


def _size(text: str, name: str) -> dict[str, int]:
    width, _, height = text.lower().partition("x")
    if not width.isdigit() or not height.isdigit():
        raise click.BadParameter(f"{text!r}; expected WIDTHxHEIGHT in pixels, such as 1392x1040", param_hint=name)
    return {"width_px": int(width), "height_px": int(height)}


def _write(station: Station, result: ScanResult, folder: Path) -> list[Path]:
    from fringed_client.calibration_file import calibration_of, save_calibration
    from fringed_client.capture_write import write_capture, write_truth
    from fringed_client.files import make_folder

    make_folder(folder)
    sets: dict[str, FrameSet] = dict(result.frame_sets)
    calibration = save_calibration(calibration_of(station), folder / "calibration.json")
    files = [write_capture(folder, sets, calibration.name), calibration]
    for product in result.state.products:
        if product["kind"] == "Truth":
            role = product.get("role") or "object"
            name = "truth.npz" if role == "object" else f"truth-{role}.npz"
            files.append(write_truth(folder / name, station.get(product["id"])))
    return files


def _surface(path: Path) -> Any:
    """Return a recording's content, or the points or triangles of another file."""
    from fringed.surface_files.reading import product_of_file
    from fringed_client.calibration_file import load_recording

    return load_recording(path) if path.suffix.lower() in {".h5", ".hdf5"} else product_of_file(path)


@click.command("register")
@click.argument("views", nargs=-1, required=True, metavar="ID...")
@click.option("--merge/--pair", default=True, show_default=True, help="One model of all, or one pair's transform.")
@click.option("--processor", help="Another variant than `merge` or `register`.")
@click.option("--param", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Of the processor.")
@click.option("--output", "-o", "folder", type=_FOLDER, help="Write what was made.")
@click.option("--timeout", default=300.0, show_default=True, type=click.FloatRange(min=1), help="Seconds.")
@_CONFIG
@common
def register_command(
    views: tuple[str, ...], folder: Path | None, config: Path | None, options: Options, timeout: float, **wish: Any
) -> int:
    """Bring range images together; the first one is the reference.

    Takes ids of range images, or recordings (.h5) of them. With --pair also models, and files of points or triangles:
    .ply, .stl, .obj, .xyz, in any unit (figures are then in that unit, whatever they are called). Ends with code 5
    where a pair did not converge.
    """
    from fringed.errors import EXIT_OK, EXIT_QUALITY, UsageError
    from fringed_client.cli.scanning import report
    from fringed_client.private import any_station

    given = [view if ID.match(view) else _surface(a_file(view)) for view in views]
    bare = [view for view, one in zip(views, given, strict=True) if type(one).__name__ in {"Model", "Mesh"}]
    if wish["merge"] and bare:
        raise UsageError(f"{', '.join(bare)}: points without a grid are not merged; register two of them with --pair")
    with any_station(options.station, output.say, config) as station:
        with output.steps() as steps:
            result = station.register(
                given,
                wish["processor"],
                wish["param"],
                merge=wish["merge"],
                on_progress=steps.scan("register"),
                timeout_s=timeout,
            )
        quality = report(station, result, folder, options)
    return EXIT_QUALITY if any(row.get("converged") is False for row in quality) else EXIT_OK
