"""`fringe calibration`: what calibrations there are, which one is in force, how they differ, and putting one in force.

Owns what is told; the station decides what fits, and remembers.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs

if TYPE_CHECKING:
    from fringed.data import Calibration
    from fringed_client.station import Station

_IN_FORCE = "in force"
_FOLDER = click.Path(file_okay=False, path_type=Path)


@click.group("calibration")
def calibration_command() -> None:
    """List, show, compare and choose calibrations; `fringe calibrate` makes them.

    CALIBRATION is an id, a file (.h5 or .json), or `current` for the one in force.
    """


@calibration_command.command("list")
@click.option("--limit", default=20, show_default=True, type=click.IntRange(1, 100_000))
@common
def _list(limit: int, options: Options) -> None:
    """List recorded calibrations, newest first, and which one is in force."""
    from fringed.data import Calibration
    from fringed_client.station import Station

    with Station(options.station) as station:
        known = station.request("calibration")
        rows = station.list(kind="Calibration", limit=limit)
        found = [(row, item) for row in rows if isinstance(item := station.get(row["id"]), Calibration)]
    told = [_row(row, item, known) for row, item in found]
    if options.json:
        output.emit({**known, "calibrations": told})
        return
    columns = ("id", "made", "rig", "camera px", "projector px", "trueness um", "views", "source", "")
    output.table(columns, [tuple(one.values()) for one in told])
    output.say(f"in force: {known['in_force']['origin']}")
    if known["in_force"]["problem"]:
        output.say(f"warning: {known['in_force']['problem']}")


def _row(row: Mapping[str, Any], item: Calibration, known: Mapping[str, Any]) -> dict[str, Any]:
    figures = item.residuals
    adopted = known["adopted"]
    state = _IN_FORCE if row["id"] == known["in_force"]["id"] else "adopted before" if row["id"] in adopted else ""

    def told(name: str, form: str, scale: float = 1.0) -> str:
        return format(figures[name] * scale, form) if name in figures else "–"

    return {
        "id": row["id"], "made": str(row["created"])[:16].replace("T", " "), "rig": item.rig,
        "camera_rms_px": told("camera_rms_px", ".3f"), "projector_rms_px": told("projector_rms_px", ".3f"),
        "trueness_rms_um": told("trueness_rms_mm", ".0f", 1000.0),
        "views": str(sum(not fit.note for fit in item.views) or "–"),
        "source": item.source, "state": state,
    }  # fmt: skip


@calibration_command.command("show")
@click.argument("which", default="current", metavar="[CALIBRATION]")
@click.option("--output", "-o", "folder", type=_FOLDER, help="Write its report and files.")
@common
def _show(which: str, folder: Path | None, options: Options) -> None:
    """Show what a calibration is worth; without one, that in force."""
    from fringed_client.calibration.figures import accuracy_rows
    from fringed_client.calibration.report import write_report
    from fringed_client.station import Station

    with Station(options.station) as station:
        known = station.request("calibration")
        found = _calibration(station, which)
        files = write_report(station, found, _views_of(station, found), folder) if folder else []
    mark = known["in_force"]["hash"] == found.hash
    if options.json:
        output.emit({
            "id": found.id, "hash": found.hash, "rig": found.rig, "source": found.source, "in_force": mark,
            "origin": known["in_force"]["origin"] if mark else "", "residuals": dict(found.residuals),
            "notes": found.notes, "temperature_c": found.temperature_c, "files": [str(file) for file in files],
            "history": known["history"],
        })  # fmt: skip
        return
    rows = accuracy_rows(found)
    rows["state"] = f"in force: {known['in_force']['origin']}" if mark else "not in force"
    if files:
        rows["files"] = "\n".join(map(str, files))
    output.facts(rows)


@calibration_command.command("compare")
@click.argument("one", default="current", metavar="[CALIBRATION]")
@click.argument("other", required=False, metavar="[OTHER]")
@common
def _compare(one: str, other: str | None, options: Options) -> None:
    """Tell how far two calibrations put the same points apart: drift, in millimetres and in standard deviations.

    Without OTHER, the one in force before is compared with the one in force.
    """
    import json

    from fringed_client.station import Station

    with Station(options.station) as station, output.steps() as steps:
        if other is None:
            one, other = _one_before(station, one)
        a, b = _calibration(station, one), _calibration(station, other)
        stages = [{"name": "comparison", "plugin": "compare-calibrations"}]
        result = station.process({"a": a, "b": b}, stages=stages, on_progress=steps.scan("compare"))
        found = json.loads(result.last("Artifact").content.tobytes())
    if options.json:
        output.emit({"a": a.id or a.hash, "b": b.id or b.hash, **found})
        return
    output.facts({
        "a": f"{a.id or a.hash} ({a.source})", "b": f"{b.id or b.hash} ({b.source})",
        "points": f"{found['rms_mm'] * 1000:.1f} um RMS apart, {found['max_mm'] * 1000:.1f} um at most, at "
        f"{min(found['depths_mm']):.0f} to {max(found['depths_mm']):.0f} mm",
        "verdict": f"{found['verdict']}: up to {found['max_drift_mm'] * 1000:.0f} um RMS is no drift",
    })  # fmt: skip
    output.table(
        ("parameter", "a", "b", "difference", "in deviations"), [_difference(row) for row in found["parameters"]]
    )


def _difference(row: Mapping[str, Any]) -> tuple[str, ...]:
    own = "–" if row["deviations"] is None else f"{row['deviations']:+.1f}"
    return row["name"], f"{row['a']:.7g}", f"{row['b']:.7g}", f"{row['difference']:+.3g}", own


def _one_before(station: Station, one: str) -> tuple[str, str]:
    """Return what was in force before `one`, and `one`."""
    from fringed.errors import UsageError

    known = station.request("calibration")
    adopted = known["adopted"]
    if one != "current":
        return "current", one
    if len(adopted) < 2:
        raise UsageError("no other calibration was in force before; name two, `fringe calibration list` shows them")
    return adopted[1], adopted[0]


@calibration_command.command("correct")
@click.option("--pipeline", default="board", show_default=True, help="What is projected on the board.")
@click.option("--board", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Of the board, over the station's.")
@click.option("--camera", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Such as exposure_us=10000.")
@click.option("--view", "views", multiple=True, metavar="ID", help="Recorded board views instead of taking one.")
@click.option("--use", is_flag=True, help="Put the corrected calibration in force at once.")
@common
def _correct(options: Options, views: tuple[str, ...], use: bool, **wish: Any) -> None:
    """Put the calibration in force right after the projector was nudged, by one pose of the board before the rig.

    The lenses are taken as they were; a pose that contradicts them is refused: then calibrate anew.
    """
    from fringed_client.calibration.session import Session, Wish
    from fringed_client.station import Station

    with Station(options.station) as station, output.steps() as steps:
        session = Session(station, Wish(**wish))
        seen = session.named(views) if views else [session.take("infield", steps.scan("infield"))]
        found, warnings = session.corrected(seen, _calibration(station, "current"), steps.scan("correction"))
        answer = station.request("calibration.use", timeout_s=60.0, id=found.id) if use else None
    for text in warnings:
        output.say(f"warning: {text}")
    if options.json:
        moved = {key: value for key, value in found.residuals.items() if key.startswith("infield_")}
        output.emit({"calibration": found.id, "hash": found.hash, **moved, **(answer or {})})
        return
    output.facts({"calibration": found.id, "found": found.notes[-1], "in force": "yes" if use else "no"})
    if not use:
        output.say(f"to use it: fringe calibration use {found.id}")


@calibration_command.command("use")
@click.argument("which", metavar="CALIBRATION")
@common
def _use(which: str, options: Options) -> None:
    """Put a calibration in force, for good: it survives restarts. Of another rig or size it is refused."""
    from fringed_client.cli.records import ID
    from fringed_client.station import Station

    with Station(options.station) as station:
        item = which if ID.match(which) else station.add(_calibration(station, which))
        answer = station.request("calibration.use", timeout_s=60.0, id=item)
    _tell_in_force(answer, options)


@calibration_command.command("revert")
@click.option("--all", "everything", is_flag=True, help="To what the configuration says by itself.")
@common
def _revert(everything: bool, options: Options) -> None:
    """Go back to the calibration that was in force before."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        answer = station.request("calibration.revert", timeout_s=60.0, all=everything)
    _tell_in_force(answer, options)


def _tell_in_force(answer: Mapping[str, Any], options: Options) -> None:
    if options.json:
        output.emit(answer)
        return
    told = answer["in_force"]
    output.facts({"in force": told["origin"], "hash": told["hash"] or "none"})


def _calibration(station: Station, which: str) -> Calibration:
    """Return the calibration in force, a recorded one, or one in a file.

    Raises
    ------
    UsageError
        it is none of these.
    """
    from fringed.data import Calibration
    from fringed.errors import UsageError
    from fringed_client.calibration_file import calibration_of, load_calibration
    from fringed_client.cli.records import ID

    if which == "current":
        return calibration_of(station)
    if not ID.match(which):
        if not Path(which).is_file():
            raise UsageError(f"{which} is no id, no file and not `current`; `fringe calibration list` shows ids")
        return load_calibration(Path(which))
    found = station.get(which)
    if not isinstance(found, Calibration):
        raise UsageError(f"{which} is a {type(found).__name__}; `fringe calibration list` shows calibrations")
    return found


def _views_of(station: Station, found: Calibration) -> list[Any]:
    """Return the board views that a calibration was made of, as far as they are still recorded."""
    from fringed.data import BoardView
    from fringed.errors import FringedError

    views = []
    for fit in found.views:
        try:
            view = station.get(fit.view)
        except FringedError:
            continue
        views += [view] if isinstance(view, BoardView) else []
    return views
