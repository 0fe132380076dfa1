"""ICPIF with moments and spherical harmonics: what describes a point, and that a known motion is found by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analytic_relief import errors, head, see
from analytic_relief import pose as view_pose
from thesis_surface import errors_percent, height, moved, pose, surface

from fringed_plugins.registration.family.describing import Neighbourhoods
from fringed_plugins.registration.family.frames import frame_of
from fringed_plugins.registration.family.method import align
from fringed_plugins.registration.family.pair import register_by
from fringed_plugins.registration.family.presets import METHODS
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import apply

STEP = 0.1
KINDS = pytest.mark.parametrize("kind", ["moments", "harmonics"])
REVIEWED = {  # the fine methods of the thesis's section 4.6, and whose they are
    "besl-mckay": "Besl & McKay", "chen-medioni": "Chen & Medioni", "zhang": "Zhang", "icpif": "Sharp",
    "icpif-moments": "Sharp", "icpif-harmonics": "Sharp", "sharp": "Sharp", "picky": "Zinsser", "lmeds": "Trucco",
    "masuda-yokoya": "Masuda & Yokoya", "turk-levoy": "Turk", "random": "Masuda", "normal-space": "Rusinkiewicz",
    "scaling": "Du,", "ransac": "Fischler & Bolles",
}  # fmt: skip


def sampled(offset=0.0, noise=0.0, seed=0, hole=None, away=0.0):
    """Return a view (h, w, 3) of the synthetic surface on a grid that begins elsewhere, with noise along z."""
    u, v = np.meshgrid(*(np.arange(-6.0 + offset, 6.0, STEP),) * 2)
    z = height(u, v) + np.random.default_rng(seed).normal(0, 1, u.shape) * noise
    if hole is not None:
        z[np.hypot(u - hole[0], v - hole[1]) < 0.35] = np.nan
    return np.dstack([u, v, z + away])


def off(outcome, frames):
    """Return the RMS distance (n,) of the model's points from where they belong, after each iteration."""
    points = frames[1].points + frames[1].origin
    truth = apply(np.linalg.inv(pose()), points) - frames[0].origin
    return np.array([np.sqrt(((apply(T, frames[1].points) - truth) ** 2).sum(1).mean()) for T in outcome.poses])


@pytest.fixture(scope="module")
def still():
    return frame_of(prepare(surface()))


@pytest.fixture(scope="module")
def part():
    return frame_of(prepare(surface((-3, 3))))


@KINDS
@pytest.mark.parametrize("columns", [((-6, 6), (-6, 6)), ((-6, 3), (-3, 6))])
def test_known_motion_is_found_in_no_more_iterations_than_besl_and_mckay_take(kind, columns):
    """Full and half overlap, 5 degrees about each axis and 1.6 away: the samples are the same, so the end is exact."""
    frames = [frame_of(prepare(view)) for view in (surface(columns[0]), moved(surface(columns[1]), pose()))]
    found, plain = align(METHODS[f"icpif-{kind}"], *frames), align(METHODS["besl-mckay"], *frames)
    assert max(errors_percent(found.between(*frames), pose())) < 1e-4
    assert len(found.history) <= len(plain.history)
    alphas = [made.alpha_mm for made in found.history]
    assert 0 < alphas[-1] < 0.1 * alphas[0]


@KINDS
def test_other_samples_of_the_surface_are_brought_within_a_resolution(kind):
    """Closest points hold a grid on another where it stands, at most half a cell's diagonal (0.7) off."""
    frames = [frame_of(prepare(view)) for view in (sampled(), moved(sampled(0.043, 0.01, 2), pose()))]
    found, plain = (off(align(METHODS[name], *frames), frames) for name in (f"icpif-{kind}", "besl-mckay"))
    assert found[-1] < STEP and found[-1] < plain[-1]
    assert (found[: len(plain)] < 3 * STEP).sum() >= (plain[: len(found)] < 3 * STEP).sum()


@KINDS
def test_motion_changes_features_by_less_than_their_noise(kind, still):
    other = frame_of(prepare(moved(surface(), pose((20, -10, 30), (3, 2, 1)))))
    first, second = Neighbourhoods(kind)(still, other)
    both = first.whole & second.whole
    assert both.sum() > 0.6 * len(still) and (first.whole == second.whole).mean() > 0.98
    assert np.percentile(np.abs(first.features - second.features)[both], 99) < 0.5


@KINDS
def test_unit_of_features_is_their_noise(kind):
    """Two scans with other noise differ by sqrt(2) units, less where the floor of 2 % of the spread is more."""
    frames = [frame_of(prepare(sampled(noise=0.02, seed=seed, away=50.0))) for seed in (1, 2)]
    first, second = Neighbourhoods(kind, radii=(6.0,))(*frames)
    both = first.whole & second.whole
    scatter = np.std((first.features - second.features)[both], axis=0) / np.sqrt(2)
    assert scatter.max() < 2 and scatter.max() > 0.5
    assert (np.ptp(np.percentile(first.features[both], (10, 90), axis=0), axis=0) < 51).all()


@KINDS
def test_features_hold_only_where_the_neighbourhood_is_complete(kind):
    hole, radius = (1.0, -1.0), 6 * STEP
    frame = frame_of(prepare(sampled(hole=hole)))
    found, _ = Neighbourhoods(kind, radii=(6.0,))(frame, frame)
    at = (frame.points + frame.origin)[:, :2]
    edge = np.minimum(np.hypot(*(at - hole).T) - 0.35, 5.95 - np.abs(at).max(axis=1))
    assert not found.whole[edge < 0.8 * radius].any()
    assert found.whole[edge > radius + 5 * STEP].all()
    inner = found.whole & ~found.rim
    assert inner.any() and not found.rim[edge > radius + 7 * STEP].any() and found.rim[~found.whole].all()


@KINDS
def test_features_between_centres_are_those_computed_there(kind, part):
    few, _ = Neighbourhoods(kind, radii=(8.0,), centres=1500)(part, part)
    every, _ = Neighbourhoods(kind, radii=(8.0,), centres=10**6)(part, part)
    both = few.whole & every.whole
    assert both.sum() > 0.8 * every.whole.sum()
    assert np.percentile(np.abs(few.features - every.features)[both], 95) < 0.1 * np.ptp(every.features, axis=0).max()


@KINDS
def test_dense_frame_is_described_by_a_part_of_its_points(kind, still):
    """Every second row and column makes the neighbourhoods, with twice the radius, and the motion is still found."""
    method = replace(METHODS[f"icpif-{kind}"], describe=Neighbourhoods(kind, radii=(6.0,), support=4000))
    model = frame_of(prepare(moved(surface(), pose())))
    outcome = align(method, still, model)
    assert off(outcome, (still, model))[-1] < STEP


@KINDS
def test_cloud_without_a_grid_is_described_too(kind, part):
    cloud = replace(part, pixel=None, projection=None)
    found, same = Neighbourhoods(kind, radii=(6.0,), centres=20_000)(cloud, cloud)
    on_grid, _ = Neighbourhoods(kind, radii=(6.0,), centres=20_000)(part, part)
    assert np.array_equal(found.whole, on_grid.whole) and np.array_equal(found.features, same.features)
    assert found.rim[~found.whole].all() and not found.rim.all()


def test_frame_without_a_complete_neighbourhood_is_refused_by_name(still):
    with pytest.raises(ValueError, match=r"no point of the .* complete neighbourhood of radius"):
        Neighbourhoods("moments", radii=(100.0,))(still, still)


def test_description_can_be_stopped(still):
    def stop(part, text):
        raise InterruptedError(text)

    with pytest.raises(InterruptedError):
        align(METHODS["icpif-moments"], still, still, report=stop)


def test_views_of_a_head_come_nearer_than_by_curvatures():
    """Two noisy views 12 degrees apart; what is left is how far the closest points of other samples hold them."""
    seen = see(head, noise_mm=0.05, seed=1), see(head, view_pose((0, 12, 0)), noise_mm=0.05, seed=2)
    surfaces = [prepare(view.xyz_mm) for view in seen]
    left = {}
    for name in ("icpif", "icpif-moments", "icpif-harmonics"):
        found = register_by(METHODS[name], *surfaces)
        assert found.reason and {made.stage for made in found.history} == {name}
        left[name] = errors(found.T_reference_model, *seen)[1]
    assert max(left["icpif-moments"], left["icpif-harmonics"]) < 0.6 * left["icpif"]


@pytest.mark.parametrize(("name", "author"), REVIEWED.items())
def test_every_fine_method_that_the_thesis_reviews_names_its_paper(name, author):
    assert author in METHODS[name].source
