"""The tables of a calibration's report, as text: headline, parameters, poses, advice.

Owns their words and digits; knows no HTML.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any

import numpy as np

from fringed.data import BoardView, Calibration, ViewFit
from fringed_client.calibration.figures import baseline_mm, cells, coverage_words, number, sigmas

Table = tuple[Sequence[str], Sequence[Sequence[Any]], str]
_TILT_SPREAD_DEG = 20.0
_DISTORTION = ("k1", "k2", "p1", "p2", "k3")


def made(found: Calibration, poses: int) -> str:
    """Return how the calibration came about."""
    when = found.provenance.created[:19].replace("T", " ")
    used = sum(not fit.note for fit in found.views)
    return f"From {used} of {poses} poses of a board" + (f", {when} UTC" if when else "")


def headline(found: Calibration, trueness: Mapping[str, Any] | None) -> dict[str, str]:
    """Return the figures that tell most, by what they are."""
    figures, told = found.residuals, {}
    for name, words in (("camera", "reprojection, camera"), ("projector", "reprojection, projector")):
        if f"{name}_rms_px" in figures:
            told[f"{words}, RMS"] = f"{figures[f'{name}_rms_px']:.3f} px"
    if trueness is not None:
        grids = np.array(trueness["sigma_mm"], float) * 1000
        told["expected trueness, RMS over the volume"] = f"{np.sqrt(np.nanmean(grids**2)):.0f} µm"
        told["expected trueness, worst corner"] = f"{np.nanmax(grids):.0f} µm"
    if "coverage" in figures:
        told["of the camera's picture covered"] = f"{figures['coverage']:.0%}"
    if "tilt_spread_deg" in figures:
        told["spread of the board's tilts"] = f"{figures['tilt_spread_deg']:.0f}°"
    length = number(baseline_mm(found), baseline_sigma(found)).partition(" ± ")
    known = f", ± {length[2]} mm" if length[2] else ""
    told[f"from camera to projector{known}"] = f"{length[0]} mm"
    return told


def baseline_sigma(found: Calibration) -> float | None:
    """Return the standard deviation of the distance: the covariance of the translation along it."""
    names = [f"stereo.t{axis}" for axis in "xyz"]
    if found.covariance is None or not set(names) <= set(found.parameters):
        return None
    places = [found.parameters.index(name) for name in names]
    along = found.T_projector_camera[:3, 3] / max(baseline_mm(found), 1e-12)
    variance = along @ found.covariance[np.ix_(places, places)] @ along
    return float(np.sqrt(np.maximum(variance, 0.0)))


def parameters(found: Calibration) -> Table:
    """Return every parameter with its unit and standard deviation."""
    known = sigmas(found)
    rows: list[tuple[str, str, str, str]] = []
    for name, lens in (("camera", found.camera), ("projector", found.projector)):
        k = lens.matrix
        for key, value in zip(("fx", "fy", "cx", "cy"), (k[0, 0], k[1, 1], k[0, 2], k[1, 2]), strict=True):
            rows.append(_row(f"{name} {key}", float(value), known.get(f"{name}.{key}"), "px"))
        for key, value in zip(_DISTORTION, lens.distortion, strict=True):
            sigma = known.get(f"{name}.{key}")
            rows.append(_row(f"{name} {key}", value, sigma, "held at 0" if value == 0 and not sigma else ""))
    rotation, shift = found.T_projector_camera[:3, :3], found.T_projector_camera[:3, 3]
    for axis, angle in zip("xyz", np.rad2deg(_rotation_vector(rotation)), strict=True):
        known_deg = degrees(known[f"stereo.r{axis}"]) if f"stereo.r{axis}" in known else None
        rows.append(_row(f"turn about {axis}", angle, known_deg, "°"))
    for axis, length in zip("xyz", shift, strict=True):
        rows.append(_row(f"projector from camera, {axis}", length, known.get(f"stereo.t{axis}"), "mm"))
    return ("parameter", "value", "σ", "unit"), rows, ""


def _row(name: str, value: float, sigma: float | None, unit: str) -> tuple[str, str, str, str]:
    text = number(value, sigma).partition(" ± ")
    return name, text[0], text[2] or "–", unit


def _rotation_vector(rotation: Any) -> Any:
    """Return the rotation's axis times its angle (3,), rad."""
    angle = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return skew / 2 if angle < 1e-9 else skew * angle / (2 * np.sin(angle))


def poses(views: Sequence[BoardView], found: Calibration) -> Table:
    """Return a line for each pose: what was seen, how it fits, what was said."""
    fits = {fit.view: fit for fit in found.views}
    rows = []
    for view in views:
        fit, quality = fits.get(view.id), view.quality
        said = view.reason or (fit.note if fit is not None else "") or "; ".join(view.problems)
        fit = None if fit is not None and fit.note else fit  # one that is left out has no pose of its own
        tilt = _tilt_deg(fit) if fit is not None else quality.get("tilt_deg")
        rows.append((
            view.name or view.id, len(view.index), _rms(fit, "camera"), _rms(fit, "projector"), _of(tilt, ".0f"),
            _of(fit.T_camera_board[2, 3] if fit is not None else None, ".0f"), _of(quality.get("blur_px"), ".2f"), said,
        ))  # fmt: skip
    head = ("pose", "points", "camera RMS / px", "projector RMS / px", "tilt / °", "distance / mm", "blur / px", "")
    return head, rows, "text"


def _rms(fit: ViewFit | None, which: str) -> str:
    if fit is None:
        return "–"
    off = getattr(fit, f"{which}_residual_px")
    known = off[np.isfinite(off).all(axis=1) & (fit.used > 0)] if len(off) else off
    return f"{np.sqrt(np.mean(np.sum(known**2, axis=1))):.3f}" if len(known) else "–"


def _tilt_deg(fit: ViewFit) -> float:
    return float(np.rad2deg(np.arccos(np.clip(fit.T_camera_board[2, 2], -1, 1))))


def _of(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def advice(found: Calibration, views: Sequence[BoardView]) -> list[str]:
    """Return what would make the calibration better, as far as the poses themselves tell."""
    good = [view for view in views if view.found]
    told = []
    if good and (cells(good) == 0).any():
        told.append(f"{coverage_words(good)}. Take a pose there.")
    missed = [view.name for view in views if not view.found]
    if missed:
        told.append(f"The board was not found in {', '.join(missed)}; the reasons are below, take them again.")
    if found.residuals.get("tilt_spread_deg", 90.0) < _TILT_SPREAD_DEG:
        told.append("The board faced nearly the same way in all poses; tilt it by 20 to 40 degrees in all directions.")
    if found.temperature_c is None:
        told.append("The temperature was not given; with it (--temperature) later drift can be told from warmth.")
    return told
