"""The neighbours' test, against counting by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed_plugins.phase.neighbours import DISCONTINUITY, ISOLATED, drop_strays


def by_hand(phase, modulation, rejected, limits):
    tolerance, least, glow = limits
    flags = rejected.copy()
    height, width = phase.shape
    for y in range(height):
        for x in range(width):
            if rejected[y, x]:
                continue
            window = phase[max(0, y - 2) : y + 3, max(0, x - 2) : x + 3]
            near = slice(max(0, y - 1), y + 2), slice(max(0, x - 1), x + 2)
            if (np.abs(window - phase[y, x]) < tolerance).sum() - 1 < least:
                flags[y, x] |= ISOLATED
            if np.isnan(phase[near]).any() and modulation[y, x] < glow * modulation[near].max():
                flags[y, x] |= DISCONTINUITY
    return flags


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1), height=st.integers(1, 12), width=st.integers(1, 90),
    holes=st.sampled_from([0.0, 0.01, 0.2, 0.9]), strays=st.sampled_from([0.0, 0.02, 0.5]),
    least=st.sampled_from([0, 4, 6, 8, 9, 24]), glow=st.sampled_from([0.0, 0.4]),
)  # fmt: skip
def test_strays_and_glow_are_those_that_counting_by_hand_finds(seed, height, width, holes, strays, least, glow):
    rng = np.random.default_rng(seed)
    phase = rng.normal(0, 0.3, (height, width)) + 7.0 * (rng.random((height, width)) < strays)
    phase = phase.astype(np.float32)
    rejected = np.where(rng.random(phase.shape) < holes, 2, 0).astype(np.uint16)
    phase[rejected > 0] = np.nan
    modulation = rng.uniform(1, 100, phase.shape).astype(np.float32)
    limits = (np.pi, least, glow)
    wanted = by_hand(phase, modulation, rejected, (np.float32(np.pi), least, np.float32(glow)))
    for threads in (1, 2):
        got_phase, got = phase.copy(), rejected.copy()
        drop_strays(got_phase, modulation, got, limits, threads)
        assert np.array_equal(got, wanted)
        assert np.array_equal(np.isnan(got_phase), wanted > 0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (2, 3)])
def test_tiny_images_are_taken(shape):
    phase, rejected = np.zeros(shape, np.float32), np.zeros(shape, np.uint16)
    drop_strays(phase, np.ones(shape, np.float32), rejected, (3.0, 0, 0.4))
    assert not rejected.any()
