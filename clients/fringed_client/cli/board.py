"""`fringe board`: a calibration board as a file that prints at exact scale, and as a table for a configuration.

Owns the options and what is told; no station is needed.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common

if TYPE_CHECKING:
    from fringed.boards import Board
    from fringed_client.printing.page import Page

KINDS = ("circles-five", "circles", "asymmetric-circles", "chessboard", "charuco")
POLARITIES = ("dark-on-light", "light-on-dark")
PAPERS = ("a4", "a3", "letter", "tabloid", "fit")
_KEYS = {
    "kind": "kind", "columns": "columns", "rows": "rows", "pitch": "pitch_mm", "diameter": "diameter_mm",
    "big_diameter": "big_diameter_mm", "marker": "marker_mm", "margin": "margin_mm", "polarity": "polarity",
    "dictionary": "dictionary",
}  # fmt: skip
_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command("board")
@click.option("--kind", type=click.Choice(KINDS), help="Default: circles-five, which says itself which way is up.")
@click.option("--columns", type=int, help="Circles, or inner corners, of a row.  [default: 13]")
@click.option("--rows", type=int, help="[default: 9]")
@click.option("--pitch", type=float, metavar="MM", help="Between two points of a row.  [default: 20]")
@click.option("--diameter", type=float, metavar="MM", help="Of a circle.  [default: 0.45 pitches]")
@click.option("--big-diameter", type=float, metavar="MM", help="Of the five large ones.  [default: 0.7 pitches]")
@click.option("--marker", type=float, metavar="MM", help="Side of a ChArUco marker.  [default: 0.75 pitches]")
@click.option("--margin", type=float, metavar="MM", help="Around the outer points.  [default: 1 pitch, squares 1.5]")
@click.option("--polarity", type=click.Choice(POLARITIES), help="Marks on ground.  [default: dark-on-light]")
@click.option("--dictionary", metavar="NAME", help="OpenCV's, of ChArUco markers.  [default: DICT_5X5_250]")
@click.option("--paper", default="a4", show_default=True, type=click.Choice(PAPERS), help="Fit: as large as the board.")
@click.option("--output", "-o", "path", type=_FILE, help="Write .pdf or .svg.")
@click.option("--toml", is_flag=True, help="Print the table for a configuration on stdout.")
@common
def board_command(path: Path | None, toml: bool, paper: str, options: Options, **given: Any) -> None:
    """Make a calibration board to print, at exact scale.

    Print at 100 %, measure the bar on it, and put what you measured into the station's configuration: --toml prints
    the table.
    """
    from fringed.boards import board_of

    if toml and options.json:
        raise click.UsageError("--toml and --json are both for stdout; take one of them")
    board = board_of({_KEYS[name]: value for name, value in given.items() if value is not None})
    if toml:
        click.echo(toml_of(board))
        if path is None:
            return
    page = _page(board, paper, path)
    files = [] if path is None else [_write(page, path)]
    for text in page.warnings:
        output.say(f"warning: {text}")
    if options.json:
        output.emit(_document(board, page, files))
    elif not toml:
        output.facts(_rows(board, page, files))


def _page(board: Board, paper: str, path: Path | None) -> Page:
    from fringed_client.printing.page import page_of

    if path is not None and path.suffix.lower() not in (".pdf", ".svg"):
        raise click.UsageError(f"a board is written as .pdf or .svg; {path.name} is none of them")
    return page_of(board, paper)


def _write(page: Page, path: Path) -> Path:
    from fringed.errors import StorageError
    from fringed_client.printing.pdf import pdf_of
    from fringed_client.printing.svg import svg_of

    data = pdf_of(page) if path.suffix.lower() == ".pdf" else svg_of(page)
    try:
        path.write_bytes(data)
    except OSError as error:
        raise StorageError(f"{path} cannot be written: {error}") from error
    return path


def toml_of(board: Board) -> str:
    """Return the table `[board]`, with kind, size and pitch always, and what else is not the default."""
    import json

    from fringed.boards import Board

    usual, always = Board(), ("kind", "columns", "rows", "pitch_mm")
    keys = [key for key in Board.__struct_fields__ if key in always or getattr(board, key) != getattr(usual, key)]
    # JSON's strings and numbers are TOML's.
    return "\n".join(["[board]", *(f"{key} = {json.dumps(getattr(board, key))}" for key in keys)])


def _document(board: Board, page: Page, files: list[Path]) -> dict[str, Any]:
    from fringed.boards import size_mm

    return {
        "board": output.plain(board), "size_mm": size_mm(board), "page_mm": (page.width_mm, page.height_mm),
        "bar_mm": page.bar_mm, "files": [str(path) for path in files], "warnings": list(page.warnings),
    }  # fmt: skip


def _rows(board: Board, page: Page, files: list[Path]) -> dict[str, str]:
    import numpy as np

    from fringed.boards import points_mm, size_mm

    reach = np.ptp(points_mm(board), axis=0)
    width, height = size_mm(board)
    rows = {
        "board": page.title,
        "sheet": f"{width:g} x {height:g} mm, first to last point {reach[0]:g} x {reach[1]:g} mm",
        "page": f"{page.width_mm:g} x {page.height_mm:g} mm",
    }
    if files:
        rows["written"] = "\n".join(str(path) for path in files)
        rows["next"] = "print at 100 %, measure the bar, and put the true pitch into the configuration (--toml)"
    else:
        rows["next"] = "--output board.pdf writes it"
    return rows
