"""`fringe patterns`: what would be projected, without projecting it; and the best frequencies for a job."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs
from fringed_client.cli.records import _CONFIG

if TYPE_CHECKING:
    from fringed.data import PatternSequence
    from fringed_client.station import Station

_FOLDER = click.Path(file_okay=False, path_type=Path)
_USUAL_PX = (1024, 768)
_SHIFTS_SHOWN = 8


class EncoderGroup(click.Group):
    """A group that takes any other word for an encoder to draw."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if "--list" in args:
            args = ["list", *(arg for arg in args if arg != "--list")]
        elif args and args[0] not in (*self.commands, "-h", "--help"):
            args = ["draw", *args]
        return super().parse_args(ctx, args)


EXAMPLES = """\b
Examples:
  fringe patterns --list
      the encoders; `fringe patterns list ENCODER` their parameters
  fringe patterns multi-frequency
      its groups, periods and shifts
  fringe patterns phase-shift --set style=binary --set periods=32 --output out
      the exact pictures, a contact sheet, lines, patterns.json
  fringe patterns design --frames 12 --snr 20
      the best frequencies for 12 frames
"""


@click.group("patterns", cls=EncoderGroup, subcommand_metavar="ENCODER|COMMAND [OPTIONS]...", epilog=EXAMPLES)
def patterns_command() -> None:
    """Show what would be projected, without projecting it.

    A worker of the station makes the patterns exactly as for a scan: for its projector's size and the tone curve of
    the calibration in force. Where no station is running a private one does, for --size, without a tone curve.
    Combinations that nobody could decode end with code 2, the reason, and what to use instead.
    """


@patterns_command.command("draw")
@click.argument("encoder")
@click.option("--set", "params", multiple=True, callback=pairs, metavar="KEY=VALUE", help="A parameter; see --list.")
@click.option("--size", metavar="WIDTHxHEIGHT", help="Of the projector; the station's own when left out.")
@click.option("--output", "-o", "folder", type=_FOLDER, help="Write PNGs, contact sheet, lines and patterns.json.")
@_CONFIG
@common
def _draw(
    encoder: str, params: dict[str, Any], size: str | None, folder: Path | None, config: Path | None, options: Options
) -> None:
    """Show the patterns of ENCODER (the word `draw` may be left out)."""
    from fringed_client.pattern_files import describe, group_rows

    with _station(options, config) as station:
        sequence = station.patterns(encoder, params, _size(station, size))
    files = _write(folder, sequence) if folder else []
    if options.json:
        output.emit({**describe(sequence), "files": [str(path) for path in files]})
        return
    output.table(_COLUMNS, [_row(row) for row in group_rows(sequence)], _title(sequence))
    if files:
        output.say(f"{len(files)} files in {folder}")


@patterns_command.command("list")
@click.argument("encoder", required=False)
@_CONFIG
@common
def _list(encoder: str | None, config: Path | None, options: Options) -> None:
    """List the encoders, or the parameters of ENCODER with limits, units and defaults."""
    from fringed.errors import NotFound

    with _station(options, config) as station:
        schemas = _schemas(station)
    if encoder is not None and encoder not in schemas:
        raise NotFound(f"no encoder is called {encoder!r}; there are {', '.join(sorted(schemas))}")
    if options.json:
        output.emit(schemas if encoder is None else schemas[encoder])
    elif encoder is None:
        about = [(name, schema["x-plugin"]) for name, schema in sorted(schemas.items())]
        output.table(("encoder", "what", "decoders"), [(n, a["summary"], ", ".join(a["decoders"])) for n, a in about])
    else:
        output.table(("parameter", "default", "allowed", "what"), _parameters(schemas[encoder]))


@patterns_command.command("design")
@click.option("--frames", required=True, type=click.IntRange(3, 256), help="Of all steps and frequencies together.")
@click.option("--snr", required=True, type=click.FloatRange(0, 1e4, min_open=True), help="Modulation over noise.")
@click.option("--min-period", type=click.FloatRange(4, 4096), help="Shortest period in px, where the encoder takes it.")
@click.option("--size", metavar="WIDTHxHEIGHT", help="Of the projector; the station's own when left out.")
@click.option("--orientation", type=click.Choice(["columns", "rows"]), default="columns", show_default=True)
@_CONFIG
@common
def _design(size: str | None, config: Path | None, options: Options, **wish: Any) -> None:
    """Find the best frequencies and steps for a number of frames and a noise.

    For each encoder that can: the set with the least noise of the projector column whose fringe orders are wrong less
    often than once in a million pixels. `column noise` is the finest frequency's alone and, behind the stroke, that
    of all frequencies averaged, in projector pixels.
    """
    from fringed.errors import UsageError

    rows: list[dict[str, Any]] = []
    with _station(options, config) as station:
        chosen = _size(station, size)
        for encoder, params in _designers(_schemas(station), wish):
            try:
                sequence = station.patterns(encoder, params, chosen)
            except UsageError as error:
                rows.append({"encoder": encoder, "refused": str(error)})
            else:
                design = sequence.parameters["design"][wish["orientation"]]
                rows.append({"encoder": encoder, **design})
    if options.json:
        output.emit(rows)
        return
    output.table(
        ("encoder", "periods", "steps", "wrong orders", "column noise (px)"),
        [_design_row(row) for row in rows if "refused" not in row],
    )
    for row in rows:
        if "refused" in row:
            output.say(row["refused"])


_COLUMNS = ("group", "style", "orientation", "period (px)", "frames", "shifts (degrees)", "level", "light")


def _row(row: Mapping[str, Any]) -> tuple[Any, ...]:
    shifts = [f"{shift:g}" for shift in row["shifts_deg"][:_SHIFTS_SHOWN]]
    shifts += ["..."] * (len(row["shifts_deg"]) > _SHIFTS_SHOWN)
    text = f"bits {row['bits'][0]} to {row['bits'][-1]}" if row["bits"] else " ".join(shifts)
    frames = f"{row['frames']}, {row['inverted']} inverse" if row["inverted"] else row["frames"]
    return (
        row["group"], row["style"], row["orientation"], f"{row['period_px']:.6g}", frames, text, f"{row['level']:g}",
        row["channel"],
    )  # fmt: skip


def _title(sequence: PatternSequence) -> str:
    from fringed_client.pictures.patterns import title

    return title(sequence)


def _design_row(row: Mapping[str, Any]) -> tuple[str, ...]:
    periods, steps = (" ".join(map(str, row[name])) for name in ("periods", "steps"))
    noise = f"{row['sigma_px']:.4f} / {row['combined_sigma_px']:.4f}"
    return row["encoder"], periods, steps, f"{row['failure']:.1g}", noise


def _write(folder: Path, sequence: PatternSequence) -> list[Path]:
    from fringed_client.pattern_files import write_patterns
    from fringed_client.pictures.patterns import draw_lines, draw_sheet

    files = write_patterns(folder, sequence)
    return [*files, draw_sheet(folder / "sheet.png", sequence), draw_lines(folder / "lines.png", sequence)]


@contextmanager
def _station(options: Options, config: Path | None) -> Iterator[Station]:
    from fringed_client.private import any_station

    with any_station(options.station, output.say, config) as station:
        yield station


def _size(station: Station, given: str | None) -> tuple[int, int] | None:
    """Return the size that was asked for; the usual one where there is no projector, None: the station's."""
    if given:
        width, _, height = given.lower().partition("x")
        if not (width.isdigit() and height.isdigit()):
            raise click.BadParameter(
                f"{given!r}; expected WIDTHxHEIGHT in pixels, such as 1024x768", param_hint="--size"
            )
        return int(width), int(height)
    if station.status().projector.driver != "none":
        return None
    output.say(f"the station has no projector: taking {_USUAL_PX[0]}x{_USUAL_PX[1]}; --size gives another")
    return _USUAL_PX


def _schemas(station: Station) -> dict[str, Any]:
    """Return the encoders' parameter schemas, as soon as a worker has told them."""
    import time

    deadline = time.monotonic() + 30.0
    while True:
        found = station.plugins()["schemas"].get("encoder", {})
        if found or time.monotonic() > deadline:
            return {name: _resolved(schema) for name, schema in found.items()}
        time.sleep(0.1)


def _resolved(schema: Mapping[str, Any]) -> dict[str, Any]:
    """Return a schema with its properties at the top, not behind a reference."""
    name = str(schema.get("$ref", "")).rpartition("/")[2]
    inner = schema.get("$defs", {}).get(name, {})
    return {**inner, **{key: value for key, value in schema.items() if key not in ("$ref", "$defs")}}


def _designers(schemas: Mapping[str, Any], wish: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the encoders that design their frequencies, with the parameters that ask for it."""
    for encoder, schema in sorted(schemas.items()):
        known = schema.get("properties", {})
        auto = [name for name, field in known.items() if "auto" in _choices(field)]
        if auto and {"frames", "expected_snr"} <= set(known):
            asked = {auto[0]: "auto", "frames": wish["frames"], "expected_snr": wish["snr"]}
            asked["orientation"] = wish["orientation"]
            if wish["min_period"] and "min_period_px" in known:
                asked["min_period_px"] = wish["min_period"]
            yield encoder, asked


def _choices(field: Mapping[str, Any]) -> list[Any]:
    options = field.get("anyOf", [field])
    return [choice for option in options for choice in option.get("enum", [])]


def _parameters(schema: Mapping[str, Any]) -> Iterator[tuple[str, str, str, str]]:
    import json

    for name, field in schema.get("properties", {}).items():
        default = json.dumps(field["default"]) if "default" in field else ""
        yield name, default, _allowed(field), field.get("description", "")


def _allowed(field: Mapping[str, Any]) -> str:
    """Return what a parameter may be, in a few words."""
    if "anyOf" in field:
        return " or ".join(_allowed(option) for option in field["anyOf"])
    if "enum" in field:
        return " | ".join(map(str, field["enum"]))
    if field.get("type") == "array":
        return f"list of {_allowed(field.get('items', {}))}"
    low = field.get("minimum", field.get("exclusiveMinimum"))
    high = field.get("maximum", field.get("exclusiveMaximum"))
    limits = f" {low:g} to {high:g}" if low is not None and high is not None else ""
    kind = {"boolean": "true | false", "string": "text"}.get(field.get("type", ""), field.get("type", ""))
    units = f" {field['units']}" if field.get("units", "1") != "1" else ""
    return f"{kind}{limits}{units}"
