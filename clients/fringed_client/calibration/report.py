"""The report of a calibration: what it is worth, what it rests on, what would make it better.

Owns which pictures and tables there are and how the page looks; everything shown is in the calibration and its views.
"""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from fringed import __version__
from fringed.data import BoardView, Calibration, ViewFit
from fringed.errors import FringedError
from fringed_client.calibration import tables
from fringed_client.calibration_file import save_calibration
from fringed_client.files import make_folder, write_aside
from fringed_client.pictures import calibration as draw
from fringed_client.saving import save_recording

if TYPE_CHECKING:
    from fringed_client.station import Station

_PAGE = Template((Path(__file__).parent / "report.html.in").read_text(encoding="utf-8"))


def draw_view(view: BoardView, folder: Path) -> Path:
    """Draw what was seen of the board in one pose, found or not."""
    from fringed_client.pictures.gallery import draw_main

    make_folder(folder / "poses")
    return draw_main(view, folder / "poses" / f"{view.name or view.id}.png")


def write_report(station: Station, found: Calibration, views: Sequence[BoardView], folder: Path) -> list[Path]:
    """Write `report.html` with its pictures, and the calibration as a recording and as JSON; the page comes first.

    Raises
    ------
    StorageError
        the folder cannot be written.
    """
    make_folder(folder)
    trueness = trueness_of(station, found)
    page = write_page(found, views, trueness, folder)
    return [page, save_recording(station, found.id, folder / "calibration"),
            save_calibration(found, folder / "calibration.json")]  # fmt: skip


def trueness_of(station: Station, found: Calibration) -> Mapping[str, Any] | None:
    """Return the deviation of points that a calibration leaves, None where that cannot be told."""
    if found.covariance is None or not any(not fit.note for fit in found.views):
        return None
    stages = [{"name": "trueness", "plugin": "expected-trueness"}]
    try:
        made = station.process({"calibration": found}, stages=stages).last("Artifact")
    except FringedError:  # a station of an older release, or with other plug-ins
        return None
    return dict(json.loads(made.content.tobytes()))


def write_page(
    found: Calibration, views: Sequence[BoardView], trueness: Mapping[str, Any] | None, folder: Path
) -> Path:
    """Write the page and its pictures into a folder."""
    simulated = found.provenance.simulated
    pictures = make_folder(folder / "pictures")
    fits = {fit.view: fit for fit in found.views}
    page = _PAGE.substitute(
        rig=_text(found.rig or "an unnamed rig"),
        badge='<span class="badge">SIMULATED</span>' if simulated else "",
        made=_text(tables.made(found, len(views))), software=f"fringed {_text(__version__)}",
        id=_text(found.id or "not recorded"), hash=found.hash,
        temperature="" if found.temperature_c is None else f", at {found.temperature_c:g} °C",
        figures="".join(_figure(value, name) for name, value in tables.headline(found, trueness).items()),
        notes=_notes(found, views),
        coverage=_image(folder, draw.draw_coverage(pictures / "coverage.png", _found(views), found)),
        trueness=_trueness(folder, trueness, simulated),
        residuals=_residuals(folder, found), parameters=_table(*tables.parameters(found)), light=_light(folder, found),
        views=_table(*tables.poses(views, found)) + "".join(_view(folder, found, v, fits.get(v.id)) for v in views),
    )  # fmt: skip
    return write_aside(folder / "report.html", page.encode())


def _found(views: Sequence[BoardView]) -> list[BoardView]:
    return [view for view in views if view.found]


def _text(value: Any) -> str:
    return html.escape(str(value))


def _figure(value: str, name: str) -> str:
    return f'<div class="figure"><b>{_text(value)}</b><span>{_text(name)}</span></div>'


def _notes(found: Calibration, views: Sequence[BoardView]) -> str:
    lines = [*found.notes, *tables.advice(found, views)]
    if not lines:
        return ""
    return f'<div class="notes"><b>What to know, and what to improve</b><ul>{"".join(map(_item, lines))}</ul></div>'


def _item(text: str) -> str:
    return f"<li>{_text(text)}</li>"


def _image(folder: Path, path: Path, kind: str = "") -> str:
    name = _text(path.relative_to(folder).as_posix())
    return f'<a href="{name}"><img class="{kind}" loading="lazy" src="{name}" alt="{_text(path.stem)}"/></a>'


def _trueness(folder: Path, table: Mapping[str, Any] | None, simulated: bool) -> str:
    if table is None:
        return "<p>Unknown: this calibration has no covariance.</p>"
    return _image(folder, draw.draw_trueness(folder / "pictures" / "trueness.png", table, simulated))


def _residuals(folder: Path, found: Calibration) -> str:
    if not found.views:
        return "<p>This calibration holds none.</p>"
    return _image(folder, draw.draw_residuals(folder / "pictures" / "residuals.png", found, found.views, "all poses"))


def _light(folder: Path, found: Calibration) -> str:
    from fringed_client.pictures.tone import draw_tone

    parts = []
    if found.camera_falloff is not None or found.projector_falloff is not None:
        parts.append(_image(folder, draw.draw_falloff(folder / "pictures" / "falloff.png", found), "half"))
    if found.tone_curve is not None:
        drawn = draw_tone(folder / "pictures" / "tone.png", found, found.provenance.simulated)
        parts.append(_image(folder, drawn, "half"))
    return f'<h2>Light</h2><div class="pictures">{"".join(parts)}</div>' if parts else ""


def _view(folder: Path, found: Calibration, view: BoardView, fit: ViewFit | None) -> str:
    annotated = folder / "poses" / f"{view.name or view.id}.png"
    if not annotated.exists():
        draw_view(view, folder)
    parts = [_image(folder, annotated)]
    note = fit.note if fit is not None else ""
    if fit is not None:
        name = folder / "pictures" / f"residuals-{view.name or view.id}.png"
        parts.append(_image(folder, draw.draw_residuals(name, found, [fit], view.name)))
    said = view.reason or note or "; ".join(view.problems)
    told = f'<span class="{"bad" if view.reason or note else ""}"> {_text(said)}</span>' if said else ""
    opened = " open" if view.reason or note else ""
    pair = f'<div class="pair">{"".join(parts)}</div>'
    return f"<details{opened}><summary>{_text(view.name or view.id)}{told}</summary>{pair}</details>"


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]], wide: str = "") -> str:
    if not rows:
        return ""

    def cells(tag: str, row: Sequence[Any]) -> str:
        last = len(row) - 1
        kind = [' class="text"' if wide and place == last else "" for place in range(len(row))]
        return "".join(f"<{tag}{own}>{_text(cell)}</{tag}>" for own, cell in zip(kind, row, strict=True))

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<table><thead><tr>{cells('th', head)}</tr></thead><tbody>{body}</tbody></table>"
