"""The demonstration's page: figures against the truth, pictures, timings.

Owns its looks; everything shown comes from the report's tables.
"""

from __future__ import annotations

import html
from pathlib import Path
from string import Template
from typing import Any

from fringed_client.files import write_aside

_PAGE = Template((Path(__file__).parent / "report.html.in").read_text(encoding="utf-8"))
_VIEW_PICTURES = ("fringes", "wrapped phase", "mask", "depth", "error")
_SHADED = ("x-y", "y-z", "x-z", "oblique")


def write_html(folder: Path, report: dict[str, Any]) -> Path:
    """Write `report.html` into the folder; pictures are linked, relative to it."""
    objects = "".join(_object(name, found) for name, found in report["objects"].items())
    width, height = report["camera_px"]
    page = _PAGE.substitute(
        software=_text(report["software"]), camera=f"{width} × {height}", objects=objects,
        total=f"{report['seconds']['total']:.0f}", cores=report["machine"]["cores"],
        tiles="".join(_tile(found) for found in report["objects"].values()),
        timings=_timings(report), machine=_text(f"{report['machine']['system']}, Python {report['machine']['python']}"),
        calibration=_calibration(report["calibration"]),
    )  # fmt: skip
    return write_aside(folder / "report.html", page.encode())


def _text(value: Any) -> str:
    return html.escape(str(value))


def _calibration(found: dict[str, Any]) -> str:
    """Return what the calibration is worth, against what the rig really is."""
    figures, seconds = found["residuals"], found["seconds"]
    told = (
        f"{found['found']} of {found['poses']} poses of a board found in {seconds['poses']:.0f} s, the estimation took "
        f"{seconds['estimation']:.1f} s. Reprojection: {figures.get('camera_rms_px', float('nan')):.3f} px RMS in the "
        f"camera, {figures.get('projector_rms_px', float('nan')):.3f} px in the projector."
    )
    rows = [
        (row["name"], f"{row['true']:.3f}", f"{row['error']:+.4f}", f"{row['relative']:+.4%}", f"{row['sigmas']:+.1f}")
        for row in found["parameters"]
    ]
    head = ("parameter", "true", "error", "of the true value", "in its own σ")
    link = f'<a href="{_text(found["report"])}">its own report</a>'
    return f"<p>{_text(told)} See {link}.</p>{_table(head, rows)}{_displaced(found['against_truth'])}"


def _displaced(found: dict[str, Any]) -> str:
    """Return how far points are from where the exact calibration puts them."""
    depths = f"{min(found['depths_mm']):.0f} to {max(found['depths_mm']):.0f} mm"
    rows = [(f"over the picture, at {depths}", _um(found["rms_mm"]), _um(found["max_mm"]))]
    return _table(("points against the exact calibration", "RMS / µm", "largest / µm"), rows)


def _um(value_mm: float) -> str:
    return f"{value_mm * 1000:.1f}"


def _tile(found: dict[str, Any]) -> str:
    model = found["model"]
    return (
        f'<a class="tile" href="#{_text(found["title"])}"><img src="{_text(found["pictures"]["oblique"])}" alt=""/>'
        f"<div><b>{_text(found['title'])}</b><span>{model['points']:,} points from {model['views']} views</span>"
        f"<span>median distance to the true surface <b>{_um(model['median_abs_error_mm'])} µm</b></span></div></a>"
    )


def _object(name: str, found: dict[str, Any]) -> str:
    model = found["pictures"]
    return (
        f'<section id="{_text(found["title"])}"><h2>{_text(found["title"])}</h2>'
        f"<h3>Model</h3>{_gallery(model, _SHADED)}"
        f"{_gallery(model, ('registration error', 'model error', 'convergence'))}"
        f"<h3>Figures against the truth</h3>{_views(found)}{_registrations(found)}{_model(found)}"
        + "".join(_view(number, view) for number, view in enumerate(found["views"], 1))
        + f"<h3>Files</h3><p class=files>{_files(found['files'])}</p></section>"
    )


def _view(number: int, view: dict[str, Any]) -> str:
    shaded = _gallery(view["pictures"], _SHADED)
    title = f"View {number}, turned by {view['yaw_deg']:g}°"
    return f"<details><summary>{title}</summary>{_gallery(view['pictures'], _VIEW_PICTURES)}{shaded}</details>"


def _gallery(pictures: dict[str, str], names: tuple[str, ...]) -> str:
    items = "".join(
        f'<a href="{_text(pictures[n])}"><img loading="lazy" src="{_text(pictures[n])}" alt="{_text(n)}"/></a>'
        for n in names
        if n in pictures
    )
    return f'<div class="gallery">{items}</div>'


def _table(head: tuple[str, ...], rows: list[tuple[Any, ...]], name: str = "") -> str:
    cells = "".join(f"<th>{_text(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table class='{name}'><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table>"


def _views(found: dict[str, Any]) -> str:
    head = ("view", "points", "bias / µm", "scatter / µm", "predicted / µm", "scatter : predicted",
            "of the visible, lit points", "flyers > 1 mm", "retaken")  # fmt: skip
    rows = [
        (
            f"{number}: {view['yaw_deg']:g}°", f"{view['points']:,}", _um(view["bias_mm"]), _um(view["scatter_mm"]),
            _um(view.get("predicted_scatter_mm", float("nan"))), f"{view.get('scatter_ratio', float('nan')):.2f}",
            f"{view['completeness']:.2%}", view["flyers"], view["retakes"],
        )
        for number, view in enumerate(found["views"], 1)
    ]  # fmt: skip
    return _table(head, rows)


def _registrations(found: dict[str, Any]) -> str:
    head = ("registration", "ended", "rotation error / °", "error at the centre / µm", "misplacement, RMS / µm",
            "RMS / µm",
            "overlap", "iterations")  # fmt: skip
    rows = [
        (
            f"view {r['view']} → 1", "converged" if r["converged"] else f"NOT converged: {r['reason']}",
            f"{r['rotation_error_deg']:.4f}", _um(r["translation_error_mm"]), _um(r["displacement_rms_mm"]),
            _um(r["rms_mm"]), f"{r['overlap']:.0%}", r["iterations"],
        )
        for r in found["registrations"]
    ]  # fmt: skip
    return _table(head, rows, "registrations")


def _model(found: dict[str, Any]) -> str:
    model = found["model"]
    head = ("model", "bias / µm", "median distance / µm", "RMS / µm", "99 % within / µm", "beyond 1 mm")
    names = ("bias_mm", "median_abs_error_mm", "rms_error_mm", "p99_abs_error_mm")
    return _table(
        head, [(f"{model['points']:,} points", *(_um(model[n]) for n in names), f"{model['beyond_1_mm']:.3%}")]
    )


def _timings(report: dict[str, Any]) -> str:
    columns: dict[str, dict[str, float]] = {}
    for name, found in report["objects"].items():
        for number, view in enumerate(found["views"], 1):
            columns[f"{name} {number}"] = view["timings_s"]
        columns[f"{name} model"] = found["model"]["timings_s"]
    stages = list(dict.fromkeys(stage for timings in columns.values() for stage in timings))
    rows = [(stage, *(f"{t[stage]:.3f}" if stage in t else "" for t in columns.values())) for stage in stages]
    return _table(("stage / s", *columns), rows)


def _files(files: list[str]) -> str:
    return " · ".join(f'<a href="{_text(name)}">{_text(name)}</a>' for name in files)
