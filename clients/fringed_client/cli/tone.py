"""`fringe tone`: measure the projector's tone curve, verify it on another surface, show the one in force.

Owns the order of the loop and what is told; the fits are processors of the station (`tone-response`, `tone-verify`).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs

if TYPE_CHECKING:
    from fringed.data import Calibration
    from fringed_client.station import Station

_FILE = click.Path(dir_okay=False, path_type=Path)
_CAMERA = click.option(
    "--camera", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Such as exposure_us=10000, channel=green."
)
_OUTPUT = click.option("--output", "-o", "path", type=_FILE, help="Write the new calibration: .h5, or .json.")
_PLOT = click.option("--plot", type=_FILE, help="Draw the curve: .png.")
_TIMEOUT = click.option(
    "--timeout", default=300.0, show_default=True, type=click.FloatRange(min=1), help="Seconds for each scan."
)


@click.group("tone")
def tone_command() -> None:
    """Measure, verify and show the projector's tone curve.

    The loop: `measure` on any light, matt surface; make the calibration that it writes the station's; `verify` on
    another object; make that one the station's. Every scan after that warns when the curve has drifted.
    """


@tone_command.command("measure")
@click.option("--levels", default=33, show_default=True, type=click.IntRange(9, 256), help="Grey levels.")
@click.option("--repeats", default=7, show_default=True, type=click.IntRange(2, 64), help="Of black and white.")
@_CAMERA
@_OUTPUT
@_PLOT
@_TIMEOUT
@common
def _measure(levels: int, repeats: int, path: Path | None, plot: Path | None, options: Options, **wish: Any) -> None:
    """Project uniform grey pictures and fit the curve; needs a calibration to add it to.

    Leave out what moves and what glares. Blur and the surface's colour do not matter.
    """
    from fringed_client.station import Station

    with Station(options.station) as station, output.steps() as steps:
        result = station.scan(
            "tone",
            encoder_params={"levels": levels, "repeats": repeats},
            camera=wish["camera"] or None,
            on_progress=steps.scan("tone"),
            timeout_s=wish["timeout"],
        )
        found = result.last("Calibration")
        files = _write(station, found, path, plot)
    _tell(found, options, files, result.state.warnings)
    if not options.json:
        _next(found, path, "then `fringe tone verify` with another object before the rig")


@tone_command.command("verify")
@click.option("--periods", default=64.0, show_default=True, type=click.FloatRange(1), help="Across the projector.")
@click.option("--max-ripple", default=0.02, show_default=True, type=click.FloatRange(0, 3), help="Of 3 steps, rad RMS.")
@click.option("--another-surface", is_flag=True, help="Your word that it is one, where the ramp is not at hand.")
@_CAMERA
@_OUTPUT
@_TIMEOUT
@common
def _verify(path: Path | None, options: Options, **wish: Any) -> int:
    """Compare few steps with many on the present object, with and without compensation.

    The station's calibration must hold the curve. The surface that the curve was measured on is refused. Ends with
    code 5 where more ripple is left than allowed.
    """
    from fringed.errors import EXIT_OK, EXIT_QUALITY
    from fringed_client.calibration_file import calibration_of
    from fringed_client.station import Station

    with Station(options.station) as station, output.steps() as steps:
        curve = calibration_of(station)
        sets = _take_sets(station, wish, steps)
        ramp = _ramp_of(station, curve)
        result = station.process(
            {**sets, **ramp, "calibration": curve},
            stages=[{"name": "verified", "plugin": "tone-verify", "params": {
                "max_ripple_rad": wish["max_ripple"], "another_surface": wish["another_surface"],
            }}],
            on_progress=steps.scan("verify"), timeout_s=wish["timeout"],
        )  # fmt: skip
        found = result.last("Calibration")
        files = _write(station, found, path, None)
    _tell(found, options, files, result.state.warnings)
    if not found.residuals.get("tone_verified"):
        return EXIT_QUALITY
    if not options.json:
        _next(found, path, "scans warn from then on where the curve has drifted")
    return EXIT_OK


@tone_command.command("show")
@_PLOT
@common
def _show(plot: Path | None, options: Options) -> None:
    """Tell what the station's calibration knows of the curve."""
    from fringed.errors import NotFound
    from fringed_client.calibration_file import calibration_of
    from fringed_client.station import Station

    with Station(options.station) as station:
        found = calibration_of(station)
        if found.tone_curve is None:
            raise NotFound("the station's calibration has no tone curve; measure one with `fringe tone measure`")
        files = _write(station, found, None, plot)
    _tell(found, options, files, ())


def _take_sets(station: Station, wish: dict[str, Any], steps: Any) -> dict[str, str]:
    """Return the ids of a plain and a compensated set of 12 steps."""
    found = {}
    for name, compensated in (("plain", False), ("compensated", True)):
        result = station.scan(
            "tone-check",
            encoder_params={"periods": wish["periods"], "steps": 12, "precompensate": compensated},
            camera=wish["camera"] or None,
            process=False,
            on_progress=steps.scan(name),
            timeout_s=wish["timeout"],
        )
        found[name] = result.state.frame_sets["object"]
    return found


def _ramp_of(station: Station, calibration: Calibration) -> dict[str, str]:
    """Return the id of the ramp that the curve was measured on, where the station has it."""
    from fringed.data import FrameSet
    from fringed.errors import FringedError

    for item in calibration.provenance.inputs:
        try:
            found = station.get(item)
        except FringedError:
            continue
        if isinstance(found, FrameSet) and found.sequence.family == "grey-ramp":
            return {"ramp": item}
    return {}


def _write(station: Station, found: Calibration, path: Path | None, plot: Path | None) -> list[Path]:
    from fringed_client.calibration_file import save_calibration
    from fringed_client.saving import save_as

    files: list[Path] = []
    if path is not None:
        files += [save_calibration(found, path)] if path.suffix == ".json" else save_as(station, found.id, path)
    if plot is not None:
        from fringed_client.pictures.tone import draw_tone

        files.append(draw_tone(plot, found, bool(station.hello.get("simulated"))))
    return files


def _tell(found: Calibration, options: Options, files: list[Path], warnings: Any) -> None:
    figures = {key: value for key, value in found.residuals.items() if key.startswith("tone_")}
    for text in warnings:
        output.say(f"warning: {text}")
    if options.json:
        document = {"calibration": found.id, "tone": figures, "files": [str(f) for f in files]}
        output.emit({**document, "warnings": list(warnings)})
        return
    output.facts(_rows(found, figures, files))


def _rows(found: Calibration, figures: dict[str, float], files: list[Path]) -> dict[str, str]:
    rows = {"calibration": found.id or found.hash}
    if "tone_levels" not in figures:
        rows["curve"] = "not measured: it came with the calibration"
    else:
        rows["curve"] = f"{figures['tone_levels']:.0f} levels, known to {figures['tone_deviation']:.3%} of the range"
        rows["levels"] = f"scatter {figures['tone_rms']:.3%} about the curve"
        rows["lamp"] = f"drift {figures['tone_drift']:+.2%}, flicker {figures['tone_flicker']:.2%}"
    for steps in (3, 4):
        after = figures.get(f"tone_ripple_{steps}_rad")
        if after is not None:
            before = figures[f"tone_ripple_{steps}_before_rad"]
            rows[f"{steps} steps"] = f"ripple {before:.4f} rad RMS before, {after:.4f} after"
    rows["verified"] = "on another surface" if figures.get("tone_verified") else "NO"
    if files:
        rows["files"] = "\n".join(str(file) for file in files)
    return rows


def _next(found: Calibration, path: Path | None, then: str) -> None:
    """Tell how the calibration becomes the station's."""
    if path is None or path.suffix == ".json":
        where = f"write it with `fringe get {found.id} -o tone.h5`, and name that file"
    else:
        where = f'set  calibration = "{path.resolve()}"'
    output.say(f"to use it: {where} in the station's configuration, reload it (SIGHUP), {then}")
