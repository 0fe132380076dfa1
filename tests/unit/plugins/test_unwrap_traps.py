"""What has frozen, crashed or misled other unwrappers: every method, on inputs that are known."""

from __future__ import annotations

import numpy as np
import pytest
from fringe_truth import wrapped
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from fringed_plugins.unwrap.branch_cut import unwrap_branch_cut
from fringed_plugins.unwrap.least_squares import unwrap_least_squares
from fringed_plugins.unwrap.spatial import unwrap

METHODS = {
    "quality-guided": unwrap,
    "branch-cut": unwrap_branch_cut,
    "least-squares": unwrap_least_squares,
}
every_method = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())


def grid(height, width):
    return np.mgrid[0:height, 0:width].astype(float)


def orders_off(got, truth):
    """Return the fraction of known pixels whose multiple of 2 pi differs from that of most."""
    turns = np.round((got - truth) / (2 * np.pi))
    known = np.isfinite(turns)
    return float(np.mean(turns[known] != np.median(turns[known])))


def is_congruent(got, phase):
    known = np.isfinite(got)
    turns = (got[known] - phase[known]) / (2 * np.pi)
    return bool(np.abs(turns - np.round(turns)).max(initial=0) < 1e-5)


@every_method
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_smooth_surface_keeps_its_type_and_is_exact(method, dtype):
    y, x = grid(60, 80)
    truth = 30 * np.exp(-((x - 40) ** 2 + (y - 30) ** 2) / 400) + x / 9
    result = method(wrapped(truth).astype(dtype))
    assert result.phase_rad.dtype == dtype
    error = result.phase_rad - truth
    assert np.ptp(error) < (1e-5 if dtype == np.float32 else 1e-12)  # rounding at 30 rad
    assert result.sizes == (60 * 80,)


@every_method
@pytest.mark.parametrize("shape", [(1, 1), (1, 200), (200, 1), (2, 2), (3, 2)])
def test_thin_pictures(method, shape):
    truth = np.cumsum(np.full(shape, 0.9), axis=int(np.argmax(shape)))
    result = method(wrapped(truth))
    assert orders_off(result.phase_rad, truth) == 0
    assert abs(np.median(result.phase_rad)) <= np.pi + 0.9


@every_method
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nothing_known_gives_nothing(method, value):
    result = method(np.full((9, 12), value))
    assert result.sizes == ()
    assert np.isnan(result.phase_rad).all()
    assert not result.regions.any()


@every_method
def test_unknown_pixels_stay_out_and_harm_nobody(method):
    y, x = grid(70, 90)
    truth = (x * 0.5) + 0.002 * (y - 30) ** 2
    phase = wrapped(truth)
    phase[20:35, 30:50] = np.nan
    phase[50, 3], phase[51, 3] = np.inf, -np.inf
    result = method(phase)
    assert np.array_equal(np.isnan(result.phase_rad), ~np.isfinite(phase))
    assert orders_off(result.phase_rad, truth) == 0


@every_method
def test_islands_are_numbered_by_size_and_each_is_right_by_itself(method):
    y, x = grid(60, 90)
    truth = 0.7 * x + 0.3 * y
    phase = wrapped(truth)
    phase[:, 30] = np.nan
    phase[30, 30:] = np.nan
    result = method(phase)
    assert result.sizes == (1800, 59 * 30, 59 * 29)
    assert list(np.bincount(result.regions.ravel())[1:]) == list(result.sizes)
    for number in (1, 2, 3):
        inside = result.regions == number
        assert orders_off(result.phase_rad[inside], truth[inside]) == 0
        assert abs(np.median(result.phase_rad[inside])) <= np.pi + 0.7


@every_method
def test_ring_is_one_region(method):
    y, x = grid(80, 80)
    radius = np.hypot(x - 40, y - 40)
    truth = 0.4 * x - 0.2 * y
    phase = np.where((radius > 15) & (radius < 35), wrapped(truth), np.nan)
    result = method(phase)
    assert len(result.sizes) == 1
    assert orders_off(result.phase_rad, truth) == 0


@every_method
def test_dipole_is_cut_between_its_residues(method):
    """Two opposite vortices four pixels apart: the phase is right but for a few pixels between them."""
    y, x = grid(60, 60)
    truth = 0.15 * x
    vortices = np.arctan2(y - 29.5, x - 27.5) - np.arctan2(y - 29.5, x - 31.5)
    result = method(wrapped(truth + vortices))
    assert is_congruent(result.phase_rad, wrapped(truth + vortices))
    far = np.hypot(x - 29.5, y - 29.5) > 10
    assert orders_off(result.phase_rad[far], (truth + wrapped(vortices))[far]) == 0


@every_method
def test_single_vortex_ends_with_a_seam_and_no_more(method):
    y, x = grid(60, 60)
    phase = np.arctan2(y - 29.5, x - 29.5)
    result = method(phase)
    assert is_congruent(result.phase_rad, phase)
    assert sum(result.sizes) >= 60 * 60 - 120


@every_method
def test_sheared_surface_wrong_only_in_whole_turns(method):
    """A fault that opens from 0 to 2.5 periods: no spatial method can know; what it returns still fits the data."""
    y, x = grid(60, 80)
    truth = 0.1 * x + np.where(y > 30, 0.2 * x, 0)
    result = method(wrapped(truth))
    assert is_congruent(result.phase_rad, wrapped(truth))


@every_method
def test_box_higher_than_a_fringe_is_wrong_by_whole_periods(method):
    """The documented limit: a box 1.3 periods high looks 0.3 periods high."""
    truth = np.zeros((60, 80))
    truth[20:40, 30:50] = 1.3 * 2 * np.pi
    result = method(wrapped(truth))
    assert result.phase_rad[30, 40] - result.phase_rad[5, 5] == pytest.approx(0.3 * 2 * np.pi, abs=1e-5)


@every_method
def test_constant_stays(method):
    result = method(np.full((20, 30), 1.25, np.float32))
    assert (result.phase_rad == np.float32(1.25)).all()


@every_method
def test_plain_noise_ends_and_fits_the_data(method):
    phase = np.random.default_rng(1).uniform(-np.pi, np.pi, (150, 170))
    result = method(phase)
    assert is_congruent(result.phase_rad, phase)
    assert np.isfinite(result.phase_rad).mean() > 0.85


@every_method
def test_memory_layout_changes_nothing_and_the_input_stays(method):
    y, x = grid(40, 50)
    phase = wrapped(0.3 * x + 0.01 * y * y).astype(np.float32)
    phase.flags.writeable = False
    want = method(phase)
    wide = np.zeros((80, 50), np.float32)
    wide[::2] = phase
    backwards = np.ascontiguousarray(phase[::-1])[::-1]
    for same in (np.asfortranarray(phase), wide[::2], backwards, phase.astype(">f4")):
        before = same.copy()
        assert np.array_equal(method(same).phase_rad, want.phase_rad)
        assert np.array_equal(same, before)


@every_method
@pytest.mark.parametrize("noise_rad", [0.02, 0.9])
def test_result_does_not_depend_on_the_number_of_threads(method, noise_rad):
    y, x = grid(90, 70)
    noise = np.random.default_rng(3).normal(0, noise_rad, x.shape)
    noisy = wrapped(0.2 * x + 0.01 * y * y + noise).astype(np.float32)
    noisy[40:50, 20:30] = np.nan
    one, many = method(noisy, threads=1), method(noisy, threads=4)
    assert np.array_equal(one.phase_rad, many.phase_rad, equal_nan=True)
    assert np.array_equal(one.regions, many.regions)


@every_method
@pytest.mark.parametrize("bad", [np.full((4, 5), 9.0), np.zeros(7), np.zeros((0, 4)), np.zeros((2, 3, 4))])
def test_what_is_no_wrapped_phase_is_refused(method, bad):
    with pytest.raises(ValueError, match=r"wrap it first|expected \(height, width\)"):
        method(bad)


pictures = arrays.arrays(
    np.float32,
    arrays.array_shapes(min_dims=2, max_dims=2, max_side=12),
    elements=st.one_of(
        st.floats(-3.140625, 3.140625, width=32), st.sampled_from([np.nan, np.inf, 0.0, 3.1415927, -3.1415927])
    ),
)


@pytest.mark.parametrize("method", [unwrap, unwrap_branch_cut])
@settings(max_examples=150, deadline=None)
@given(phase=pictures)
def test_any_input_comes_back_plus_whole_turns(method, phase):
    result = method(phase, threads=1)
    assert is_congruent(result.phase_rad, phase)
    if method is unwrap:
        assert np.array_equal(np.isnan(result.phase_rad), ~np.isfinite(phase))
    known = result.regions > 0
    assert np.array_equal(np.isfinite(result.phase_rad), known)
    assert sum(result.sizes) == known.sum()
