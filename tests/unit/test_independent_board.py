"""The independent renderer against closed forms, so that what is tested with it is tested with something right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from independent_board import Beamer, Bench, Circles, Glass, Light, Stand, camera_of, pose_of, projector_of

BENCH = Bench(
    Glass(320, 240, 20.0, 1.02, (0.01, -0.015), (-0.01, 0.002), (1e-3, -2e-3), 0.2),
    Beamer(Glass(512, 384, 18.0, 1.0, (0.0, 0.3), (0.006, 0.0), (-1e-3, 5e-4), 0.1), (0.25, 0.05, 0.02), (0, 0, -1), 3),
    light=Light(noise=0.0),
)
STAND = Stand((0.01, -0.02, -0.95), (20.0, -12.0, 30.0))


@pytest.fixture(scope="module")
def clean():
    return BENCH.shoot(STAND)


def house_pixels(lens, points):
    """Return the pixels of points (n, 3) by Brown's formulas as OpenCV's manual has them."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k1, k2, p1, p2, k3 = lens.distortion
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent = [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y]
    return np.column_stack([lens.matrix[k, k] * bent[k] + lens.matrix[k, 2] for k in range(2)])


def test_a_middle_pixel_of_a_plain_lens_is_where_paper_and_pencil_put_it():
    plain = Glass(640, 480, 2 * np.degrees(np.arctan(0.25)))
    # 480 px show 0.5 m at 1 m: 960 px for each metre, from the middle at (320, 240), t upwards.
    assert np.allclose(plain.place(np.array([0.1, 0.05, -1.0])), [320 + 96, 240 + 48])
    lens = camera_of(replace(BENCH, camera=plain))
    assert np.allclose(lens.matrix, [[960, 0, 319.5], [0, 960, 239.5], [0, 0, 1]])
    assert np.allclose(house_pixels(lens, np.array([[0.1, -0.05, 1.0]])), [[319.5 + 96, 239.5 - 48]])


def test_newtons_rays_invert_the_distortion():
    st = np.random.default_rng(1).uniform([0, 0], [320, 240], (200, 2))
    assert np.abs(BENCH.camera.place(BENCH.camera.rays(st) * 0.7) - st).max() < 1e-9


def test_both_conventions_tell_the_same_pixels():
    xy = np.random.default_rng(2).uniform(-0.1, 0.1, (50, 2))
    world = STAND.turn() @ np.column_stack([xy, np.zeros(50)]).T
    world = world.T + STAND.at
    st, lit = BENCH.camera.place(world), BENCH.beamer.place(world)
    board = np.column_stack([xy[:, 0], -xy[:, 1], np.zeros(50)]) * 1000  # the house's board: mm, y down
    pose = pose_of(STAND)
    seen = board @ pose[:3, :3].T + pose[:3, 3]
    pixels = house_pixels(camera_of(BENCH), seen)
    assert np.allclose(pixels, np.column_stack([st[:, 0] - 0.5, 240 - st[:, 1] - 0.5]), atol=1e-8)
    lens, T = projector_of(BENCH)
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3)) and np.linalg.det(T) == pytest.approx(1)
    pixels = house_pixels(lens, seen @ T[:3, :3].T + T[:3, 3])
    assert np.allclose(pixels, np.column_stack([lit[:, 0] - 0.5, 384 - lit[:, 1] - 0.5]), atol=1e-8)


def test_an_upright_board_shows_its_odd_large_circles_right_and_below():
    shot = replace(BENCH, board=Circles(7, 5)).shoot(Stand((0.0, 0.0, -0.6)))
    lens = camera_of(BENCH)

    def grey(right, down, radius):
        around = np.array([[right * 20 + radius, down * 20, 600.0]])
        ((c, r),) = np.rint(house_pixels(lens, around)).astype(int)
        return shot.picture[r, c]

    inside = 5.75  # mm from the middle: within a large circle, outside of a small one
    large = [(0, 0), (-2, 0), (2, 0), (0, 2), (2, -2)]
    small = [(0, -2), (-2, 2), (2, 2), (-2, -2), (3, 0)]
    assert max(grey(*at, inside) for at in large) < 0.3 * min(grey(*at, inside) for at in small)


def test_phase_is_that_of_the_pixels_middle_away_from_edges(clean):
    shot = clean
    rays = BENCH.camera.rays(np.stack(np.meshgrid(np.arange(320) + 0.5, 240 - np.arange(240) - 0.5), axis=-1))
    turn, at = STAND.turn(), np.array(STAND.at)
    world = rays * (at @ turn[:, 2] / (rays @ turn[:, 2]))[..., None]
    lit = BENCH.beamer.place(world)
    away = shot.on_paper & ~BENCH._edges(STAND)
    assert away.sum() > 5000
    assert np.abs(shot.phases[0] * 16 / (2 * np.pi) - lit[..., 0])[away].max() < 1e-6
    assert np.abs(shot.phases[1] * 16 / (2 * np.pi) - (384 - lit[..., 1]))[away].max() < 1e-6


def test_edges_are_means_over_pixels():
    """The dark area of an upright circle is its own area, in pixels, to what 100 rays for a pixel can tell."""
    glass = Glass(320, 240, 20.0)
    bench = Bench(glass, BENCH.beamer, Circles(5, 5, pitch=0.04, diameter=0.02, large=0.03), Light(0, 100, 0))
    shot = bench.shoot(Stand((0.0013, 0.0021, -0.9)))
    paper, ink = 90.0, 7.0
    scale = 120 / glass.half / 0.9
    dark = ((paper - shot.picture) / (paper - ink))[120 - 56 : 120 + 54, 160 - 56 : 160 + 58].clip(0, 1)
    middle = dark[36:76, 36:76]  # pitch is 30 px: the middle circle alone
    rows, columns = np.mgrid[64 + 36 : 64 + 76, 104 + 36 : 104 + 76]
    area = np.pi * (0.015 * scale) ** 2
    assert middle.sum() == pytest.approx(area, rel=1e-3)
    centre = [(columns * middle).sum() / middle.sum(), (rows * middle).sum() / middle.sum()]
    assert centre == pytest.approx([159.5 + 0.0013 * scale, 119.5 - 0.0021 * scale], abs=0.005)


def test_noise_is_what_the_deviation_says(clean):
    seen = replace(BENCH, light=Light(noise=1.0)).shoot(STAND, seed=5)
    on = clean.on_paper
    normal = ((seen.phases[0] - clean.phases[0]) / seen.sigmas[0])[on]
    assert normal.std() == pytest.approx(1.0, abs=0.02) and abs(normal.mean()) < 0.02
    assert (seen.picture - clean.picture)[on].std() == pytest.approx(1 / np.sqrt(24), rel=0.03)
