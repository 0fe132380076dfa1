"""`fringe calibrate`: poses of a board from a person, a simulated rig or a folder, to a calibration and its report.

Owns what is asked and told; the order of a session is in `calibration.session`, the ways of taking in `taking`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs

if TYPE_CHECKING:
    from fringed.data import BoardView, Calibration
    from fringed_client.calibration.poses import Pose
    from fringed_client.calibration.session import Session
    from fringed_client.station import Station

_FOLDER = click.Path(file_okay=False, path_type=Path)
_SOURCE = click.Path(exists=True, file_okay=False, path_type=Path)


@click.command("calibrate")
@click.argument("source", required=False, metavar="[FOLDER]", type=_SOURCE)
@click.option("--simulated", is_flag=True, help="Have a simulated rig place the board by itself.")
@click.option("--poses", default=12, show_default=True, type=click.IntRange(5, 200), help="How many to take.")
@click.option("--every", type=click.FloatRange(min=0), metavar="SECONDS", help="Take a pose each time, unasked.")
@click.option("--resume", is_flag=True, help="Go on with the poses of the last session.")
@click.option("--views", multiple=True, metavar="ID", help="Recorded board views to use; nothing is taken then.")
@click.option(
    "--board", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Of the board, such as pitch_mm=12.5, rows=9."
)
@click.option("--pipeline", default="board", show_default=True, help="What is projected at each pose.")
@click.option("--camera", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Such as exposure_us=10000.")
@click.option("--param", "solver", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Of the estimation.")
@click.option("--temperature", type=float, metavar="CELSIUS", help="Of the room; kept in the calibration.")
@click.option(
    "--reference-plane", type=float, metavar="MM", help="Distance of the reference plane, where there is one."
)
@click.option("--tone/--no-tone", default=None, help="Measure the projector's tone curve; default: if none is known.")
@click.option(
    "--output", "-o", "folder", type=_FOLDER, help="Report, pictures and calibration; default: named by date."
)
@click.option("--write", type=_FOLDER, help="With --simulated: write the poses as a capture folder, with their truth.")
@click.option("--use", is_flag=True, help="Put the calibration in force at once.")
@click.option(
    "--timeout", default=300.0, show_default=True, type=click.FloatRange(min=1), help="Seconds for each scan."
)
@common
def calibrate_command(source: Path | None, options: Options, **wish: Any) -> int:
    """Calibrate the rig from poses of a board: held by a person, placed by a simulated rig, or images in a FOLDER.

    Every pose is kept on the station at once: after Ctrl-C, `--resume` goes on. `fringe board` prints a board, and
    docs/calibration.md leads through it all.
    """
    from fringed.errors import EXIT_OK
    from fringed_client.calibration.session import POSES_MIN

    _check(source, wish)
    with ExitStack() as stack:
        work = _begin(stack, source, options, wish)
        try:
            for view in _views(work, source):
                work.add(view)
        except KeyboardInterrupt:
            _interrupted(work)
            raise
        if wish["write"]:
            work.files.append(_write(work, wish["write"]))
        if len(work.good) < POSES_MIN:
            raise _too_few(work)
        found, warnings = _solve(work)
        in_force = work.station.request("calibration.use", timeout_s=60.0, id=found.id) if wish["use"] else None
        _tell(work, found, warnings, in_force)
    return EXIT_OK


def _check(source: Path | None, wish: dict[str, Any]) -> None:
    ways = [name for name, given in (("FOLDER", source), ("--simulated", wish["simulated"]), ("--views", wish["views"]))
            if given]  # fmt: skip
    if len(ways) > 1:
        raise click.UsageError(f"{' and '.join(ways)} are ways to get poses of their own; give one of them")
    if wish["write"] and not wish["simulated"]:
        raise click.UsageError("--write goes with --simulated: it writes the poses that a simulated rig takes")
    if wish["tone"] and (source is not None or wish["views"]):
        raise click.UsageError("--tone projects grey levels, which images and recorded views cannot; leave it out")


@dataclass
class _Work:
    """One command under way."""

    station: Station
    session: Session
    steps: output.Steps
    options: Options
    wish: dict[str, Any]
    folder: Path
    live: bool
    views: list[BoardView] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)

    @property
    def good(self) -> list[BoardView]:
        """The views in which the board was found."""
        return [view for view in self.views if view.found]

    def add(self, view: BoardView) -> None:
        """Keep a view, draw it and tell of it."""
        from fringed_client.calibration.figures import coverage_words, view_words
        from fringed_client.calibration.report import draw_view

        self.views.append(view)
        self.files.append(draw_view(view, self.folder))
        told = f"{view.name}: {view_words(view)}"
        if self.wish["poses"] > len(self.good) and not self.wish["simulated"]:
            told += f" ({coverage_words(self.good)})"
        output.say(told)


def _begin(stack: ExitStack, source: Path | None, options: Options, wish: dict[str, Any]) -> _Work:
    from fringed_client.calibration.session import Session, Wish
    from fringed_client.private import any_station
    from fringed_client.station import Station

    board = dict(wish["board"])
    if source is not None:
        from fringed_client.capture import load_description

        board = {**load_description(source).board, **board}
    live = source is None and not wish["views"]
    station = stack.enter_context(Station(options.station) if live else any_station(options.station, output.say))
    steps = stack.enter_context(output.steps())
    if live:
        stack.enter_context(station.lease("fringe calibrate"))
    solver = {"temperature_c": wish["temperature"], "reference_plane_mm": wish["reference_plane"]}
    solver = {**{key: value for key, value in solver.items() if value is not None}, **wish["solver"]}
    session = Session(station, Wish(board, wish["pipeline"], wish["camera"], solver, timeout_s=wish["timeout"]))
    return _Work(station, session, steps, options, wish, wish["folder"] or _dated(), live)


def _dated() -> Path:
    from datetime import datetime

    return Path(f"calibration-{datetime.now():%Y%m%d-%H%M%S}")


def _views(work: _Work, source: Path | None) -> Iterator[BoardView]:
    """Yield the board views of the way that was asked for."""
    from fringed_client.calibration import taking

    wish = work.wish
    if source is not None:
        yield from taking.folder_poses(work.session, source, work.steps)
        return
    if wish["views"]:
        yield from work.session.named(wish["views"])
        return
    if wish["resume"]:
        for view in work.session.earlier():
            work.add(view)
    poses = taking.remaining(wish["poses"], work.good)
    if wish["simulated"]:
        yield from taking.simulated_poses(work.session, poses, work.steps)
        return
    yield from taking.held_poses(work.session, poses, _ready(work), work.steps)


def _ready(work: _Work) -> Callable[[Pose], bool]:
    """Return what waits for the board: a time, or Enter."""
    from fringed_client.calibration.taking import every

    def where(pose: Pose) -> str:
        from fringed_client.calibration.poses import words

        return work.session.suggestion(work.good) or f"hold the board at the {words(pose)}"

    if work.wish["every"] is not None:
        return every(work.wish["every"], output.say, where)

    def asked(pose: Pose) -> bool:
        there = f"{pose.name} of {work.wish['poses']}: {where(pose)}"
        enough = ", d: done" if len(work.good) >= 5 else ""
        answer = click.prompt(f"{there}  [Enter: take{enough}]", default="", show_default=False, err=True)
        return answer.strip().lower() not in ("d", "done")

    return asked


def _interrupted(work: _Work) -> None:
    if work.live:
        output.say("every pose that was taken is kept on the station; go on with `fringe calibrate --resume`")


def _too_few(work: _Work) -> Exception:
    from fringed.errors import QualityError

    why = "".join(f"\n  {view.name}: {view.reason}" for view in work.views if not view.found)
    return QualityError(
        f"the board was found in {len(work.good)} of {len(work.views)} poses; a calibration needs 5 or more: take more "
        f"with `fringe calibrate --resume`{why}"
    )


def _solve(work: _Work) -> tuple[Calibration, tuple[str, ...]]:
    session, steps = work.session, work.steps
    ramp = _ramp(work)
    found, warnings = session.solve(work.good, steps.scan("calibration"))
    if ramp:
        found, more = session.with_tone(found, ramp, steps.scan("tone curve"))
        warnings = (*warnings, *more)
    return found, warnings


def _ramp(work: _Work) -> str:
    """Return the id of grey levels' frames where the tone curve is to be measured, on what stands before the rig."""
    from fringed_client.calibration.taking import simulated_ramp

    wish, session = work.wish, work.session
    if not work.live or not (session.lacks_tone() if wish["tone"] is None else wish["tone"]):
        return ""
    if wish["simulated"]:
        return simulated_ramp(session, work.steps)
    output.say("projecting grey levels: leave the board, or any light and matt surface, before the rig")
    return session.ramp(work.steps.scan("tone"))


def _write(work: _Work, folder: Path) -> Path:
    from fringed_client.calibration.folders import write_poses

    return write_poses(work.station, work.session.board, work.good, folder)


def _tell(work: _Work, found: Calibration, warnings: tuple[str, ...], in_force: Any) -> None:
    from fringed_client.calibration.figures import accuracy_rows, view_row
    from fringed_client.calibration.report import write_report

    report = write_report(work.station, found, work.views, work.folder)
    files = [*report, *work.files]
    for text in warnings:
        output.say(f"warning: {text}")
    if work.options.json:
        output.emit({
            "calibration": found.id, "hash": found.hash, "residuals": dict(found.residuals), "notes": found.notes,
            "views": [view_row(view) for view in work.views], "warnings": list(warnings),
            "files": [str(file) for file in files], "in_force": in_force["in_force"] if in_force else None,
        })  # fmt: skip
        return
    mark = "  SIMULATED" if found.provenance.simulated else ""
    output.facts({**accuracy_rows(found), f"report{mark}": str(report[0])})
    if in_force is None:
        output.say(f"to use it: fringe calibration use {found.id}")
