"""Where camera and projector stand and what their lenses do: the rig's exact calibration.

Owns lenses and frames; knows nothing of scenes and light. The camera is the origin, x to the right, y down,
z away. The projector stands at x = `baseline_mm`; both axes meet at `working_distance_mm`.
"""

from __future__ import annotations

import numpy as np

from fringed.config.simulated import SimulationConfig
from fringed.data import Array, Calibration, Float64Array, Lens
from fringed.simulation.tone import tone_curve


def camera_lens(config: SimulationConfig) -> Lens:
    """Return the lens that sees `field_mm` across at the working distance."""
    geometry, sensor = config.geometry, config.sensor
    focal_px = sensor.width_px * geometry.working_distance_mm / geometry.field_mm
    return _lens(sensor.width_px, sensor.height_px, focal_px, geometry.camera_distortion)


def projector_lens(config: SimulationConfig) -> Lens:
    """Return the lens that lights `projector_field_mm` across where the axes meet."""
    geometry, optics = config.geometry, config.projector
    focal_px = optics.width_px * throw_mm(config) / geometry.projector_field_mm
    return _lens(optics.width_px, optics.height_px, focal_px, geometry.projector_distortion)


def throw_mm(config: SimulationConfig) -> float:
    """Return the distance from the projector to the point where the axes meet; it is focused there."""
    return float(np.hypot(config.geometry.working_distance_mm, config.geometry.baseline_mm))


def T_projector_camera(config: SimulationConfig) -> Float64Array:
    """Return the (4, 4) transform that takes camera points to the projector's frame."""
    centre = np.array([config.geometry.baseline_mm, 0.0, 0.0])
    axis = np.array([-config.geometry.baseline_mm, 0.0, config.geometry.working_distance_mm]) / throw_mm(config)
    right = np.array([axis[2], 0.0, -axis[0]])
    transform = np.eye(4)
    transform[:3, :3] = np.stack([right, [0.0, 1.0, 0.0], axis])
    transform[:3, 3] = -transform[:3, :3] @ centre
    return transform


def exact_calibration(config: SimulationConfig, rig: str) -> Calibration:
    """Return the calibration that describes the simulated rig without error.

    The reference plane faces the camera at the configured scene's `backdrop_distance_mm`.
    """
    return Calibration(
        camera=camera_lens(config),
        projector=projector_lens(config),
        T_projector_camera=T_projector_camera(config),
        rig=rig,
        source="exact-simulated",
        reference_plane=np.array([0.0, 0.0, -1.0, -config.scene.backdrop_distance_mm]),
        tone_curve=tone_curve(config.projector),
    )


def _lens(width_px: int, height_px: int, focal_px: float, distortion: tuple[float, ...]) -> Lens:
    matrix = np.array(
        [[focal_px, 0.0, (width_px - 1) / 2], [0.0, focal_px, (height_px - 1) / 2], [0.0, 0.0, 1.0]]
    )  # fmt: skip
    return Lens(width_px, height_px, matrix, np.array(distortion, dtype=np.float64))


def distort(lens: Lens, x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Apply Brown's distortion to normalised coordinates."""
    k1, k2, p1, p2, k3 = lens.distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def project(lens: Lens, points_mm: Array) -> Float64Array:
    """Return the pixels (..., 2), column and row, of points (..., 3) in the lens's own frame."""
    points = np.asarray(points_mm, dtype=np.float64)
    x, y = distort(lens, points[..., 0] / points[..., 2], points[..., 1] / points[..., 2])
    matrix = lens.matrix
    return np.stack([matrix[0, 0] * x + matrix[0, 2], matrix[1, 1] * y + matrix[1, 2]], axis=-1)


def packed(lens: Lens) -> Float64Array:
    """Return the lens as kernels take it: fx, fy, cx, cy, k1, k2, p1, p2, k3, width, height."""
    matrix = lens.matrix
    head = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    return np.array([*head, *lens.distortion, lens.width_px, lens.height_px], dtype=np.float64)
