"""What a registration did, seen: both views before and after, how far they are apart, what was matched.

Owns these pictures. Takes the two range images and the registration that joins them; the only mathematics is the
distance that is shown.
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb

from fringed.data import Array, RangeImage, Registration
from fringed_client.pictures.figures import DPI, FAINT, INK, colour_bar, figure, save, titled
from fringed_client.pictures.layers import Layer, composed, draw_layers, layer_of
from fringed_client.pictures.partners import partners_of
from fringed_client.pictures.shading import VIEWS
from fringed_client.pictures.views import show

REFERENCE, MODEL, UNMATCHED = to_rgb("#4f9fdc"), to_rgb("#f0a028"), "#9a9a94"
MAP_PX = 520


def draw_registration(
    path: Path, reference: RangeImage, model: RangeImage, registration: Registration, before: bool = True
) -> Path:
    """Draw both views along X-Y, Y-Z, X-Z and obliquely, in two colours, before (as recorded) and after.

    All in the reference's frame and at one scale. Where both surfaces are one, their colours mix in patches.
    """
    fixed, moving = layer_of(reference, np.array(REFERENCE)), layer_of(model, np.array(MODEL))
    rows = {"before": [fixed, moving]} if before else {}
    rows["after"] = [fixed, moving.moved(registration.T_reference_model)]
    legend = {f"reference {reference.id}".strip(): REFERENCE, f"model {model.id}".strip(): MODEL}
    return draw_layers(path, rows, list(VIEWS.values()), _told(registration), legend, _simulated(reference, model))


def draw_error_map(path: Path, reference: RangeImage, model: RangeImage, registration: Registration) -> Path:
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
    picture = composed([Layer(found.points_mm, found.normals, painted)], view, MAP_PX)
    height, width = picture.rgb.shape[:2]
    drawn = figure(width / DPI + 5.2, max(height / DPI, 3.2) + 1.2)
    left, right = drawn.subplots(1, 2, width_ratios=(width / DPI + 1.0, 3.6))
    show(left, picture, view)
    titled(left, "model on the reference", _simulated(reference, model), narrow=True)
    colour_bar(drawn, ScalarMappable(norm, colours), left, f"distance, towards the camera positive / {unit}", "both")
    _distribution(right, away * factor, top * factor, unit)
    share = len(away) / max(len(found.partner), 1)
    right.set_xlabel(f"distance / {unit}\n\n" + _statistics(away, share, top, factor, unit), fontsize=9, color=INK)
    drawn.suptitle(_told(registration, 90), x=0.012, ha="left", fontsize=10.5, color=INK)
    return save(drawn, path, 240)


def _limit(away: Array) -> float:
    """Return 1, 2 or 5 times a power of ten that 98 % of the distances are within."""
    top = float(np.percentile(np.abs(away), 98)) if len(away) else 1.0
    power = 10.0 ** np.floor(np.log10(max(top, 1e-9)))
    return float(power * min(digit for digit in (1, 2, 5, 10) if digit * power >= 0.999 * top))


def _distribution(axes: Any, away: Array, top: float, unit: str) -> None:
    counts, edges = np.histogram(away, np.linspace(-top, top, 81))
    middle = 0.5 * (edges[1:] + edges[:-1])
    axes.bar(middle, counts, edges[1] - edges[0], color=colormaps["RdBu_r"](0.5 + 0.5 * middle / top),
             edgecolor=FAINT, linewidth=0.25)  # fmt: skip
    axes.axvline(0, color=FAINT, linewidth=0.6)
    axes.set_xlim(-top, top)
    axes.set_yticks([])
    titled(axes, "how many points", False)


def _statistics(away: Array, share: float, top: float, factor: float, unit: str) -> str:
    """Return RMS, median, robust spread and what is not shown, in words."""
    told = f"{len(away):,} points, {share:.1%} of the model's, have a partner"
    if not len(away):
        return told
    middle = float(np.median(away))
    spread = 1.4826 * float(np.median(np.abs(away - middle)))
    rms = float(np.sqrt(np.mean(away**2)))
    beyond = float(np.mean(np.abs(away) > top))
    return (
        f"{told}\nRMS {rms * factor:.3g} {unit}\nmedian {middle * factor:+.3g} {unit}\n"
        f"robust spread {spread * factor:.3g} {unit} (1.4826 MAD)\n{beyond:.1%} lie beyond the scale"
    )


def _told(found: Registration, wide: int = 1000) -> str:
    ended = "converged" if found.converged else "NOT converged"
    told = f"registration {ended}; {found.overlap:.0%} overlap, {found.rms_mm:.3g} mm RMS"
    return "\n".join(textwrap.wrap(told if found.converged else f"{told}: {found.reason}", wide))


def _simulated(reference: RangeImage, model: RangeImage) -> bool:
    return reference.provenance.simulated or model.provenance.simulated
