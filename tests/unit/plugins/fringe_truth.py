"""Fringes made directly from the definition, independent of the plug-ins: the truth that tests compare with."""

from __future__ import annotations

import numpy as np

from fringed.config.simulated import SimulationConfig
from fringed.data import Calibration, CameraSettings, FrameSet, Lens
from fringed.testing import RecordingContext


def intensities(u, period_px, steps, background=120.0, modulation=90.0, initial_rad=0.0):
    """Return (steps, *u.shape): A + B cos(2 pi u / period + initial + 2 pi k / steps)."""
    shifts = 2 * np.pi * np.arange(steps) / steps
    phase = 2 * np.pi * np.asarray(u, float) / period_px + initial_rad
    return background + modulation * np.cos(phase[None] + shifts.reshape(-1, *[1] * np.ndim(u)))


def columns(width, height, first, last):
    """Return projector columns (height, width) that rise from `first` to `last`."""
    return np.linspace(first, last, width) + np.zeros((height, 1))


def seen(sequence, u, noise_dn=0.0, seed=0, tone=None, settings=None, gain=1.0, dtype=np.uint8):
    """Return the FrameSet of a camera that sees column `u` (or row) at each pixel."""
    rng = np.random.default_rng(seed)
    grid = np.arange(max(sequence.patterns[0].shape[:2]))
    frames = []
    for pattern in sequence.patterns:
        grey = pattern.max(axis=2).ravel()
        light = grey.astype(float) if tone is None else 255 * tone[grey]
        frame = gain * np.interp(u, grid, light) + rng.normal(0, noise_dn, np.shape(u)) * (noise_dn > 0)
        frames.append(np.clip(np.rint(frame), 0, np.iinfo(dtype).max))
    return FrameSet(np.array(frames).astype(dtype), sequence, settings=settings or CameraSettings())


def wrapped(angle):
    """Return the angle in (-pi, pi]."""
    return np.angle(np.exp(1j * np.asarray(angle, float)))


def run(processor, inputs, **params):
    """Run a processor."""
    return processor().run(inputs, processor.Params(**params), RecordingContext())


def small_rig(width=160, height=120, projector=(256, 192), distortion=True, plane_mm=1000.0):
    """Return a calibration of a rig that sees 400 mm at 1000 mm, its projector 280 mm to the right."""
    geometry = SimulationConfig().geometry
    focal, throw = width * 1000.0 / 400.0, float(np.hypot(1000.0, 280.0))
    focal_p = projector[0] * throw / 470.0
    axis = np.array([-280.0, 0.0, 1000.0]) / throw
    transform = np.eye(4)
    transform[:3, :3] = np.stack([[axis[2], 0.0, -axis[0]], [0.0, 1.0, 0.0], axis])
    transform[:3, 3] = -transform[:3, :3] @ [280.0, 0.0, 0.0]
    none = np.zeros(5)
    return Calibration(
        camera=Lens(
            width, height,
            np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]),
            np.array(geometry.camera_distortion) if distortion else none,
        ),
        projector=Lens(
            *projector,
            np.array([[focal_p, 0, (projector[0] - 1) / 2], [0, focal_p, (projector[1] - 1) / 2], [0, 0, 1]]),
            np.array(geometry.projector_distortion) if distortion else none,
        ),
        T_projector_camera=transform,
        rig="test",
        source="exact-simulated",
        reference_plane=np.array([0.0, 0.0, -1.0, -plane_mm]),
    )  # fmt: skip


def distorted(lens, xy):
    """Return pixels (..., 2) of normalised coordinates, by Brown's formula."""
    k1, k2, p1, p2, k3 = lens.distortion
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([lens.matrix[0, 0] * xd + lens.matrix[0, 2], lens.matrix[1, 1] * yd + lens.matrix[1, 2]], -1)


def rays(lens):
    """Return x and y at z = 1 (height, width, 2) of every pixel, by plain fixed-point iteration."""
    pixel = np.stack(np.meshgrid(np.arange(lens.width_px), np.arange(lens.height_px)), -1).astype(float)
    wanted = (pixel - lens.matrix[:2, 2]) / np.diag(lens.matrix)[:2]
    xy = wanted.copy()
    for _ in range(60):
        off = (distorted(lens, xy) - lens.matrix[:2, 2]) / np.diag(lens.matrix)[:2] - wanted
        xy -= off
    return xy


def points(calibration, depth_mm):
    """Return the points (height, width, 3) at `depth_mm` on every camera ray."""
    xy = rays(calibration.camera)
    depth = np.broadcast_to(depth_mm, xy.shape[:2])[..., None]
    return np.concatenate([xy * depth, depth], axis=-1)


def projector_pixels(calibration, xyz):
    """Return column and row (..., 2) of points in the camera's frame."""
    transform = calibration.T_projector_camera
    local = xyz @ transform[:3, :3].T + transform[:3, 3]
    return distorted(calibration.projector, local[..., :2] / local[..., 2:])
