"""What a three-chip camera sees of coloured light, made from the definition: the truth of the colour tests."""

from __future__ import annotations

import numpy as np

from fringed.data import CameraSettings, FrameSet

MIX = np.array([[0.90, 0.08, 0.02], [0.07, 0.85, 0.08], [0.01, 0.09, 0.90]])
GREY = (1.0, 1.0, 1.0)
MILD = (1.0, 0.8, 0.65)


def light_of(pattern, u):
    """Return the light (3, *u.shape), 0 to 1, that projector column (or row) u gets of a pattern."""
    line = pattern.reshape(-1, pattern.shape[2]) / 255.0
    if len(line) == 1:
        return np.broadcast_to(line[0].reshape(3, 1, 1), (3, *np.shape(u)))
    return np.stack([np.interp(u, np.arange(len(line)), line[:, j]) for j in range(3)])


def camera_channels(light, reflectance, noise_dn=1.5, seed=0, black=2.0, gain=200.0):
    """Return (3, height, width) uint8: black + gain * MIX (reflectance * light), with noise."""
    rho = np.asarray(reflectance, float)
    rho = rho.reshape(3, 1, 1) if rho.ndim == 1 else rho
    clean = black + gain * np.einsum("cj,jhw->chw", MIX, rho * light)
    noisy = clean + np.random.default_rng(seed).normal(0, noise_dn, clean.shape) * (noise_dn > 0)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def shots(sequence, u, reflectance=GREY, noise_dn=1.5, seed_offset=0, **kwargs):
    """Return the FrameSet of an "rgb" camera that sees column (or row) u at each pixel."""
    taken, frames = {}, []
    for frame, pattern in zip(sequence.frames, sequence.patterns, strict=True):
        if frame.shot not in taken:
            light = light_of(pattern, u)
            taken[frame.shot] = camera_channels(light, reflectance, noise_dn, seed=frame.shot + seed_offset, **kwargs)
        frames.append(taken[frame.shot][("red", "green", "blue").index(frame.channel)])
    return FrameSet(np.array(frames), sequence, settings=CameraSettings(channel="rgb"))
