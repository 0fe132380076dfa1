"""Heads of different people: as unlike as people are, the same whenever they are made, and inside what the rig sees."""

from dataclasses import astuple, fields
from itertools import combinations

import numpy as np
import pytest

from fringed.config.simulated import SceneConfig, SimulationConfig
from fringed.simulation.scene import rotation
from fringed.simulation.shapes import shape_maker
from fringed.simulation.shapes.person import Proportions, proportions, uneven_mm

SIZE = {"columns": 96, "rows": 64}
PEOPLE = range(1, 9)
# The mean head at some rows and columns of 64 x 96: nobody moves it without notice.
MEAN_MM = {
    (10, 48): (0.0, 83.131, 56.808), (24, 48): (0.0, 25.667, 85.271), (32, 48): (0.0, -1.841, 97.117),
    (28, 40): (-23.767, 9.344, 65.394), (40, 20): (-64.376, -22.396, 4.92), (28, 76): (71.799, 9.67, 5.487),
    (52, 60): (33.397, -84.808, 55.98),
}  # fmt: skip


def head(**options):
    return shape_maker(SceneConfig(object="face", options=SIZE | options))().vertices_mm.reshape(64, 96, 3)


@pytest.fixture(scope="module")
def people():
    return {variant: head(variant=variant) for variant in PEOPLE}


def test_the_mean_head_is_what_it_was():
    grid = head(variant=0)
    found = np.array([grid[at] for at in MEAN_MM])
    np.testing.assert_allclose(found, list(MEAN_MM.values()), atol=0.02)  # a ray stops within 0.01 mm


def test_nobodys_proportions_are_the_means():
    assert proportions(0, 0) == Proportions()
    names = [field.name for field in fields(Proportions)]
    assert all(getattr(proportions(0, 1), name) != getattr(Proportions(), name) for name in names)
    drawn = np.array([astuple(proportions(0, variant)) for variant in range(1, 400)])
    mean, spread = np.array(astuple(Proportions())), drawn.std(0)
    # 399 draws, cut at two standard deviations: the mean of them is within four of its own.
    assert (np.abs(drawn.mean(0) - mean) < 4 * spread / np.sqrt(len(drawn))).all()
    assert (np.abs(drawn - mean) < 2.5 * spread).all()


def test_seed_and_variant_add_up_and_are_of_different_draws():
    both, one, other = proportions(3, 3), proportions(0, 3), proportions(3, 0)
    assert both.jaw == pytest.approx(one.jaw * other.jaw)
    assert both.hook_mm == one.hook_mm
    assert one.jaw != pytest.approx(other.jaw, abs=1e-6)


def test_a_variant_is_one_persons(people):
    assert (head(variant=3) == people[3]).all()


def test_people_differ_by_some_millimetres(people):
    apart = [np.sqrt(((people[a] - people[b]) ** 2).sum(-1).mean()) for a, b in combinations(PEOPLE, 2)]
    assert min(apart) > 1.5
    assert 2.0 < np.median(apart) < 6.0
    assert max(apart) < 10.0


def test_nobody_is_quite_symmetrical(people):
    for grid in people.values():
        uneven = np.linalg.norm(grid, axis=-1) - np.linalg.norm(grid[:, np.r_[0, 95:0:-1]], axis=-1)
        # Of a field of 0.5 to 1 mm RMS, the odd half: some 0.7 of it.
        assert 0.2 < np.sqrt((uneven**2).mean()) < 2.0


def test_unevenness_is_smooth_and_of_the_size_that_is_said():
    direction = np.random.default_rng(0).normal(size=(4000, 3)).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    tilt = 0.01 * np.roll(direction, 1, axis=1)
    rms = []
    for variant in range(1, 30):
        field = uneven_mm(direction, variant)
        rms.append(np.sqrt((field**2).mean()))
        assert np.abs(field).max() < 4.0
        assert np.abs(uneven_mm(direction + tilt, variant) - field).max() < 0.01 * 7 * 4.0  # waves of 7 rad at most
    assert 0.4 < np.mean(rms) < 1.1
    assert not uneven_mm(direction, 0).any()


def test_no_head_meets_itself(people):
    direction = people[1] / np.linalg.norm(people[1], axis=-1, keepdims=True)
    for grid in people.values():
        radius = np.linalg.norm(grid, axis=-1)
        assert radius.min() > 40.0  # one radius for each direction, so that no two parts share a place
        np.testing.assert_allclose(grid / radius[..., None], direction, atol=1e-5)


@pytest.mark.parametrize("degrees", [-60.0, 0.0, 60.0])
def test_the_rig_sees_all_of_a_head_that_is_turned(people, degrees):
    config = SimulationConfig()
    geometry, sensor = config.geometry, config.sensor
    half = 0.5 * geometry.field_mm * np.array([1.0, sensor.height_px / sensor.width_px])
    R = rotation((0.0, degrees, 0.0)) @ np.diag([1.0, -1.0, -1.0])
    for grid in people.values():
        points = grid.reshape(-1, 3) @ R.T
        seen = points[:, :2] / (1 + points[:, 2:] / geometry.working_distance_mm)
        assert (np.abs(seen) < half).all()
