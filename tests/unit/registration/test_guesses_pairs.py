"""Votes of oriented pairs find views again that are turned far, in any unit; what they share with other methods."""

from __future__ import annotations

import numpy as np
import pytest
from guessed import rank, relief_pair

from fringed_plugins.registration.guesses.common import agreeing, frames, overlaps, thinned
from fringed_plugins.registration.guesses.pairs import facing, oriented_pairs
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import rigid, rotation, rotation_angle

POINTS = 4000
FIRST_OF = 20


def guesses(p, q, **more):
    return oriented_pairs(p.level(POINTS), q.level(POINTS), None, np.random.default_rng(0), 1, **more)


@pytest.mark.parametrize(
    ("shape", "apart", "roll", "unit"),
    [("head", 60, 0, 1.0), ("head", 60, 135, 1.0), ("hand", 60, 90, 1000.0)],
)
def test_a_right_guess_is_among_the_first(shape, apart, roll, unit):
    p, q, T = relief_pair(shape, apart, roll, unit)
    found = guesses(p, q)
    assert len(found) <= FIRST_OF
    assert rank(found, T, q) is not None
    assert [guess.score for guess in found] == sorted((guess.score for guess in found), reverse=True)


def test_guesses_are_the_same_every_time():
    p, q, _ = relief_pair("hand", 60, 90, 1000.0)
    a, b = guesses(p, q), guesses(p, q)
    assert all(np.array_equal(x.T_reference_model, y.T_reference_model) for x, y in zip(a, b, strict=True))


def test_guesses_of_a_plane_lay_it_on_itself():
    y, x = np.mgrid[0:80.0, 0:80.0]
    plane = prepare(np.dstack([x, y, 500 + 0.2 * x]))
    n = plane.level(POINTS).inner()[1][0]
    for guess in guesses(plane, plane):  # where in it, is not to be known
        assert guess.T_reference_model[:3, :3] @ n @ n > np.cos(np.radians(1))
        assert abs(guess.T_reference_model[:3, 3] @ n) < 1


def test_a_report_that_raises_stops_the_votes():
    p, q, _ = relief_pair("hand", 60, 90, 1000.0)
    heard = []

    def report(fraction, text):
        heard.append(fraction)
        if fraction > 0.4:
            raise InterruptedError(text)

    with pytest.raises(InterruptedError, match="votes"):
        guesses(p, q, report=report)
    assert heard == sorted(heard)


def test_points_are_thinned_to_about_the_wish_and_apart():
    p, _, _ = relief_pair("hand", 60, 90, 1000.0)
    some = thinned(p.level(POINTS), 500)
    assert 400 < len(some.points) < 600
    assert np.abs(np.linalg.norm(some.normals, axis=1) - 1).max() < 1e-6


def test_facing_brings_point_and_normal_and_turn_together():
    rng = np.random.default_rng(5)
    truth = rigid(rotation([0.4, -1.1, 2.0]), [3.0, -4.0, 5.0])
    n = rng.normal(size=(20, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    q, on_q = rng.normal(size=(20, 3)), frames(n)
    p, on_p = q @ truth[:3, :3].T + truth[:3, 3], frames(n @ truth[:3, :3].T)
    moved = on_q[:, 0] @ truth[:3, :3].T
    turn = np.arctan2((moved * on_p[:, 1]).sum(1), (moved * on_p[:, 0]).sum(1))
    assert np.abs(facing(p, on_p, q, on_q, turn) - truth).max() < 1e-12


def test_motions_that_agree_are_one_mean_and_bring_their_votes():
    p, q, T = relief_pair("hand", 60, 90, 1000.0)
    model = thinned(q.level(POINTS), 300)
    middle = model.size()[0]
    turns = [rotation([0.0, 0.05 * k, 0.0]) for k in (-1, 0, 1)]
    near = [T @ rigid(R, middle - R @ middle) for R in turns]
    far = T @ rigid(rotation([0.0, 0.0, 2.0]), [0.0, 0.0, 0.0])
    means, votes = agreeing(np.array([*near, far]), np.array([1.0, 1.0, 1.0, 2.0]), model, 5)
    assert votes.tolist() == [3.0, 2.0]
    assert rotation_angle(np.linalg.inv(means[0]) @ T) < 1e-9
    share = overlaps(p.level(POINTS), model, means, 2 * p.level(POINTS).spacing_mm, 1)
    assert share[0] > 0.5 > 2 * share[1]  # the hand is seen whole from both sides
