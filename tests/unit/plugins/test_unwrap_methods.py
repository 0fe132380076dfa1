"""Branch cuts, least squares, and the processors that offer them."""

from __future__ import annotations

import numpy as np
import pytest
from fringe_truth import columns, wrapped

from fringed.data import PhaseMap, Reject
from fringed.errors import Cancelled, DataError
from fringed.testing import RecordingContext
from fringed_plugins.decoders.unwrapping import Unwrap, UnwrapDifference
from fringed_plugins.unwrap.branch_cut import unwrap_branch_cut
from fringed_plugins.unwrap.least_squares import Limits, unwrap_least_squares


def orders_off(got, truth):
    """Return the fraction of known pixels whose multiple of 2 pi differs from that of most."""
    turns = np.round((got - truth) / (2 * np.pi))
    known = np.isfinite(turns)
    return float(np.mean(turns[known] != np.median(turns[known])))


def slope(height=80, width=100):
    y, x = np.mgrid[0:height, 0:width].astype(float)
    return 0.25 * x + 6 * np.exp(-((x - 50) ** 2 + (y - 40) ** 2) / 300)


def residues(phase):
    """Count the corners around which wrapped differences add up to a turn, from the definition."""
    a, b, c, d = phase[:-1, :-1], phase[:-1, 1:], phase[1:, 1:], phase[1:, :-1]
    total = wrapped(b - a) + wrapped(c - b) + wrapped(d - c) + wrapped(a - d)
    return int(np.sum(np.abs(total) > 1))


def test_branch_cut_counts_the_residues():
    phase = wrapped(slope() + np.random.default_rng(1).normal(0, 0.9, (80, 100))).astype(np.float32)
    result = unwrap_branch_cut(phase)
    assert result.residues == residues(phase.astype(float)) > 50
    assert result.charged == 0


def test_branch_cut_keeps_noise_local():
    truth = slope() + np.random.default_rng(2).normal(0, 0.6, (80, 100))
    assert residues(wrapped(truth)) > 2
    result = unwrap_branch_cut(wrapped(truth))
    assert result.sizes[0] > 0.99 * truth.size
    assert orders_off(result.phase_rad, truth) < 0.002


def test_branch_cut_does_not_cross_a_fault_between_residues():
    """A fault that opens to 1.5 periods and closes: its residues are joined, and beyond it nothing is wrong."""
    y, x = np.mgrid[0:200, 0:220].astype(float)
    opening = 3 * np.pi * np.clip(1 - np.abs(x - 110) / 40, 0, 1)
    truth = 0.1 * x + np.where(y > 100, opening * np.clip((150 - y) / 50, 0, 1), 0)
    assert residues(wrapped(truth)) == 2
    result = unwrap_branch_cut(wrapped(truth))
    assert result.residues == 2
    assert orders_off(result.phase_rad, truth) == 0


def test_branch_cut_says_when_charges_find_no_balance():
    y, x = np.mgrid[0:80, 0:80]
    vortex = np.arctan2(y - 39.5, x - 39.5)
    assert unwrap_branch_cut(vortex, longest_cut_px=10).charged == 1
    assert unwrap_branch_cut(vortex, longest_cut_px=80).charged == 0


def test_branch_cut_reports_what_it_cuts_off_as_a_region_apart():
    """A ring of random phase: the disc inside may be enclosed by cuts, and then it touches nothing."""
    y, x = np.mgrid[0:120, 0:120]
    radius = np.hypot(x - 60, y - 60)
    rng = np.random.default_rng(4)
    phase = np.where(np.abs(radius - 35) < 5, rng.uniform(-np.pi, np.pi, x.shape), wrapped(0.1 * x))
    result = unwrap_branch_cut(phase)
    for a, b in ((result.regions[:, :-1], result.regions[:, 1:]), (result.regions[:-1], result.regions[1:])):
        assert not ((a != b) & (a > 0) & (b > 0)).any()
    outside = radius > 42
    assert orders_off(result.phase_rad[outside], (0.1 * x)[outside]) == 0


def test_least_squares_without_congruence_is_the_smooth_solution():
    truth = slope() + np.random.default_rng(3).normal(0, 0.3, (80, 100))
    assert residues(wrapped(truth)) == 0
    smooth = unwrap_least_squares(wrapped(truth), congruent=False)
    assert smooth.converged
    error = smooth.phase_rad - truth
    assert np.ptp(error) < 0.01  # without residues the solution is the phase itself, to the residual of 1e-4


def test_least_squares_weighs_by_quality():
    """A strip of random phase: with weights the rest is fitted as if the strip were not there."""
    truth, quality = slope(), np.full((80, 100), 50.0)
    phase = wrapped(truth)
    phase[:, 40:44] = np.random.default_rng(5).uniform(-np.pi, np.pi, (80, 4))
    phase[70:, 40:44] = wrapped(truth)[70:, 40:44]
    quality[:70, 40:44] = 0.0
    result = unwrap_least_squares(phase, quality, limits=Limits(1e-6))
    assert result.converged
    clean = quality > 0
    assert orders_off(result.phase_rad[clean], truth[clean]) == 0
    plain = unwrap_least_squares(phase, congruent=False).phase_rad
    assert np.ptp((plain - truth)[clean]) > 1  # so the weights did it


def test_least_squares_that_do_not_converge_say_so():
    phase = wrapped(slope())
    phase[20:60, 50] = np.nan
    result = unwrap_least_squares(phase, limits=Limits(1e-9, 2))
    assert not result.converged
    assert "2 iterations" in result.reason
    assert result.iterations == 2 and result.residual > 1e-9


def phase_map(phase, kind="wrapped", modulation=50.0, **others):
    phase = phase.astype(np.float32)
    full = np.full(phase.shape, modulation, np.float32)
    rejected = np.where(np.isfinite(phase), 0, Reject.LOW_MODULATION).astype(np.uint16)
    return PhaseMap(phase, full, full, rejected, kind, 16.0, **others)


def run(processor, inputs, context=None, **params):
    return processor().run(inputs, processor.Params(**params), context or RecordingContext())


methods = pytest.mark.parametrize("method", ["quality-guided", "branch-cut", "least-squares"])


@methods
def test_wrapped_map_becomes_a_relative_one(method):
    truth = slope()
    source = phase_map(wrapped(truth), sigma_rad=np.full((80, 100), 0.02, np.float32), projector_px=1024)
    result = run(Unwrap, {"phase": source}, method=method)
    assert result.kind == "relative"
    assert orders_off(result.phase_rad, truth) == 0
    assert np.array_equal(result.wrapped_rad, source.phase_rad)
    assert (result.period_px, result.projector_px) == (16.0, 1024)
    assert np.array_equal(result.sigma_rad, source.sigma_rad)


@methods
def test_small_regions_are_flagged_and_the_regions_logged(method):
    phase = wrapped(slope())
    phase[:, 60] = phase[10, :60] = np.nan
    context = RecordingContext()
    result = run(Unwrap, {"phase": phase_map(phase)}, context, method=method, min_region_px=700)
    assert (result.rejected[:10, :60] == Reject.ISOLATED).all()
    assert (result.rejected[:, 60] == Reject.LOW_MODULATION).all()
    assert ("info", "2 connected regions: 4140 px, 3120 px; 600 px dropped") in context.logged


@methods
def test_difference_takes_the_same_methods(method):
    plane = columns(100, 80, 0, 60)
    bump = slope() - 0.25 * np.arange(100)
    pair = {"reference": phase_map(wrapped(plane)), "object": phase_map(wrapped(plane + bump))}
    result = run(UnwrapDifference, pair, method=method)
    assert np.abs(result.phase_rad - bump).max() < 1e-5
    assert result.kind == "relative"


def test_only_a_wrapped_phase_is_taken():
    with pytest.raises(DataError, match="is absolute; unwrap takes wrapped"):
        run(Unwrap, {"phase": phase_map(slope(), "absolute")})
    with pytest.raises(DataError, match="wrap it first"):
        run(Unwrap, {"phase": phase_map(slope())})
    with pytest.raises(DataError, match="takes a PhaseMap named 'phase'"):
        run(Unwrap, {"phase": slope()})


def test_least_squares_without_an_end_are_an_error_with_advice():
    phase = wrapped(slope())
    phase[20:60, 50] = np.nan
    with pytest.raises(DataError, match="allow more max_iterations"):
        run(Unwrap, {"phase": phase_map(phase)}, method="least-squares", max_iterations=1)


def test_least_squares_can_be_cancelled_and_tell_how_far_they_are():
    class Impatient(RecordingContext):
        def progress(self, fraction, text=""):
            super().progress(fraction, text)
            self.cancelled = text.startswith("residual")

    phase = wrapped(slope())
    phase[20:60, 50] = np.nan
    context = Impatient()
    with pytest.raises(Cancelled):
        run(Unwrap, {"phase": phase_map(phase)}, context, method="least-squares")
    assert 0.1 < max(context.fractions) < 0.2


def test_charged_cuts_are_a_warning():
    y, x = np.mgrid[0:80, 0:80]
    context = RecordingContext()
    vortex = phase_map(np.arctan2(y - 39.5, x - 39.5))
    run(Unwrap, {"phase": vortex}, context, method="branch-cut", longest_cut_px=5)
    assert ("warning", "1 residues; 1 clusters of them found no balance") in context.logged


def test_everything_rejected_leaves_nothing():
    context = RecordingContext()
    result = run(Unwrap, {"phase": phase_map(np.full((20, 30), np.nan))}, context)
    assert np.isnan(result.phase_rad).all() and (result.rejected == Reject.LOW_MODULATION).all()
    assert ("info", "0 connected regions: nothing left; 0 px dropped") in context.logged
