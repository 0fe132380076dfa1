"""What a registration did, seen: both views before and after, how far they are apart, what was matched.

Owns these pictures. Takes the two views, range images or models, and the registration that joins them; the only
mathematics is the distance that is shown.
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_hex, to_rgb
from matplotlib.patches import Patch

from fringed.data import Array, Registration
from fringed_client.pictures.figures import DPI, FAINT, INK, PAPER, colour_bar, figure, labelled, save, titled
from fringed_client.pictures.layers import Layer, Surface, composed, draw_layers, layer_of, moved
from fringed_client.pictures.partners import partners_of
from fringed_client.pictures.shading import VIEWS
from fringed_client.pictures.views import show

REFERENCE, MODEL, UNMATCHED = to_rgb("#4f9fdc"), to_rgb("#f0a028"), "#6e6e69"
MAP_PX, PAIR_PX = 520, 900
GAP = 0.2  # between the views, of the wider one


def draw_registration(
    path: Path, reference: Surface, model: Surface, registration: Registration, before: bool = True
) -> Path:
    """Draw both views along X-Y, Y-Z, X-Z and obliquely, in two colours, before (as recorded) and after.

    All in the reference's frame and at one scale. Where both surfaces are one, their colours mix in patches.
    """
    fixed, moving = layer_of(reference, np.array(REFERENCE)), layer_of(model, np.array(MODEL))
    rows = {"before": [fixed, moving]} if before else {}
    rows["after"] = [fixed, moving.moved(registration.T_reference_model)]
    told = _told(registration)
    simulated = _simulated(reference, model)
    return draw_layers(path, rows, list(VIEWS.values()), told, _legend(reference, model), simulated)


def draw_error_map(path: Path, reference: Surface, model: Surface, registration: Registration) -> Path:
    """Draw how far the model's points are from the reference's surface: as colours on it, and how they are distributed.

    Positive is in front of the reference, towards its camera. Points that nothing lies behind are grey. Both views'
    noise is in it.
    """
    found = partners_of(reference, model, registration.T_reference_model)
    away = found.distance_mm[found.partner]
    top = _limit(away)
    factor, unit = (1000.0, "µm") if top < 0.5 else (1.0, "mm")
    norm, colours = Normalize(-top * factor, top * factor), colormaps["RdBu_r"]
    painted = np.where(
        found.partner[:, None], colours(norm(np.nan_to_num(found.distance_mm) * factor))[:, :3], to_rgb(UNMATCHED)
    )
    view = VIEWS["x-y"]
    picture = composed([Layer(found.points_mm, found.normals, painted)], view, MAP_PX, flat=0.4)
    height, width = picture.rgb.shape[:2]
    drawn = figure(width / DPI + 5.2, max(height / DPI, 3.2) + 1.2)
    left, right = drawn.subplots(1, 2, width_ratios=(width / DPI + 1.0, 3.6))
    show(left, picture, view)
    titled(left, "model on the reference", _simulated(reference, model), narrow=True)
    colour_bar(drawn, ScalarMappable(norm, colours), left, f"distance, towards the camera positive / {unit}", "both")
    _distribution(right, away * factor, top * factor, unit)
    share = len(away) / max(len(found.partner), 1)
    labelled(right, f"distance / {unit}", "")
    right.text(0, -0.15, _statistics(away, share, top, factor, unit), transform=right.transAxes, va="top", fontsize=9,
               color=INK, linespacing=1.35)  # fmt: skip
    if share < 1:
        grey = Patch(facecolor=UNMATCHED, label=f"no partner: {len(found.partner) - len(away):,} points")
        left.legend(handles=[grey], loc="upper left", bbox_to_anchor=(0, -0.12), fontsize=8.5, frameon=False,
                    labelcolor=INK, borderaxespad=0)  # fmt: skip
    drawn.suptitle(_told(registration, 90), x=0.012, ha="left", fontsize=10.5, color=INK)
    return save(drawn, path, 256, rare=True)


def draw_correspondences(
    path: Path,
    reference: Surface,
    model: Surface,
    registration: Registration,
    start: Array | None = None,
    most: int = 150,
) -> Path:
    """Draw lines between matched points: at most `most` points of the model and the reference's nearest to each.

    They are nearest after the registration; the model is shown where it started, `start` (4, 4) or as recorded, and
    put aside to the right. Lines that cross or jump tell of wrong matches.
    """
    found = partners_of(reference, model, registration.T_reference_model)
    fixed, moving = layer_of(reference, np.array(_pale(REFERENCE))), layer_of(model, np.array(_pale(MODEL)))
    view = VIEWS["x-y"]
    before = np.eye(4) if start is None else np.asarray(start, np.float64)
    back = _aside(fixed, moving.moved(before)) @ before
    matched = np.flatnonzero(found.partner)
    chosen = np.random.default_rng(0).choice(matched, min(most, len(matched)), replace=False)
    ends = found.nearest_mm[chosen]
    starts = moved(found.points_mm[chosen], back @ np.linalg.inv(registration.T_reference_model))
    picture = composed([fixed, moving.moved(back)], view, PAIR_PX)
    height, width = picture.rgb.shape[:2]
    drawn = figure(width / DPI + 0.8, height / DPI + 1.1)
    axes = drawn.add_subplot()
    show(axes, picture, view)
    order = np.argsort(ends[:, 1])
    lines = LineCollection(
        [line[:, :2] for line in np.stack([ends, starts], axis=1)[order]], linewidths=0.8,
        colors=colormaps["plasma"](np.linspace(0, 0.66, max(len(order), 1))),
    )  # fmt: skip
    axes.add_collection(lines, autolim=False)
    for points in (ends, starts):
        axes.plot(*points[:, :2].T, "o", color=INK, markersize=1.8, linestyle="none")
    titled(axes, f"{len(chosen):,} of {len(matched):,} matched points, {_ended(registration)}", False)
    labelled(axes, "x / mm (the model is moved aside)", "y / mm")
    _signed(drawn, axes, reference, model)
    return save(drawn, path, 240)


def _aside(fixed: Layer, moving: Layer) -> Array:
    """Return the shift along x that puts one layer to the right of another."""
    low, high = (np.percentile(layer.points_mm[:, 0], (0.1, 99.9)) for layer in (fixed, moving))
    T = np.eye(4)
    T[0, 3] = low[1] - high[0] + GAP * max(low[1] - low[0], high[1] - high[0])
    return T


def _pale(colour: tuple[float, float, float]) -> tuple[float, float, float]:
    red, green, blue = (0.45 * part + 0.55 for part in colour)
    return red, green, blue


def _signed(drawn: Any, axes: Any, reference: Surface, model: Surface) -> None:
    """Say which colour is which view, and that a rig was simulated."""
    names = {name: _pale(colour) for name, colour in _legend(reference, model).items()}
    marks = [Patch(edgecolor=FAINT, linewidth=0.4, facecolor=to_hex(c), label=n) for n, c in names.items()]
    drawn.legend(handles=marks, loc="outside lower left", fontsize=8.5, frameon=False, labelcolor=INK, ncols=2)
    titled(axes, axes.get_title("left"), _simulated(reference, model))


def _legend(reference: Surface, model: Surface) -> dict[str, Any]:
    return {f"reference {reference.id}".strip(): REFERENCE, f"model {model.id}".strip(): MODEL}


def _limit(away: Array) -> float:
    """Return a round number that 98 % of the distances are within."""
    top = float(np.percentile(np.abs(away), 98)) if len(away) else 1.0
    power = 10.0 ** np.floor(np.log10(max(top, 1e-9)))
    return float(power * min(digit for digit in (1, 1.5, 2, 3, 5, 7, 10) if digit * power >= 0.999 * top))


def _distribution(axes: Any, away: Array, top: float, unit: str) -> None:
    counts, edges = np.histogram(away, np.linspace(-top, top, 81))
    middle = 0.5 * (edges[1:] + edges[:-1])
    axes.bar(middle, counts, edges[1] - edges[0], color=colormaps["RdBu_r"](0.5 + 0.5 * middle / top),
             edgecolor=FAINT, linewidth=0.25)  # fmt: skip
    axes.axvline(0, color=FAINT, linewidth=0.6)
    axes.set_xlim(-top, top)
    axes.set_yticks([])
    axes.set_facecolor(PAPER)
    titled(axes, "how many points", False)


def _statistics(away: Array, share: float, top: float, factor: float, unit: str) -> str:
    """Return RMS, median, robust spread and what is not shown, in words."""
    told = f"{len(away):,} points have a partner, {share:.1%} of the model's"
    if not len(away):
        return told
    middle = float(np.median(away))
    spread = 1.4826 * float(np.median(np.abs(away - middle)))
    rms = float(np.sqrt(np.mean(away**2)))
    beyond = float(np.mean(np.abs(away) > top))
    return (
        f"{told}\nRMS {rms * factor:.3g} {unit}, median {middle * factor:+.3g} {unit}\n"
        f"robust spread (1.4826 MAD) {spread * factor:.3g} {unit}\n{beyond:.1%} lie beyond the scale"
    )


def _told(found: Registration, wide: int = 1000) -> str:
    told = f"registration {_ended(found)}; {found.overlap:.0%} overlap, {found.rms_mm:.3g} mm RMS"
    return "\n".join(textwrap.wrap(told if found.converged else f"{told}: {found.reason}", wide))


def _ended(found: Registration) -> str:
    return "converged" if found.converged else "NOT converged"


def _simulated(reference: Surface, model: Surface) -> bool:
    return reference.provenance.simulated or model.provenance.simulated
