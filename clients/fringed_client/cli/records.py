"""`fringe list`, `get`, `export` and `view`: what is recorded, and files and pictures of it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs

if TYPE_CHECKING:
    from fringed_client.station import Station

ID = re.compile(r"^\d{8}T\d{6}\.\d{6}Z-[0-9a-f]{4}$")
_FOLDER = click.Path(file_okay=False, path_type=Path)
_CONFIG = click.option(
    "--config", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Pipelines and plug-in folders for a private station.",
)  # fmt: skip


def a_file(source: str) -> Path:
    """Return the path of a recording's file that was given instead of an id.

    Raises
    ------
    UsageError
        it is neither.
    """
    from fringed.errors import UsageError

    if not Path(source).is_file():
        raise UsageError(f"{source} is neither an id nor a file; `fringe list` shows ids")
    return Path(source)


@click.command("list")
@click.option("--kind", help="Such as FrameSet or RangeImage.")
@click.option("--scan", help="Only what belongs to this scan.")
@click.option("--limit", default=20, show_default=True, type=click.IntRange(1, 100_000))
@click.option("--before", metavar="ID", help="Only what is older.")
@_CONFIG
@common
def list_command(config: Path | None, options: Options, **wish: Any) -> None:
    """List what is recorded, newest first."""
    from fringed_client.private import any_station

    with any_station(options.station, output.say, config) as station:
        found = station.list(**wish)
    if len(found) == wish["limit"]:
        output.say(f"only the newest {len(found)}; older ones with --before {found[-1]['id']}, more with --limit")
    if options.json:
        output.emit(found)
        return
    if not found:
        output.say("nothing recorded")
        return
    columns = ("id", "kind", "role", "MB", "origin", "summary")
    rows = [
        (
            r["id"],
            r["kind"],
            r.get("role", ""),
            f"{r['bytes'] / 1e6:.1f}",
            "SIM" if r["simulated"] else "",
            r["summary"],
        )
        for r in found
    ]
    output.table(columns, rows)


@click.command("get")
@click.argument("id", metavar="ID|FILE.h5")
@click.option("--output", "-o", "path", type=click.Path(dir_okay=False, path_type=Path),
              help="A file: .h5 (the recording), .npz, .png, or an exporter's ending.")  # fmt: skip
@_CONFIG
@common
def get_command(id: str, path: Path | None, config: Path | None, options: Options) -> None:
    """Fetch one recording: its figures, or a file of it.

    The figures of a recording's file (.h5) can be shown too; its other formats are written from the id.
    """
    from fringed_client.calibration_file import load_recording
    from fringed_client.private import any_station
    from fringed_client.saving import save_as

    if path is None and not ID.match(id) and Path(id).suffix == ".h5":
        _describe(load_recording(a_file(id)), options)
        return
    with any_station(options.station, output.say, config) as station:
        if path is not None:
            files = [str(p) for p in save_as(station, id, path)]
            output.emit({"id": id, "files": files}) if options.json else output.facts({"written": "\n".join(files)})
            return
        content = station.get(id)
    _describe(content, options)


def _describe(content: Any, options: Options) -> None:
    from fringed.tree import split
    from fringed_client.html import facts

    if options.json:
        arrays: dict[str, Any] = {}
        tree = split(content, "", arrays)
        shapes = {name: {"shape": list(a.shape), "dtype": str(a.dtype)} for name, a in arrays.items()}
        output.emit({"kind": type(content).__name__, "tree": tree, "arrays": shapes})
        return
    provenance = content.provenance
    mark = "  SIMULATED" if provenance.simulated else ""
    rows = {"kind": f"{type(content).__name__}{mark}", **facts(content)}
    rows |= {"made by": f"{provenance.plugin} {provenance.plugin_version}".strip() or "the station"}
    rows |= {
        "from": "\n".join(provenance.inputs) or "nothing recorded",
        "calibration": provenance.calibration or "none",
    }
    output.facts(rows)


@click.command("export")
@click.argument("ids", nargs=-1, required=True, metavar="ID...")
@click.option("--format", "-f", "formats", multiple=True, default=("ply",), show_default=True,
              help="ply, pcd, xyz, stl, obj, tiff, npz, or a plug-in's; may be given several times.")  # fmt: skip
@click.option("--param", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Of the exporter.")
@click.option("--output", "-o", "folder", type=_FOLDER, default=".", help="Folder of the files.  [default: here]")
@_CONFIG
@common
def export_command(
    ids: tuple[str, ...],
    formats: tuple[str, ...],
    param: dict[str, Any],
    folder: Path,
    config: Path | None,
    options: Options,
) -> int:
    """Write products as files of other formats.

    Takes ids, or recordings (.h5) of products. What cannot be written is told, the rest is written all the same.
    """
    from fringed_client.calibration_file import load_recording
    from fringed_client.private import any_station

    items = {i: i if ID.match(i) else load_recording(a_file(i)) for i in ids}
    with any_station(options.station, output.say, config) as station:
        written, failed, code = _export_all(station, items, formats, folder, param)
    if options.json:
        output.emit({"files": written, "failed": failed})
    elif written:
        output.facts({"written": "\n".join(written)})
    for entry in failed:
        output.say(f"not written: {entry['id']} as {entry['format']}: {entry['error']}")
    return code


def _export_all(
    station: Station, items: dict[str, Any], formats: tuple[str, ...], folder: Path, param: dict[str, Any]
) -> tuple[list[str], list[dict[str, str]], int]:
    """Write every item in every format; returns the files, what failed, and the exit code of the first failure."""
    from fringed.errors import EXIT_OK, EXIT_USAGE, DataError, FringedError, StationError

    written, failed, code = [], [], EXIT_OK
    for name_of, item in items.items():
        stem = name_of if ID.match(name_of) else Path(name_of).stem
        for name in formats:
            try:
                written.append(str(station.export(item, name, folder / f"{stem}.{name}", param)))
            except StationError:
                raise
            except FringedError as error:
                failed.append({"id": name_of, "format": name, "error": str(error)})
                code = code or (EXIT_USAGE if isinstance(error, DataError) else error.exit_code)
    return written, failed, code


@click.command("view")
@click.argument("sources", nargs=-1, required=True, metavar="ID|FOLDER|FILE.h5...")
@click.option("--output", "-o", "folder", type=_FOLDER, default="pictures", show_default=True)
@_CONFIG
@common
def view_command(sources: tuple[str, ...], folder: Path, config: Path | None, options: Options) -> None:
    """Draw pictures: frames, phases, masks, depth, shaded views, convergence.

    A source is the id of a recording, its file (.h5), or a capture folder. A registration's id is drawn with both
    its range images, where they are recorded.
    """
    from fringed.errors import UsageError
    from fringed_client.calibration_file import load_recording
    from fringed_client.capture_images import load_capture
    from fringed_client.pictures.gallery import draw_all
    from fringed_client.private import any_station

    drawn: list[Path] = []
    ids = [source for source in sources if ID.match(source)]
    paths = [Path(source) for source in sources if not ID.match(source)]
    unknown = [str(path) for path in paths if not path.exists()]
    if unknown:
        raise UsageError(
            f"{', '.join(unknown)}: neither the id of a recording nor a file or folder; `fringe list` shows ids"
        )
    for file in (path for path in paths if path.is_file()):
        drawn += draw_all(load_recording(file), folder / file.stem)
    for source in (path for path in paths if path.is_dir()):
        for role, frames in load_capture(source)[1].items():
            drawn += draw_all(frames, folder / source.name / role)
    if ids:
        with any_station(options.station, output.say, config) as station:
            for item_id in ids:
                content = station.get(item_id)
                drawn += draw_all(content, folder / item_id, _registered(station, content))
    files = [str(path) for path in drawn]
    output.emit({"files": files}) if options.json else output.facts({"drawn": "\n".join(files)})


def _registered(station: Station, content: Any) -> tuple[Any, Any] | None:
    """Return the views that a registration joins, None where it is none or they are not recorded."""
    from fringed.data import Mesh, Model, RangeImage, Registration
    from fringed.errors import NotFound, RecordingError

    if not isinstance(content, Registration) or not (content.reference and content.model):
        return None
    try:
        pair = station.get(content.reference), station.get(content.model)
    except (NotFound, RecordingError) as error:
        output.say(f"only the convergence is drawn: {error}")
        return None
    return pair if all(isinstance(one, (RangeImage, Model, Mesh)) for one in pair) else None
