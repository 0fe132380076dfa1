"""`fringe verify`: measure a known artefact, tell whether the calibration holds, and what has changed since.

Owns what is asked and told; the measurement is a processor of the station (`verify-plane`, `-sphere`, `-step`).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs

if TYPE_CHECKING:
    from fringed.data import Verification
    from fringed_client.station import Station

F = TypeVar("F", bound=Callable[..., Any])
_FOLDER = click.Path(file_okay=False, path_type=Path)
_LENGTH = click.FloatRange(min=0, min_open=True)


@click.group("verify")
def verify_command() -> None:
    """Measure a known artefact, and tell whether the calibration holds there.

    Figures are those of VDI/VDE 2634 part 2. Put the artefact before the rig, matt and well inside the picture; each
    command scans it. Green holds, yellow is at the limit, red ends with code 5.
    """


def _measuring(function: F) -> F:
    """Add the options that every artefact has."""
    options = (
        click.option("--range", "source", metavar="ID|FILE.h5", help="A recorded range image, instead of a scan."),
        click.option("--average", default=1, show_default=True, type=click.IntRange(1, 200), help="Scans to average."),
        click.option("--pipeline", help="What to project; the station's default one when left out."),
        click.option("--camera", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Such as exposure_us=10000."),
        click.option("--limit", "limits", multiple=True, callback=pairs, metavar="FIGURE=MM",
                     help="Such as probing_error_size=0.02."),
        click.option("--param", "more", multiple=True, callback=pairs, metavar="KEY=VALUE",
                     help="Of the measurement, such as smooth_px=5."),
        click.option("--temperature", type=float, metavar="CELSIUS", help="Of the room."),
        click.option("--output", "-o", "folder", type=_FOLDER, help="Write a report with its picture."),
        click.option("--timeout", default=300.0, show_default=True, type=click.FloatRange(min=1),
                     help="Seconds for each scan."),
        common,
    )  # fmt: skip
    for option in reversed(options):
        function = option(function)
    return function


@verify_command.command("plane")
@_measuring
def _plane(options: Options, **wish: Any) -> int:
    """Measure a flat plate: the flatness measurement error."""
    return _verify("verify-plane", {}, options, wish)


@verify_command.command("sphere")
@click.option("--radius", type=_LENGTH, metavar="MM", help="Calibrated; without it only the form is judged.")
@_measuring
def _sphere(radius: float | None, options: Options, **wish: Any) -> int:
    """Measure one sphere: the probing errors of form and size."""
    return _verify("verify-sphere", {"radius_mm": radius or 0.0}, options, wish)


@verify_command.command("ball-bar")
@click.option("--radius", type=_LENGTH, metavar="MM", help="Calibrated, of both spheres.")
@click.option("--spacing", required=True, type=_LENGTH, metavar="MM", help="Calibrated, between the centres.")
@_measuring
def _ball_bar(radius: float | None, spacing: float, options: Options, **wish: Any) -> int:
    """Measure two spheres at a known distance: the sphere-spacing error, and the probing errors of both."""
    return _verify("verify-sphere", {"radius_mm": radius or 0.0, "spacing_mm": spacing}, options, wish)


@verify_command.command("step")
@click.option("--heights", required=True, metavar="MM,MM...", help="Of the planes, above the lowest one.")
@_measuring
def _step(heights: str, options: Options, **wish: Any) -> int:
    """Measure parallel planes at known heights: the error of each."""
    try:
        numbers = [float(part) for part in heights.split(",")]
    except ValueError:
        raise click.BadParameter(f"{heights!r}; expected millimetres, such as 10,20", param_hint="--heights") from None
    return _verify("verify-step", {"heights_mm": numbers}, options, wish)


def _verify(processor: str, nominal: dict[str, Any], options: Options, wish: dict[str, Any]) -> int:
    """Scan or take what is recorded, measure, compare with the last time, tell."""
    from fringed.errors import EXIT_OK, EXIT_QUALITY
    from fringed_client.private import any_station
    from fringed_client.station import Station
    from fringed_client.verification import drift, earlier

    params = {**nominal, "limits": wish["limits"], **wish["more"]}
    params |= {"temperature_c": wish["temperature"]} if wish["temperature"] is not None else {}
    _check(wish)
    station_of = any_station(options.station, output.say) if wish["source"] else Station(options.station)
    with station_of as station, output.steps() as steps:
        image = _recorded(wish["source"]) if wish["source"] else _scanned(station, wish, steps)
        stages = [{"name": "verification", "plugin": processor, "params": params}]
        result = station.process({"range": image}, stages=stages, on_progress=steps.scan("verify"),
                                 timeout_s=wish["timeout"])  # fmt: skip
        found: Verification = result.last("Verification")
        before = earlier(station, found)[:1]
        changes = drift(found, before[0]) if before else []
        files = _write(station, found, changes, wish["folder"])
    _tell(found, changes, files, options)
    return EXIT_QUALITY if found.verdict == "red" else EXIT_OK


def _check(wish: dict[str, Any]) -> None:
    given = [name for name, key in (("--pipeline", "pipeline"), ("--camera", "camera")) if wish[key]]
    given += ["--average"] if wish["average"] > 1 else []
    if wish["source"] and given:
        raise click.UsageError(f"{' and '.join(given)} are of scans, and --range takes what is recorded; leave one out")


def _recorded(source: str) -> Any:
    """Return the id, or the range image of a file.

    Raises
    ------
    UsageError
        it is neither, or something else.
    """
    from fringed.data import RangeImage
    from fringed.errors import UsageError
    from fringed_client.calibration_file import load_recording
    from fringed_client.cli.records import ID, a_file

    if ID.match(source):
        return source
    found = load_recording(a_file(source))
    if not isinstance(found, RangeImage):
        raise UsageError(f"{source} holds a {type(found).__name__}; expected a RangeImage")
    return found


def _scanned(station: Station, wish: dict[str, Any], steps: output.Steps) -> str:
    """Return the id of the range image of what stands before the rig, the mean of several where asked for."""
    from fringed_client.protocol.flows import last_product

    taken = []
    for number in range(1, wish["average"] + 1):
        name = f"scan {number}" if wish["average"] > 1 else "scan"
        result = station.scan(
            wish["pipeline"], camera=wish["camera"] or None, on_progress=steps.scan(name), timeout_s=wish["timeout"]
        )
        taken.append(last_product(result.state, "RangeImage"))
    if len(taken) == 1:
        return taken[0]
    stages = [{"name": "mean", "plugin": "average-range"}]
    mean = station.process({"ranges": taken}, stages=stages, timeout_s=wish["timeout"])
    return last_product(mean.state, "RangeImage")


def _write(station: Station, found: Verification, changes: list[str], folder: Path | None) -> list[Path]:
    if folder is None:
        return []
    from fringed_client.verification_report import write_report

    return write_report(station, found, changes, folder)


def _tell(found: Verification, changes: list[str], files: list[Path], options: Options) -> None:
    from fringed_client.verification import document, summary

    if options.json:
        output.emit({**document(found), "drift": changes, "files": [str(file) for file in files]})
        return
    mark = "  SIMULATED" if found.provenance.simulated else ""
    output.facts({f"verification{mark}": found.id, "verdict": _light(found.verdict), **summary(found)})
    _table(found)
    told = {"drift": "\n".join(changes)} if changes else {}
    output.facts(told | ({"files": "\n".join(str(file) for file in files)} if files else {}))


def _light(verdict: str) -> str:
    from fringed_client.verification import WORDS

    return click.style(f"● {verdict.upper()}: {WORDS[verdict]}", fg=verdict, bold=True)


def _table(found: Verification) -> None:
    from fringed_client.verification import rows

    shown = [(*row[:4], row[4].upper()) for row in rows(found)]
    output.table(("figure", "mm", "std. unc.", "limit", "verdict"), shown)


@verify_command.command("list")
@click.option("--limit", default=20, show_default=True, type=click.IntRange(1, 1000))
@common
def _list(limit: int, options: Options) -> None:
    """List earlier verifications, newest first, with what has changed from one to the next."""
    from fringed_client.private import any_station
    from fringed_client.verification import document, drift, earlier, previous, when, worst

    with any_station(options.station, output.say) as station:
        found = earlier(station, limit=limit)
    since = [drift(one, before) if (before := previous(one, found)) else [] for one in found]
    if options.json:
        output.emit([{**document(one), "drift": lines} for one, lines in zip(found, since, strict=True)])
        return
    if not found:
        output.say("nothing verified yet; begin with `fringe verify sphere --radius MM`")
        return
    rows = [
        (one.id, when(one), one.artefact, one.verdict.upper(), worst(one), one.calibration,
         "SIM" if one.provenance.simulated else "", "drifted" if any("CHANGED" in line for line in lines) else "")
        for one, lines in zip(found, since, strict=True)
    ]  # fmt: skip
    output.table(("id", "date", "artefact", "verdict", "nearest to its limit", "calibration", "origin", "drift"), rows)
