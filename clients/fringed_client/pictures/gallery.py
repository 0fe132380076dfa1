"""All the pictures that suit an object, and the one that tells most.

Owns the choice; the drawing is in the modules beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fringed.data import (
    BoardView,
    Calibration,
    FrameSet,
    Mesh,
    Model,
    PhaseMap,
    RangeImage,
    Registration,
    Truth,
    Verification,
)
from fringed.errors import UsageError
from fringed_client.pictures import boards, calibration, convergence, maps, models, registration, verification, views
from fringed_client.pictures.layers import Surface

DRAWN = "FrameSet, PhaseMap, BoardView, Calibration, Verification, RangeImage, Model, Registration and Truth"


def draw_all(content: Any, folder: Path, pair: tuple[Surface, Surface] | None = None) -> list[Path]:
    """Draw everything that suits an object into `folder`; returns the pictures' paths.

    `pair` are the reference and the model of a Registration, where they are known: both are drawn with it.

    Raises
    ------
    UsageError
        there are no pictures of this type.
    """
    if isinstance(content, FrameSet):
        last = len(content.frames) - 1
        return [maps.draw_frame(folder / f"frame-{i:02d}.png", content, i) for i in sorted({0, last // 2, last})]
    if isinstance(content, PhaseMap):
        drawn = [maps.draw_wrapped(folder / "wrapped-phase.png", content)]
        if content.kind != "wrapped":
            drawn.append(maps.draw_phase(folder / "phase.png", content))
        drawn.append(maps.draw_modulation(folder / "modulation.png", content))
        drawn.append(maps.draw_mask(folder / "mask.png", content.rejected, content.provenance.simulated))
        sigma = maps.draw_phase_sigma(folder / "sigma.png", content)
        confidence = maps.draw_confidence(folder / "confidence.png", content)
        return [*drawn, *(path for path in (sigma, confidence) if path)]
    if isinstance(content, RangeImage):
        sigma = maps.draw_sigma(folder / "sigma.png", content)
        mask = maps.draw_mask(folder / "mask.png", content.rejected, content.provenance.simulated)
        drawn = [maps.draw_depth(folder / "depth.png", content), mask, *([sigma] if sigma else [])]
        return [*drawn, *views.draw_views(folder, content).values()]
    if isinstance(content, Model):
        drawn = list(views.draw_views(folder, content).values())
        if content.view_index is not None:
            drawn.append(models.draw_model(folder / "views.png", content))
        if content.registrations:
            path = folder / "convergence.png"
            drawn.append(convergence.draw_convergence(path, content.registrations, content.provenance.simulated))
        return drawn
    if isinstance(content, Calibration):
        return calibration.draw_all(content, folder)
    if isinstance(content, Registration) and pair is not None:
        return [
            draw_main(content, folder / "registration.png"),
            registration.draw_registration(folder / "views.png", *pair, content),
            registration.draw_error_map(folder / "error.png", *pair, content),
            registration.draw_correspondences(folder / "correspondences.png", *pair, content),
        ]
    return [draw_main(content, folder / f"{type(content).__name__.lower()}.png")]


def draw_main(content: Any, path: Path) -> Path:
    """Draw the picture that tells most of an object.

    Raises
    ------
    UsageError
        there is no picture of this type.
    """
    drawers: dict[type, Callable[[], Path]] = {
        FrameSet: lambda: maps.draw_frame(path, content, len(content.frames) - 1),
        PhaseMap: lambda: (maps.draw_wrapped if content.kind == "wrapped" else maps.draw_phase)(path, content),
        BoardView: lambda: boards.draw_board_view(path, content),
        RangeImage: lambda: maps.draw_depth(path, content),
        Calibration: lambda: calibration.draw_calibration(path, content),
        Verification: lambda: verification.draw_verification(path, content),
        Model: lambda: views.draw_view(path, content, "oblique"),
        Registration: lambda: convergence.draw_convergence(path, [content], content.provenance.simulated),
        Truth: lambda: maps.draw_map(
            path, content.xyz_mm[..., 2], "truth", "z / mm", colours="viridis_r", simulated=True
        ),
    }
    if type(content) not in drawers:
        hint = "; export it and look at it in a mesh viewer" if isinstance(content, Mesh) else ""
        raise UsageError(f"there is no picture of a {type(content).__name__}; there are pictures of {DRAWN}{hint}")
    return drawers[type(content)]()
