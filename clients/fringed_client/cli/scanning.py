"""`fringe scan` and `fringe latency`: what needs the rig. No private station is ever started for it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs, staged

if TYPE_CHECKING:
    from fringed_client.results import ScanResult
    from fringed_client.station import Station


@click.command("scan")
@click.option("--pipeline", help="What to project and how to process; the station's default one when left out.")
@click.option("--preset", help="A named pipeline with other parameters, such as plaster.")
@click.option("--roles", help="Sets to take, such as reference,object; all of the pipeline's by default.")
@click.option(
    "--use", "used", multiple=True, callback=pairs, metavar="ROLE=ID", help="A recorded set instead of taking it."
)
@click.option("--param", "stages", multiple=True, callback=staged, metavar="STAGE.KEY=VALUE", help="Of a stage.")
@click.option("--encoder", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Of the patterns.")
@click.option(
    "--camera",
    multiple=True,
    callback=pairs,
    metavar="[ROLE.]KEY=VALUE",
    help="Such as exposure_us=8333, channel=red; of one set: object-short.exposure_us=1000.",
)
@click.option("--truth", is_flag=True, help="Record what the simulated rig knows as well.")
@click.option(
    "--output", "-o", "folder", type=click.Path(file_okay=False, path_type=Path), help="Write what was measured."
)
@click.option("--yes", "-y", is_flag=True, help="Do not ask before taking the sets of several roles.")
@click.option("--timeout", default=300.0, show_default=True, type=click.FloatRange(min=1), help="Seconds.")
@common
def scan_command(folder: Path | None, yes: bool, timeout: float, options: Options, **wish: Any) -> None:
    """Take sets, decode them, and get a range image.

    Ctrl-C cancels the scan on the station.
    """
    from fringed_client.station import Station

    with Station(options.station) as station:
        asked = _asked(wish)
        if not station.hello.get("simulated") and not yes and not options.json:
            _prompt(station, asked)
        with output.steps() as steps:
            result = station.scan(**asked, on_progress=steps.scan("scan"), timeout_s=timeout)
        report(station, result, folder, options, taken=True)


def _asked(wish: dict[str, Any]) -> dict[str, Any]:
    roles, camera, by_role = wish["roles"], dict[str, Any](), dict[str, dict[str, Any]]()
    for key, value in wish["camera"].items():
        role, dot, name = key.rpartition(".")
        (by_role.setdefault(role, {}) if dot else camera)[name] = value
    return {
        "pipeline": wish["pipeline"], "preset": wish["preset"],
        "roles": [role.strip() for role in roles.split(",") if role.strip()] if roles else None,
        "frame_sets": wish["used"] or None, "stages": wish["stages"] or None, "encoder_params": wish["encoder"] or None,
        "camera": camera or None, "role_camera": by_role or None, "truth": wish["truth"] or None,
    }  # fmt: skip


def _prompt(station: Station, asked: dict[str, Any]) -> None:
    """Have a person change what stands before the rig where a pipeline takes sets of several roles."""
    config = station.config()
    preset = config["presets"].get(asked["preset"] or "", {})
    name = asked["pipeline"] or preset.get("pipeline") or config["default_pipeline"]
    roles = asked["roles"] or config["pipelines"].get(name, {}).get("roles", [])
    settings = config["pipelines"].get(name, {}).get("role_camera", {})
    taken = _by_sight([role for role in roles if role not in (asked["frame_sets"] or {})], settings)
    for same in taken[:-1]:
        click.confirm(
            f"Set {same[0]!r} is taken first: does the rig see the {same[0]}?", default=True, abort=True, err=True
        )
        acquired = station.scan(**{**asked, "roles": same}, process=False)
        asked["frame_sets"] = {**(asked["frame_sets"] or {}), **{r: acquired.state.frame_sets[r] for r in same}}
    if len(taken) > 1:
        click.confirm(f"Now put the {taken[-1][0]} before the rig. Ready?", default=True, abort=True, err=True)
        asked["roles"] = taken[-1]


def _by_sight(roles: list[str], settings: Mapping[str, Any]) -> list[list[str]]:
    """Put roles together that see the same thing: `object-long` is `object` with camera settings of its own."""
    groups: list[list[str]] = []
    for role in roles:
        sight = role.partition("-")[0]
        for group in groups:
            if group[0].partition("-")[0] == sight and (role in settings or group[0] in settings):
                group.append(role)
                break
        else:
            groups.append([role])
    return groups


def report(
    station: Station, result: ScanResult, folder: Path | None, options: Options, taken: bool = False
) -> list[dict[str, Any]]:
    """Tell what a scan or job has brought and how good it is, and write it where a folder is given.

    Returns the figures of `quality.quality_of`. With `taken` the sets' own checks are told too.
    """
    from fringed_client.quality import quality_of, warnings_of
    from fringed_client.saving import save_result

    files = save_result(station, result, folder) if folder is not None else []
    quality = quality_of(result)
    warnings = [*result.state.warnings, *warnings_of(quality, result.frame_sets if taken else {})]
    for text in warnings:
        output.say(f"warning: {text}")
    if options.json:
        output.emit(
            {"scan": result.state, "quality": quality, "warnings": warnings, "files": [str(path) for path in files]}
        )
    else:
        output.facts(_rows(station, result, quality, files))
    return quality


def _rows(station: Station, result: ScanResult, quality: list[dict[str, Any]], files: list[Path]) -> dict[str, Any]:
    from fringed_client.quality import lines

    state = result.state
    told = {row["id"]: lines(row) for row in quality}
    simulated = station.hello.get("simulated") or any(row["simulated"] for row in station.list(scan=state.id))
    mark = "  SIMULATED" if simulated else ""
    rows: dict[str, Any] = {state.pipeline or "job": f"{state.id} {state.state}{mark}"}
    rows |= {f"set {role}": set_id for role, set_id in state.frame_sets.items()}
    for product in state.products:
        name = str(product.get("stage") or product.get("role") or product["kind"])
        rows[name] = "\n".join((f"{product['kind']} {product['id']}", *told.get(product["id"], ())))
    if state.retakes:
        rows["retaken"] = f"{state.retakes} sets"
    rows["seconds"] = ", ".join(f"{name} {seconds:.3f}" for name, seconds in state.timings_s.items())
    if files:
        rows["files"] = "\n".join(str(path) for path in files)
    return rows


@click.command("latency")
@common
def latency_command(options: Options) -> None:
    """Measure the display-to-camera delay; the station uses it from then on."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        state = station.measure_latency().state
    if options.json:
        output.emit(state)
    else:
        latency, uncertainty, settle = (
            state.timings_s.get(name, float("nan")) * 1000 for name in ("latency", "uncertainty", "settle")
        )
        output.facts({"latency": f"{latency:.1f} ms, within {uncertainty:.1f} ms; settled {settle:.1f} ms later"})
