"""A calibration and its views as a solver would leave them: exact projections with known residuals."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from fringed.boards import Board, points_mm
from fringed.config import simulated_station
from fringed.data import BoardView, Provenance, ViewFit
from fringed.simulation import optics
from fringed_client.calibration.folders import true_pose
from fringed_client.calibration.poses import plan

BOARD = Board()
_LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
NUMBERS = (
    *(f"{lens}.{name}" for lens in ("camera", "projector") for name in _LENS),
    *(f"stereo.{name}" for name in ("rx", "ry", "rz", "tx", "ty", "tz")),
)


def example(count: int = 6, missed: int = 1):
    """Return a Calibration and its BoardViews: `count` found and `missed` not."""
    config = simulated_station().simulation
    simulation = msgspec.to_builtins(config)
    exact = optics.exact_calibration(config, "simulated-1234")
    random, origin = np.random.default_rng(3), Provenance(simulated=True, created="2026-11-27T16:00:00+00:00")
    views, fits = [], []
    for number, pose in enumerate(plan(count)):
        transform = true_pose(pose.name, BOARD, simulation)
        points = points_mm(BOARD) @ transform[:3, :3].T + transform[:3, 3]
        camera = optics.project(exact.camera, points)
        projector = optics.project(exact.projector, points @ exact.T_projector_camera[:3, :3].T
                                   + exact.T_projector_camera[:3, 3])  # fmt: skip
        off = random.normal(0, 0.02, (2, len(points), 2))
        off[1, 4] = np.nan
        used = np.ones(len(points), np.uint8)
        used[7] = 0
        note = "its board has another pitch (19.2 mm instead of 20 mm)" if number == count - 1 and count > 5 else ""
        views.append(BoardView(
            msgspec.to_builtins(BOARD), (1392, 1040), (1024, 768), True, index=np.arange(len(points), dtype=np.int32),
            camera_px=camera, camera_sigma_px=np.full(len(points), 0.02), projector_px=projector,
            projector_sigma_px=np.full((len(points), 2), 0.03), projector_jacobian=np.zeros((len(points), 2, 2)),
            quality={"tilt_deg": pose.tilt_deg, "blur_px": 0.8}, picture=np.full((520, 696), 120, np.uint8),
            picture_step=2, name=pose.name, id=f"view-{number}", provenance=origin,
        ))  # fmt: skip
        fits.append(ViewFit(f"view-{number}", transform, camera, off[0], projector, off[1], used, pose.name, note))
    for number in range(missed):
        views.append(BoardView(
            msgspec.to_builtins(BOARD), (1392, 1040), (1024, 768), False, name=f"pose-{count + number + 1:02d}",
            reason="blurred: edges of 4.2 px, at most 2.5", id=f"missed-{number}", provenance=origin,
            picture=np.full((520, 696), 90, np.uint8), picture_step=2,
        ))  # fmt: skip
    sizes = np.array([0.2, 0.2, 0.3, 0.3, 1e-3, 4e-3, 5e-5, 5e-5, 0, 0.4, 0.4, 0.6, 0.6, 2e-3, 8e-3, 1e-4, 1e-4, 0,
                      2e-5, 2e-5, 1e-5, 0.02, 0.02, 0.05])  # fmt: skip
    found = replace(
        exact, id="20261127T160000.000000Z-abcd", source="calibrated", views=tuple(fits), parameters=NUMBERS,
        covariance=np.diag(sizes**2), camera_falloff=np.array([-0.15]), projector_falloff=np.array([-0.12, -0.03]),
        residuals={"camera_rms_px": 0.028, "projector_rms_px": 0.04, "coverage": 0.83, "tilt_spread_deg": 38.0},
        notes=("A wrong overall pitch cannot be seen from images: verify on a known length.",), provenance=origin,
    )  # fmt: skip
    return found, views
