"""The demonstration's pictures and figures, made in a thread of their own while the rig goes on scanning.

Owns which pictures each view and each model gets.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from fringed.data import Array, FrameSet, Model, PhaseMap, RangeImage, Truth
from fringed.messages import ScanState
from fringed_client.demo import measure
from fringed_client.pictures.geometry import cloud_of
from fringed_client.protocol.flows import last_product
from fringed_client.station import Station

PAINTED_POINTS = 250_000


class Artist:
    """Fetch what was measured, measure its errors, draw it. For one thread, with a connection of its own."""

    def __init__(self, runtime: Path) -> None:
        self._runtime = runtime
        self._station: Station | None = None
        self.seconds = 0.0

    def _get(self, item_id: str) -> Any:
        if self._station is None:
            self._station = Station(self._runtime, client="demo pictures")
        return self._station.get(item_id)

    def close(self) -> None:
        """End the connection; call it in the artist's own thread."""
        if self._station is not None:
            self._station.close()
            self._station = None

    def view(self, state: ScanState, folder: Path) -> dict[str, Any]:
        """Draw one view; returns its figures, and the paths of its pictures by name."""
        from fringed_client.pictures import charts, maps, views

        began = time.perf_counter()
        frames: FrameSet = self._get(state.frame_sets["object"])
        phase: PhaseMap = self._get(last_product(state, "PhaseMap"))
        image: RangeImage = self._get(last_product(state, "RangeImage"))
        truth: Truth = self._get(last_product(state, "Truth"))
        error = np.where(image.rejected == 0, measure.ray_error_mm(image, truth), np.nan)
        drawn = {
            "fringes": maps.draw_frame(folder / "fringes.png", frames, len(frames.frames) - 1),
            "wrapped phase": maps.draw_wrapped(folder / "wrapped-phase.png", phase),
            "mask": maps.draw_mask(folder / "mask.png", image.rejected, True),
            "depth": maps.draw_depth(folder / "depth.png", image),
            "error": charts.draw_error_map(folder / "error.png", error, image.sigma_mm, "against the truth", True),
            **views.draw_views(folder, image, 520, ("x-y", "oblique")),
        }
        self.seconds += time.perf_counter() - began
        return {"figures": measure.view_figures(image, truth), "pictures": drawn}

    def model(self, model: Model, states: list[ScanState], folder: Path) -> dict[str, Any]:
        """Draw a model; returns its figures, its registrations' errors, and its pictures by name."""
        from fringed_client.pictures import convergence, views

        began = time.perf_counter()
        truths = [self._get(last_product(state, "Truth")) for state in states]
        images = [self._get(last_product(state, "RangeImage")) for state in states]
        transforms = [measure.true_transform(truths[0], truth) for truth in truths]
        chosen = measure.sample(len(model.points_mm), PAINTED_POINTS)
        points, normals = model.points_mm[chosen], model.normals[chosen]
        error = measure.true_surface(truths).distance_mm(points)
        drawn = {
            **views.draw_views(folder, model, 700),
            "registration error": _registration_error(folder / "registration-error.png", model, images, transforms),
            "model error": views.draw_painted(
                folder / "model-error.png",
                [views.Painted(points, normals, error * 1000, "model against the true surface")],
                "distance / µm", simulated=True,
            ),
            "convergence": convergence.draw_convergence(folder / "convergence.png", model.registrations, True),
        }  # fmt: skip
        self.seconds += time.perf_counter() - began
        return {
            "figures": measure.model_figures(model, error),
            "registrations": _registrations(model, images, transforms),
            "pictures": drawn,
        }


def _kept(image: RangeImage) -> Array:
    return np.asarray(image.xyz_mm[image.rejected == 0])


def _registrations(model: Model, images: list[RangeImage], true: list[Array]) -> list[dict[str, Any]]:
    """Return how each registration ended, and its error against the truth."""
    rows = []
    for number, found in enumerate(model.registrations):
        view = number + 1
        errors = measure.transform_error(model.T_model_view[view], true[view], _kept(images[view]))
        rows.append(
            {
                "view": view + 1, "converged": found.converged, "reason": found.reason, "rms_mm": found.rms_mm,
                "overlap": found.overlap, "iterations": len(found.history), **errors,
            }
        )  # fmt: skip
    return rows


def _registration_error(path: Path, model: Model, images: list[RangeImage], true: list[Array]) -> Path:
    """Paint how far registration puts each view's points from where they belong."""
    from fringed_client.pictures import views

    painted = []
    for view, image in enumerate(images[1:], 1):
        own, normals, _ = cloud_of(np.ascontiguousarray(image.xyz_mm[::2, ::2]))
        estimated = model.T_model_view[view]
        error = np.linalg.norm(measure.displacement(estimated, true[view], own), axis=1) * 1000
        placed = own @ estimated[:3, :3].T + estimated[:3, 3]
        turned = normals @ estimated[:3, :3].T
        painted.append(views.Painted(placed, turned, error, f"misplacement of view {view + 1}"))
    return views.draw_painted(path, painted, "distance from the true place / µm", signed=False, simulated=True)
