"""`fringe demo`: the whole station at work on a simulated rig."""

from __future__ import annotations

from pathlib import Path

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common


@click.command("demo")
@click.option("--output", "-o", "folder", type=click.Path(file_okay=False, path_type=Path), default="demo-output",
              show_default=True)  # fmt: skip
@click.option("--quick", is_flag=True, help="A camera of 464 x 348 pixels.")
@common
def demo_command(folder: Path, quick: bool, options: Options) -> None:
    """Calibrate a simulated rig from images, scan a face and a mould from three views each, and report errors."""
    from fringed_client.demo.run import run_demo

    output.say("starting a private station with a SIMULATED rig")
    with output.steps() as steps:
        report = run_demo(folder, quick, steps)
    if options.json:
        output.emit(report)
        return
    rows = {name: _line(found) for name, found in report["objects"].items()}
    output.facts({**rows, "seconds": f"{report['seconds']['total']:.1f}", "report": str(folder / "report.html")})


def _line(found: dict[str, dict[str, float]]) -> str:
    model = found["model"]
    return (
        f"{model['points']:,} points from {model['views']} views, "
        f"{model['median_abs_error_mm'] * 1000:.0f} um median error, SIMULATED"
    )
