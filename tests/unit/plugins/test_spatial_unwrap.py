"""Spatial unwrapping against surfaces that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fringe_truth import columns, run, seen, wrapped

from fringed.data import Reject
from fringed.errors import DataError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.decoders.unwrapping import UnwrapDifference
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder
from fringed_plugins.unwrap.spatial import unwrap


def hill(height=120, width=160, top=40.0):
    y, x = np.mgrid[0:height, 0:width]
    return top * np.exp(-(((x - width / 2) / 40) ** 2 + ((y - height / 2) / 30) ** 2)) + x / 10


def orders_off(got, truth):
    """Return the fraction of pixels whose multiple of 2 pi differs from that of most."""
    turns = np.round((got - truth) / (2 * np.pi))
    known = np.isfinite(turns)
    return float(np.mean(turns[known] != np.median(turns[known])))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_smooth_surface_is_exact(dtype):
    result = unwrap(wrapped(hill()).astype(dtype))
    assert orders_off(result.phase_rad, hill()) == 0
    error = result.phase_rad - hill()
    assert np.ptp(error) < 2e-5  # float32 at 40 rad
    assert result.sizes == (120 * 160,)


def test_noise_of_half_a_radian_changes_no_order():
    noisy = hill(top=10.0) + np.random.default_rng(1).normal(0, 0.5, (120, 160))
    assert orders_off(unwrap(wrapped(noisy)).phase_rad, noisy) < 0.001


def test_unreliable_strip_does_not_spread_its_error():
    truth, quality = hill(), np.full((120, 160), 50.0)
    phase = truth.copy()
    phase[58:62, 20:140] = np.random.default_rng(2).uniform(-np.pi, np.pi, (4, 120))
    quality[58:62, 20:140] = 1.0
    outside = np.ones(truth.shape, bool)
    outside[56:64, 18:142] = False
    assert orders_off(unwrap(wrapped(phase), quality).phase_rad[outside], truth[outside]) == 0


def test_masked_pixels_stay_out_and_separate_regions():
    phase = wrapped(hill())
    phase[:, 70:73] = np.nan
    phase[5, 5] = np.inf
    result = unwrap(phase)
    assert result.sizes == (120 * 87, 120 * 70 - 1)  # 160 - 73 columns on the right, the largest
    assert np.isnan(result.phase_rad[:, 71]).all() and np.isnan(result.phase_rad[5, 5])
    assert (result.regions[:, 100] == 1).all() and (result.regions[10:, 0] == 2).all()
    assert orders_off(result.phase_rad[:, :70], hill()[:, :70]) == 0
    for number in (1, 2):
        assert abs(np.median(result.phase_rad[result.regions == number])) <= np.pi + 1e-5


def test_everything_masked_gives_nothing_and_no_crash():
    result = unwrap(np.full((10, 12), np.nan))
    assert result.sizes == ()
    assert np.isnan(result.phase_rad).all()
    assert not result.regions.any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2)])
def test_thin_pictures_are_unwrapped(shape):
    truth = np.arange(np.prod(shape), dtype=float).reshape(shape)
    assert orders_off(unwrap(wrapped(truth)).phase_rad, truth) == 0


def test_small_regions_are_dropped_on_demand():
    phase = np.zeros((20, 20))
    phase[:, 10] = np.nan
    phase[5, :10] = np.nan
    result = unwrap(phase, min_region_px=60)
    assert result.sizes == (180, 140)
    assert np.isnan(result.phase_rad[2, 2])


def test_arrays_of_other_shapes_are_refused():
    with pytest.raises(ValueError, match="both must be"):
        unwrap(np.zeros((4, 4)), np.ones((4, 5)))


def frames(u, seed, **params):
    encoder = PhaseShiftEncoder()
    return seen(encoder.encode(encoder.Params(**params), ProjectorTarget(1024, 768)), u, 1.0, seed, gain=0.8)


def test_difference_is_object_minus_reference_and_near_zero_on_the_plane():
    u = columns(200, 150, 100, 900)
    bump = np.zeros_like(u)
    bump[40:110, 60:150] = 60 * np.outer(np.hanning(70), np.hanning(90))
    reference, body = frames(u, 1), frames(u + bump, 2)
    difference = run(
        UnwrapDifference,
        {
            "reference": run(PhaseShiftDecoder, {"frames": reference}),
            "object": run(PhaseShiftDecoder, {"frames": body}),
        },
    )
    truth = 2 * np.pi * bump * 48 / 1024
    assert difference.kind == "relative"
    assert np.abs(difference.phase_rad - truth).max() < 0.15  # two times 0.01 rad of noise, at five sigma
    assert np.median(difference.sigma_rad) == pytest.approx(np.std(difference.phase_rad - truth), rel=0.25)


def test_specks_are_flagged_as_isolated():
    u = columns(60, 40, 100, 400)
    reference, body = run(PhaseShiftDecoder, {"frames": frames(u, 1)}), frames(u, 2)
    dark = body.frames.copy()
    dark[:, :, 20] = 0
    dark[:, 10, 20:] = 0
    dark[:, :10, 40] = 0
    speckled = run(PhaseShiftDecoder, {"frames": replace(body, frames=dark)}, min_similar_neighbours=0)
    result = run(UnwrapDifference, {"reference": reference, "object": speckled}, min_region_px=250)
    assert (result.rejected[:10, 21:40] == Reject.ISOLATED).all()
    assert (result.rejected[20:, 30:] == 0).all()


def test_only_wrapped_phases_of_the_same_fringes_are_taken():
    u = columns(60, 40, 100, 400)
    one = run(PhaseShiftDecoder, {"frames": frames(u, 1)})
    other = run(PhaseShiftDecoder, {"frames": frames(u, 1, periods=32.0)})
    encoder = MultiFrequencyEncoder()
    sequence = encoder.encode(encoder.Params(), ProjectorTarget(1024, 768))
    absolute = run(MultiFrequencyDecoder, {"frames": seen(sequence, u, gain=0.8)})
    with pytest.raises(DataError, match="must be the same"):
        run(UnwrapDifference, {"reference": one, "object": other})
    with pytest.raises(DataError, match="is absolute"):
        run(UnwrapDifference, {"reference": one, "object": absolute})
