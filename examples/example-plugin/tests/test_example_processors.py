"""Checks of the example's processors, as a third party would write them."""

from __future__ import annotations

import numpy as np
import pytest
from example_plugin import CarreDecoder, TrimmedIcp
from example_plugin.carre import carre

from fringed.data import FrameSet, PatternFrame, PatternSequence, RangeImage


@pytest.fixture
def frame_set():
    shifts = np.pi / 2 * np.arange(4)
    frames = tuple(
        PatternFrame("sinusoidal", period_px=16.0, shift_rad=float(s), step=k, steps=4) for k, s in enumerate(shifts)
    )
    sequence = PatternSequence("phase-shift", 64, 8, frames, (np.zeros((1, 64, 1), np.uint8),) * 4)
    phase = 2 * np.pi * (np.arange(64) + 0.3) / 16 + np.zeros((8, 1))
    return FrameSet(np.array([np.rint(120 + 100 * np.cos(phase + s)) for s in shifts], np.uint8), sequence)


def view(transform=None, part=slice(None)):
    y, x = np.mgrid[0:60, 0:80].astype(float)
    z = 5 * np.exp(-(((x - 30) / 15) ** 2) - ((y - 25) / 12) ** 2) + 3 * np.sin(x / 9) * np.cos(y / 7)
    xyz = np.stack([x, y, z], axis=-1)[:, part]
    if transform is not None:
        xyz = xyz @ transform[:3, :3].T + transform[:3, 3]
    shape = xyz.shape[:2]
    return RangeImage(xyz.astype(np.float32), np.zeros(shape, np.uint8), np.zeros(shape, np.uint8))


def pose(degrees, shift):
    turn = np.deg2rad(degrees)
    transform = np.eye(4)
    transform[1:3, 1:3] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    transform[:3, 3] = shift
    return transform


def test_carre_keeps_the_contract_and_finds_the_phase(plugin_contract, frame_set):
    product = plugin_contract.processor(CarreDecoder, {"frames": frame_set})
    expected = 2 * np.pi * (np.arange(64) + 0.3) / 16
    assert np.nanmax(np.abs(np.angle(np.exp(1j * (product.phase_rad - expected))))) < 0.02


@pytest.mark.parametrize("step", [1.0, 1.4, np.pi / 2, 2.0])
def test_carre_needs_no_knowledge_of_the_step(step):
    phase = np.linspace(-3.1, 3.1, 201)[None, :]
    frames = np.array([100 + 50 * np.cos(phase + step * (k - 1.5)) for k in range(4)])
    got, modulation, background = carre(frames)
    assert np.abs(np.angle(np.exp(1j * (got - phase)))).max() < 1e-6
    assert np.allclose(modulation, 50) and np.allclose(background, 100)


def test_trimmed_icp_keeps_the_contract(plugin_contract):
    inputs = {"reference": view(), "model": view(pose(1.0, (0.2, -0.1, 0.3)))}
    plugin_contract.processor(TrimmedIcp, inputs, {"points": 500, "iterations": 5})


def test_trimmed_icp_brings_a_partial_view_back(plugin_contract):
    moved = pose(4.0, (0.2, -0.1, 1.5))
    model = view(np.linalg.inv(moved), slice(0, 60))
    result = TrimmedIcp().run(
        {"reference": view(), "model": model}, TrimmedIcp.Params(overlap=0.9, iterations=300), _Context()
    )
    assert result.converged
    points = model.xyz_mm.reshape(-1, 3)
    off = points @ (result.T_reference_model - moved)[:3, :3].T + (result.T_reference_model - moved)[:3, 3]
    # Point to point slides hardly along a smooth surface, the known weakness; across it, it is exact.
    assert np.abs(off[:, 2]).max() < 0.1
    assert np.linalg.norm(off, axis=1).max() < 0.5  # half of the points' distance


class _Context:
    threads = 1

    def progress(self, fraction, text=""):
        pass

    def check_cancelled(self):
        pass

    def log(self, level, text):
        pass
