"""Every method of guessing finds a known motion, says what it cannot use, repeats itself and can be stopped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from guessed import rank, relief_pair

from fringed_plugins.registration.guesses import GUESSERS
from fringed_plugins.registration.guesses.common import MOST, thinned
from fringed_plugins.registration.guesses.consistent import Grouping, Matches, consistency, motions
from fringed_plugins.registration.guesses.darces import Darces, laid
from fringed_plugins.registration.guesses.features import histograms
from fringed_plugins.registration.guesses.genes import Genetic, children
from fringed_plugins.registration.guesses.signatures import bridged, compared
from fringed_plugins.registration.guesses.spin import SpinImages, similarity, spun
from fringed_plugins.registration.transforms import apply, rigid, rotation, rotation_angle

POINTS = 4000
QUICK = {"genetic": Genetic(founders=800, population=100, generations=8), "ransac-darces": Darces(trials=12)}
METHODS = sorted(GUESSERS)
PARTIAL = [name for name in METHODS if name != "principal-axes"]  # that one needs views that show nearly the same
NEARER = {("genetic", "head"): ("head", 30, 0, 1.0)}  # from 60 degrees aside it depends on its luck
CASES = (("head", 60, 135, 1.0), ("hand", 60, 90, 1e3))


def guesses(name, p, q, seed=0, **more):
    return GUESSERS[name](p, q, more.pop("options", None), np.random.default_rng(seed), 1, **more)


def levels(*case):
    p, q, _ = relief_pair(*case)
    return p.level(POINTS), q.level(POINTS)


@pytest.mark.parametrize("name", PARTIAL)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
def test_a_right_guess_is_among_the_first(name, case):
    p, q, T = relief_pair(*NEARER.get((name, case[0]), case))
    found = guesses(name, p.level(POINTS), q.level(POINTS))
    assert len(found) <= MOST
    assert {guess.method for guess in found} == {name}
    assert [guess.score for guess in found] == sorted((guess.score for guess in found), reverse=True)
    assert rank(found, T, q) is not None


def test_principal_axes_find_views_that_show_nearly_the_same():
    p, q, T = relief_pair("hand", 60, 90, 1e3)
    found = guesses("principal-axes", p.level(POINTS), q.level(POINTS))
    assert len(found) <= 4
    assert rank(found, T, q) is not None


@pytest.mark.parametrize("name", METHODS)
def test_the_same_seed_gives_the_same_guesses(name):
    p, q = levels("hand", 60, 90, 1e3)
    a, b = (guesses(name, p, q, 7, options=QUICK.get(name)) for _ in range(2))
    assert a
    assert all(np.array_equal(x.T_reference_model, y.T_reference_model) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("name", METHODS)
def test_too_few_points_are_refused(name):
    p, q = levels("hand", 60, 90, 1e3)
    few = replace(q, interior=q.interior & (np.cumsum(q.interior) <= 20))
    none = replace(q, **{part: getattr(q, part)[:0] for part in ("points", "normals", "interior", "sigma_mm")})
    for a, b, count in ((p, few, 20), (few, p, 20), (p, none, 0), (none, p, 0)):
        with pytest.raises(ValueError, match=f"has {count} points with normals"):
            guesses(name, a, b)


@pytest.mark.parametrize("name", METHODS)
def test_points_that_are_not_finite_or_all_in_one_place_are_refused(name):
    p, q = levels("hand", 60, 90, 1e3)
    torn = replace(q, points=np.where(np.arange(len(q.points))[:, None] == 5, np.nan, q.points))
    same = replace(q, points=np.ones_like(q.points))
    for bad, why in ((torn, "not finite"), (same, "coincide")):
        for pair in ((p, bad), (bad, p)):
            with pytest.raises(ValueError, match=why):
                guesses(name, *pair)


@pytest.mark.parametrize("name", METHODS)
def test_a_report_is_heard_in_order_and_stops_the_work(name):
    p, q = levels("hand", 60, 90, 1e3)
    heard = []
    guesses(name, p, q, options=QUICK.get(name), report=lambda fraction, _: heard.append(fraction))
    assert heard == sorted(heard)
    assert 0 <= heard[0] <= heard[-1] <= 1
    for calls in {1, len(heard) // 2, len(heard)} - {0}:
        left = iter(range(calls))

        def report(fraction, text, left=left, calls=calls):
            if next(left) == calls - 1:
                raise InterruptedError(text)

        with pytest.raises(InterruptedError):
            guesses(name, p, q, options=QUICK.get(name), report=report)
        assert next(left, None) is None  # nothing was asked after it had raised


@pytest.mark.parametrize("name", METHODS)
def test_few_points_in_a_great_unit_give_guesses_or_none(name):
    y, x = np.mgrid[0:12.0, 0:12.0] * 1e6
    bowl = np.dstack([x, y, (x - 5e6) ** 2 / 4e7 + (y - 3e6) ** 2 / 6e7]).reshape(-1, 3)
    p, _ = levels("hand", 60, 90, 1e3)
    n = np.tile([0.0, 0.0, -1.0], (len(bowl), 1))
    level = replace(
        p, points=bowl, normals=n, interior=np.ones(len(bowl), np.bool_), sigma_mm=np.ones(len(bowl)), spacing_mm=1e6
    )
    for guess in guesses(name, level, level, options=QUICK.get(name)):
        assert np.isfinite(guess.T_reference_model).all()
        assert np.abs(guess.T_reference_model[:3, :3] @ guess.T_reference_model[:3, :3].T - np.eye(3)).max() < 1e-9


def matched(rng, right, wrong):
    """Return correspondences of oriented points, `right` of them made by one motion, the rest at random, and it."""
    T = rigid(rotation([0.3, -0.8, 1.9]), [30.0, -20.0, 900.0])
    q, m = rng.uniform(-50, 50, (right + wrong, 3)), rng.normal(size=(right + wrong, 3))
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    p, n = apply(T, q), m @ T[:3, :3].T
    p[right:], n[right:] = rng.permutation(p[right:]), rng.permutation(n[right:])
    return Matches(p, n, q, m), T


def test_consistency_is_zero_within_a_motion_and_infinite_for_itself():
    matches, _ = matched(np.random.default_rng(1), 30, 30)
    fits = consistency(matches, 10.0)
    assert np.isinf(np.diag(fits)).all()
    right = fits[:30, :30][~np.eye(30, dtype=bool)]
    assert right.max() < 1e-6
    assert np.array_equal(fits, fits.T)
    assert np.median(fits[30:, :30]) > 0.3


def test_the_largest_group_has_the_motion_that_made_it():
    matches, T = matched(np.random.default_rng(2), 15, 120)
    found, sizes = motions(matches, Grouping(apart=10.0))
    assert sizes.max() == 15
    best = found[sizes.argmax()]
    assert rotation_angle(np.linalg.inv(best) @ T) < 1e-6
    assert np.abs(best - T).max() < 1e-4


def test_histograms_do_not_change_with_the_view():
    p, _ = levels("head", 60, 0, 1.0)
    some = thinned(p, 400)
    T = rigid(rotation([0.5, 1.0, -2.0]), [10.0, 400.0, -30.0])
    moved = replace(some, points=apply(T, some.points), normals=some.normals @ T[:3, :3].T)
    a, b = histograms(some, 5 * some.side), histograms(moved, 5 * some.side)
    assert np.abs((a**2).sum(1) - 3).max() < 1e-4  # three angles, each a distribution
    assert np.median(np.linalg.norm(a - b, axis=1)) < 1e-3
    assert np.median(np.linalg.norm(a - a[::-1], axis=1)) > 0.1


def test_a_spin_image_is_the_same_from_everywhere_and_counts_every_point_near():
    p, _ = levels("head", 60, 0, 1.0)
    some, how = thinned(p, 400), SpinImages(bins=8, support_deg=180.0)
    T = rigid(rotation([0.5, 1.0, -2.0]), [10.0, 400.0, -30.0])
    moved = replace(some, points=apply(T, some.points), normals=some.normals @ T[:3, :3].T)
    (at, a), (_, b) = (spun(one, some.side, how, 60) for one in (some, moved))
    assert np.abs(a - b).max() < 1e-6
    near = np.linalg.norm(some.points - some.points[at[30]], axis=1) < 3 * some.side  # whole within image and spread
    assert near.sum() - 1e-9 <= a[30].sum() <= 400


def test_similarity_ignores_what_one_image_does_not_show():
    rng = np.random.default_rng(3)
    whole = rng.uniform(1, 5, (20, 64))
    half = whole.copy()
    half[:, 40:] = 0
    assert (similarity(half, whole).argmax(axis=1) == np.arange(20)).all()


def test_a_triangle_is_laid_on_each_of_those_that_are_like_it():
    rng = np.random.default_rng(4)
    triangle = rng.normal(size=(3, 3))
    truths = np.array([rigid(rotation(rng.normal(size=3)), rng.normal(size=3)) for _ in range(5)])
    assert np.abs(laid(np.array([apply(T, triangle) for T in truths]), triangle) - truths).max() < 1e-12


def test_children_are_rigid_and_without_mutation_take_after_the_better_parents():
    rng = np.random.default_rng(6)
    parents = np.array([rigid(rotation(rng.normal(size=3)), rng.normal(size=3)) for _ in range(8)])
    middle = np.array([5.0, -2.0, 1.0])
    score = np.arange(8.0)
    born = children(parents, score, 4000, (middle, 3.0, 0.0), rng)
    R = born[:, :3, :3]
    assert np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max() < 1e-12
    apart = np.abs(R[:, None] - parents[:, :3, :3]).max((2, 3))
    assert apart.min(axis=1).max() < 1e-12
    times = np.bincount(apart.argmin(axis=1), minlength=8)
    # of a tournament of three the best wins with 1 - (7/8)^3 = 0.33, the worst with (1/8)^3
    assert abs(times[7] / 4000 - 0.33) < 0.05
    assert times[0] < 40
    mutated = children(parents, score, 4000, (middle, 3.0, 0.2), rng)
    assert np.abs(mutated[:, :3, :3] - parents[7, :3, :3]).max((1, 2)).min() > 0


def test_signatures_say_whose_they_are_and_how_far_they_are_turned():
    rng = np.random.default_rng(8)
    p = rng.normal(size=(6, 2, 24))
    shifts = np.array([0, 3, 11, 12, 20, 23])
    q = np.array([np.roll(one, -shift, axis=1) for one, shift in zip(p, shifts, strict=True)])[::-1]
    best, who, turn, share = compared(p, q, 1)
    assert best.tolist() == [5, 4, 3, 2, 1, 0]
    assert who.tolist() == [0, 1, 2, 3, 4, 5]
    assert np.abs(turn - shifts[::-1] * np.radians(15)).max() < 1e-12
    assert share.min() > 0.99


def test_small_gaps_of_a_circle_are_bridged_and_large_ones_are_not():
    values = np.tile(np.arange(12.0), (3, 1))
    known = np.ones((3, 12), np.bool_)
    known[0, 5] = known[1, 3:7] = known[2, 3:8] = False
    filled, whole = bridged(np.where(known, values, 0.0), known)
    assert whole.tolist() == [True, True, False]
    assert np.array_equal(filled[0], values[0])
    assert filled[1, 2:8].tolist() == [2, 2, 2, 7, 7, 7]
