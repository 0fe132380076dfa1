"""A projector with a gamma and a lens out of focus, in a few lines of its own: the truth for compensation tests."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from fringed.data import CameraSettings, FrameSet


def gamma_curve(gamma=2.2):
    """Return the light (256,) of each grey level."""
    return (np.arange(256) / 255.0) ** gamma


def seen(sequence, u, sigma_px, curve, settings=None, offset=20.0, gain=180.0, noise_dn=0.0, seed=0):
    """Return the FrameSet (uint16 with 16 bits, noise in 8-bit levels) of a camera whose pixels see columns `u`.

    Each projector pixel is a box of light `curve[grey]`, blurred by a Gaussian of `sigma_px` (an array like u).
    """
    rng = np.random.default_rng(seed)
    near = np.rint(u).astype(int)[..., None] + np.arange(-8, 9)
    edges = (near[..., None] + np.array([-0.5, 0.5]) - u[..., None, None]) / np.asarray(sigma_px)[..., None, None]
    weight = np.diff(ndtr(edges), axis=-1)[..., 0]
    frames = []
    for pattern in sequence.patterns:
        line = np.broadcast_to(pattern.max(axis=2), (1, sequence.width_px))[0]
        light = (weight * curve[line][np.clip(near, 0, sequence.width_px - 1)]).sum(axis=-1)
        frame = offset + gain * light + noise_dn * rng.standard_normal(u.shape)
        frames.append(np.clip(np.rint(257 * frame), 0, 65535).astype(np.uint16))
    return FrameSet(np.array(frames), sequence, settings=settings or CameraSettings(bits=16))


def field(height=90, width=320, first=90.0, last=930.0, sigmas=(1.0, 2.2)):
    """Return columns (height, width) and a blur that grows from top to bottom."""
    u = np.linspace(first, last, width) + np.linspace(0, 7, height)[:, None]
    return u, np.broadcast_to(np.linspace(*sigmas, height)[:, None], u.shape)


def harmonics(gamma, count=12):
    """Return B_k / B_1 of ((1 + cos t) / 2)^gamma: B_k / B_(k-1) = (gamma - k + 1) / (gamma + k)."""
    found = [1.0, 1.0]
    for k in range(2, count + 1):
        found.append(found[-1] * (gamma - k + 1) / (gamma + k))
    return np.array(found)
