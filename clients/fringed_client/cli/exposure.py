"""`fringe exposure`: measure how bright the scene is, and say which exposures show all of it.

Owns what is told and the commands to go on with; the choice is a processor of the station (`suggest-exposures`).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs

_HDR = ("object-short", "object", "object-long")


@click.command("exposure")
@click.option("--snr", default=20.0, show_default=True, type=click.FloatRange(1), help="Wanted modulation over noise.")
@click.option("--most", default=4, show_default=True, type=click.IntRange(1, 8), help="Exposures at most.")
@click.option(
    "--camera",
    multiple=True,
    callback=pairs,
    metavar="KEY=VALUE",
    help="Such as channel=red; exposure_us to begin with.",
)
@click.option(
    "--output", "-o", "path", type=click.Path(dir_okay=False, path_type=Path), help="Draw the histogram: .png."
)
@click.option("--timeout", default=300.0, show_default=True, type=click.FloatRange(min=1), help="Seconds.")
@common
def exposure_command(path: Path | None, options: Options, **wish: Any) -> int:
    """Suggest exposures for what stands before the rig.

    Takes three short sets, an eighth, once and eight times the station's exposure, and says which exposures bring
    every pixel with fringes to the wanted signal without saturating it: one, or several for the pipeline hdr. Ends
    with code 5 where the range is too wide for as many as are allowed.
    """
    from fringed.errors import EXIT_OK, EXIT_QUALITY
    from fringed_client.station import Station

    with Station(options.station) as station, output.steps() as steps:
        result = station.scan(
            "exposure",
            camera=wish["camera"] or None,
            stages={"exposures": {"snr": wish["snr"], "most": wish["most"]}},
            on_progress=steps.scan("exposure"),
            timeout_s=wish["timeout"],
        )
        found = json.loads(bytes(result.last("Artifact").content))
        simulated = bool(station.hello.get("simulated"))
    if path is not None:
        from fringed_client.pictures.exposures import draw_exposures

        draw_exposures(path, found, simulated)
    found["next"] = _next(found)
    if options.json:
        output.emit({"scan": result.state, **found})
    else:
        output.facts(_rows(found, path, simulated))
    return EXIT_OK if found["enough"] else EXIT_QUALITY


def _next(found: dict[str, Any]) -> str:
    if len(found["exposures_us"]) == 1:
        return f"fringe scan --camera exposure_us={found['exposures_us'][0]:.10g}"
    if len(found["three_us"]) < len(_HDR):
        return ""
    times = (f"--camera {role}.exposure_us={us:.10g}" for role, us in zip(_HDR, found["three_us"], strict=True))
    return f"fringe scan --pipeline hdr {' '.join(times)}"


def _rows(found: dict[str, Any], path: Path | None, simulated: bool) -> dict[str, Any]:
    quantiles = found["quantiles_us"]
    rows = {
        "exposures": ", ".join(f"{us:.10g} us" for us in found["exposures_us"]) + ("  SIMULATED" if simulated else ""),
        "": found["reason"],
        "full scale": ", ".join(f"{float(q):.0%} of the pixels below {us:.3g} us" for q, us in _falling(quantiles)),
        "range": f"1 to {found['range']:.3g} (99 % of the pixels with fringes)",
        "pixels": f"{found['lit']:.1%} with fringes, {found['dark']:.1%} dark, {found['saturated']:.1%} saturated",
    }
    rows |= {"next": found["next"]} if found["next"] else {}
    return rows | ({"picture": str(path)} if path else {})


def _falling(quantiles: dict[str, float]) -> list[tuple[str, float]]:
    return [(q, quantiles[q]) for q in ("0.99", "0.5", "0.01")]
