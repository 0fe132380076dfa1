"""What a calibration is worth, drawn: residual vectors, coverage, tilts, expected trueness, falloff.

Owns how these are shown; computes none but what a picture needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fringed.data import Array, BoardView, Calibration, Lens, ViewFit
from fringed.errors import UsageError
from fringed_client.pictures.figures import ACCENT, FAINT, INK, PAPER, colour_bar, figure, labelled, save, titled

_BLUE, _GRID = "#2e6f95", "#d9d9d4"
_COLUMNS, _ROWS = 4, 3
_RINGS_DEG = (10, 20, 30, 40, 50)
_ARROW = 0.045  # of the picture's width: how long the RMS residual is drawn


def draw_all(found: Calibration, folder: Path) -> list[Path]:
    """Draw residuals, falloff and tone curve, as far as a calibration has them."""
    from fringed_client.pictures.tone import draw_tone

    drawn = [draw_calibration(folder / "calibration.png", found)]
    if found.views and found.tone_curve is not None:
        drawn.append(draw_tone(folder / "tone.png", found, found.provenance.simulated))
    if found.camera_falloff is not None or found.projector_falloff is not None:
        drawn.append(draw_falloff(folder / "falloff.png", found))
    return drawn


def draw_calibration(path: Path, found: Calibration) -> Path:
    """Draw what tells most: the residuals of its poses, else the tone curve.

    Raises
    ------
    UsageError
        it has neither.
    """
    from fringed_client.pictures.tone import draw_tone

    if found.views:
        return draw_residuals(path, found, found.views, "all poses")
    if found.tone_curve is not None:
        return draw_tone(path, found, found.provenance.simulated)
    raise UsageError("this calibration has no poses and no tone curve, so there is nothing to draw")


def draw_residuals(path: Path, found: Calibration, fits: Sequence[ViewFit], title: str) -> Path:
    """Draw the residual vectors of views in the camera's and the projector's picture, exaggerated as it says."""
    drawn = figure(11.0, 4.6)
    axes = drawn.subplots(1, 2)
    for one, lens, name in ((axes[0], found.camera, "camera"), (axes[1], found.projector, "projector")):
        at = [np.asarray(getattr(fit, f"{name}_px")).reshape(-1, 2) for fit in fits]
        off = [np.asarray(getattr(fit, f"{name}_residual_px")).reshape(-1, 2) for fit in fits]
        used = [np.asarray(fit.used, bool) & (fit.note == "") for fit in fits]
        _vectors(one, lens, *(np.concatenate(parts) for parts in (at, off, used)))
        titled(one, f"{title}, {name}", found.provenance.simulated and name == "projector")
    return save(drawn, path)


def _vectors(axes: Any, lens: Lens, at: Array, off: Array, used: Array) -> None:
    _frame(axes, lens.width_px, lens.height_px)
    known = np.isfinite(off).all(axis=1) & np.isfinite(at).all(axis=1)
    good, bad = known & used, known & ~used
    if not known.any():
        axes.text(0.5, 0.5, "no residuals", transform=axes.transAxes, ha="center", color=FAINT)
        return
    chosen = off[good] if good.any() else off[known]
    rms = max(float(np.sqrt(np.mean(np.sum(chosen**2, axis=1)))), 1e-9)
    scale = _round(_ARROW * lens.width_px / rms)
    for which, colour in ((good, _BLUE), (bad, ACCENT)):
        axes.quiver(*at[which].T, *off[which].T, angles="xy", scale_units="xy", scale=1 / scale, width=0.0022,
                    color=colour)  # fmt: skip
    left = f", {int(bad.sum())} left out (red)" if bad.any() else ""
    text = f"drawn {scale:,.0f} times larger; RMS {rms:.3f} px, {int(good.sum())} points{left}"
    axes.set_xlabel(text, fontsize=8.5, color=INK)


def _round(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten near a value."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-9)))
    return float(power * min((1, 2, 5, 10), key=lambda digit: abs(value / power - digit)))


def _frame(axes: Any, width: int, height: int) -> None:
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_facecolor(PAPER)


def draw_coverage(path: Path, views: Sequence[BoardView], found: Calibration | None = None) -> Path:
    """Draw where in the camera's picture points were seen, and beside it which way the board was tilted."""
    drawn = figure(11.0, 4.6)
    left, right = drawn.subplots(1, 2, width_ratios=(1.35, 1))
    simulated = any(view.provenance.simulated for view in views)
    width, height = views[0].camera_size_px if views else (4, 3)
    _frame(left, width, height)
    for number, view in enumerate(views):
        left.scatter(
            view.camera_px[:, 0],
            view.camera_px[:, 1],
            s=5,
            color=_colour(number, len(views)),
            linewidths=0,
            label=view.name,
        )
    for part in range(1, _COLUMNS):
        left.axvline(part * width / _COLUMNS - 0.5, color=_GRID, linewidth=0.7, zorder=0)
    for part in range(1, _ROWS):
        left.axhline(part * height / _ROWS - 0.5, color=_GRID, linewidth=0.7, zorder=0)
    titled(left, "points in the camera's picture, by pose", False)
    labelled(left, "column / px", "row / px")
    _tilts(right, found, len(views), simulated)
    return save(drawn, path)


def _tilts(axes: Any, found: Calibration | None, count: int, simulated: bool) -> None:
    """Draw each pose as the direction that the board faced and how far; larger marks were nearer."""
    from matplotlib.patches import Circle

    fits = [(number, fit) for number, fit in enumerate(found.views if found is not None else ()) if not fit.note]
    depths = [fit.T_camera_board[2, 3] for _, fit in fits]
    for ring in _RINGS_DEG:
        axes.add_patch(Circle((0, 0), ring, fill=False, color=_GRID, linewidth=0.7))
        axes.text(0.71 * ring, 0.71 * ring, f"{ring}°", fontsize=7, color=FAINT)
    for number, fit in fits:
        normal = -fit.T_camera_board[:3, 2]
        tilt = np.rad2deg(np.arccos(np.clip(-normal[2], -1, 1)))
        at = tilt * normal[:2] / max(float(np.hypot(*normal[:2])), 1e-9)
        near = (max(depths) - fit.T_camera_board[2, 3]) / max(max(depths) - min(depths), 1e-9)
        axes.scatter(*at, s=30 + 90 * near, color=_colour(number, count), linewidths=0, zorder=3)
        axes.annotate((fit.name or str(number + 1)).rpartition("-")[2], at, fontsize=7, color=INK,
                      textcoords="offset points", xytext=(6, 4))  # fmt: skip
    most = max(_RINGS_DEG) + 2
    axes.set_xlim(-most, most)
    axes.set_ylim(most, -most)
    axes.set_aspect("equal")
    axes.axhline(0, color=_GRID, linewidth=0.5, zorder=0)
    axes.axvline(0, color=_GRID, linewidth=0.5, zorder=0)
    titled(axes, "where the board faced (larger: nearer)", simulated)
    labelled(axes, "faced left / right / degrees", "faced up / down / degrees")


def _colour(number: int, count: int) -> Any:
    from matplotlib import colormaps

    return colormaps["viridis"](number / max(count - 1, 1) * 0.92)


def draw_trueness(path: Path, table: Mapping[str, Any], simulated: bool) -> Path:
    """Draw the deviation of points that a calibration leaves, over the picture, at each depth."""
    depths, (width, height) = table["depths_mm"], table["size_px"]
    grids = [np.array(grid, float) * 1000 for grid in table["sigma_mm"]]
    top = max((float(np.nanmax(grid)) for grid in grids if np.isfinite(grid).any()), default=1.0)
    drawn = figure(11.0, 3.3)
    axes = np.atleast_1d(drawn.subplots(1, len(grids)))
    for one, depth, grid in zip(axes, depths, grids, strict=True):
        shown = one.imshow(grid, cmap="viridis", vmin=0, vmax=top, extent=(-0.5, width - 0.5, height - 0.5, -0.5),
                           interpolation="bilinear")  # fmt: skip
        titled(one, f"at {depth:.0f} mm: {np.sqrt(np.nanmean(grid**2)):.0f} µm RMS", simulated, narrow=True)
        labelled(one, "column / px", "row / px" if one is axes[0] else "")
    colour_bar(drawn, shown, list(axes), "deviation of points / µm")
    return save(drawn, path)


def draw_falloff(path: Path, found: Calibration) -> Path:
    """Draw the light of both lenses from the middle of the picture to its corners."""
    drawn = figure(6.4, 4.0)
    axes = drawn.add_subplot()
    radius = np.linspace(0, 1, 101)
    curves = (("camera", found.camera_falloff, _BLUE), ("projector", found.projector_falloff, ACCENT))
    for name, powers, colour in curves:
        if powers is not None and len(powers):
            light = 1 + sum(c * radius ** (2 * (i + 1)) for i, c in enumerate(powers))
            axes.plot(radius, light, color=colour, linewidth=1.6, label=f"{name}: {light[-1]:.0%} at the corners")
    axes.set_ylim(0, 1.1)
    axes.grid(True, linewidth=0.3, color=_GRID)
    axes.legend(fontsize=8, frameon=False, loc="lower left", labelcolor=INK)
    titled(axes, "falloff of both lenses", found.provenance.simulated)
    labelled(axes, "distance from the picture's centre over half its diagonal", "light over that of the centre")
    return save(drawn, path)
