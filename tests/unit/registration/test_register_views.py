"""Registration of independently sampled views against the poses they were seen from.

The tolerance is the Cramer-Rao bound that the result itself states (its covariance) times a factor, plus what
sampling leaves without noise (measured below 0.002 deg and 0.003 mm at 1.2 mm pitch), never above the figures
0.05 deg and 0.1 mm.
"""

from __future__ import annotations

import time

import numpy as np
import pytest
from analytic_relief import OUTLINES, errors, hand, head, pose, see

from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import apply, rigid, rotation

NOISE = 0.08


def run(reference, model, **options):
    surfaces = prepare(reference.xyz_mm, name="reference"), prepare(model.xyz_mm, name="model")
    return register(*surfaces, Options(**options))


def assert_right(found, reference, model):
    assert found.converged, found.reason
    rotation_deg, surface_mm = errors(found.T_reference_model, reference, model)
    bound_deg = np.degrees(np.sqrt(np.trace(found.covariance[:3, :3])))
    assert rotation_deg < min(4 * bound_deg + 0.002, 0.05)
    assert surface_mm < min(4 * np.radians(bound_deg) * 80 + 0.005, 0.1)


@pytest.mark.parametrize("shape", [head, hand])
@pytest.mark.parametrize("turn", [(0, 15, 0), (0, -30, 0), (12, 25, 5)])
def test_turned_view_is_registered_without_a_guess(shape, turn):
    reference, model = see(shape, noise_mm=NOISE, seed=1), see(shape, pose(turn), noise_mm=NOISE, seed=2)
    assert_right(run(reference, model), reference, model)


@pytest.mark.parametrize("shape", [head, hand])
def test_half_overlap_is_registered_and_told(shape):
    reference = see(shape, noise_mm=NOISE, seed=1, columns=(0, 0.68))
    model = see(shape, pose((0, -25, 0)), noise_mm=NOISE, seed=2, columns=(0.32, 1))
    found = run(reference, model)
    assert_right(found, reference, model)
    points = model.clean_mm[np.isfinite(model.clean_mm[..., 0])] - model.T_camera_object[:3, 3]
    place = (points @ model.T_camera_object[:3, :3])[:, 0] / (2 * OUTLINES[shape][0]) + 0.5
    assert found.overlap == pytest.approx((place < 0.68).mean(), abs=0.05)  # borders of 2 pixels are not counted


@pytest.mark.parametrize("turn", [(0, 10, 90), (0, 0, 180)])
def test_principal_axes_find_a_view_on_its_head(turn):
    reference, model = see(noise_mm=NOISE, seed=1), see(T=pose(turn), noise_mm=NOISE, seed=2)
    assert_right(run(reference, model), reference, model)


def test_given_start_is_used():
    reference, model = see(noise_mm=NOISE, seed=1), see(T=pose((0, 25, 0)), noise_mm=NOISE, seed=2)
    start = reference.T_camera_object @ rigid(rotation([0, 0.05, 0]), [3, 0, 0]) @ np.linalg.inv(model.T_camera_object)
    assert_right(run(reference, model, T_reference_model=start), reference, model)
    with pytest.raises(ValueError, match="not rigid"):
        run(reference, model, T_reference_model=np.diag([1, 1, -1, 1]))


def test_lost_pixels_and_flyers_do_no_harm():
    def spoiled(view, seed):
        rng = np.random.default_rng(seed)
        xyz = view.xyz_mm.copy()
        xyz[rng.random(xyz.shape[:2]) < 0.05] = np.nan
        flyers = rng.random(xyz.shape[:2]) < 0.01
        xyz[flyers, 2] += rng.normal(0, 20, flyers.sum()).astype(np.float32)
        return type(view)(xyz, view.T_camera_object, view.clean_mm)

    reference = spoiled(see(noise_mm=NOISE, seed=1), 1)
    model = spoiled(see(T=pose((0, 25, 0)), noise_mm=NOISE, seed=2), 2)
    assert_right(run(reference, model), reference, model)


def test_covariance_is_what_repetition_scatters():
    """Normalised error squared, d^T C^-1 d, has mean 6 if the covariance is right."""
    T = pose((0, 15, 0))
    clean = see(), see(T=T)
    nees = []
    for seed in range(8):
        views = [see_again(view, 10 * seed + k) for k, view in enumerate(clean)]
        truth = clean[0].T_camera_object @ np.linalg.inv(T)
        found = run(*views, T_reference_model=truth)
        off = found.T_reference_model @ np.linalg.inv(truth)
        small = np.array([off[2, 1], off[0, 2], off[1, 0], *off[:3, 3]])
        nees.append(small @ np.linalg.solve(found.covariance, small))
    # 48 squares: their sum / 8 lies in 3 .. 10 almost surely; sampling may add as much again
    assert 2.5 < np.mean(nees) < 15


def see_again(view, seed):
    rays = view.clean_mm / np.linalg.norm(view.clean_mm, axis=2, keepdims=True)
    noise = np.random.default_rng(seed).normal(0, NOISE, rays.shape[:2])
    return type(view)((view.clean_mm + rays * noise[..., None]).astype(np.float32), view.T_camera_object, view.clean_mm)


def _plane(x, y):
    return 0.2 * x - 0.1 * y - 30


def _ball(x, y):
    return -np.sqrt(np.maximum(120.0**2 - x**2 - y**2, 100))


@pytest.mark.parametrize("shape", [_plane, _ball])
@pytest.mark.parametrize("noise", [0.0, 0.08])
def test_surfaces_that_slide_do_not_converge_and_say_which_way(shape, noise, monkeypatch):
    monkeypatch.setitem(OUTLINES, shape, (80.0, 105.0))
    found = run(see(shape, noise_mm=noise, seed=1), see(shape, pose((0, 10, 0)), noise_mm=noise, seed=2))
    assert not found.converged
    assert "not determined" in found.reason
    assert found.covariance is None


def test_different_objects_do_not_converge():
    found = run(see(head, noise_mm=NOISE, seed=1), see(hand, noise_mm=NOISE, seed=2))
    assert not found.converged and found.reason


def test_views_without_overlap_do_not_converge():
    found = run(see(noise_mm=NOISE, seed=1, columns=(0, 0.45)), see(noise_mm=NOISE, seed=2, columns=(0.55, 1)))
    assert not found.converged and found.reason


def test_metres_against_millimetres_are_refused():
    reference = see()
    with pytest.raises(ValueError, match="different units"):
        register(prepare(reference.xyz_mm), prepare(reference.xyz_mm / np.float32(1000)))


def test_history_tells_every_iteration():
    reference, model = see(noise_mm=NOISE, seed=1), see(T=pose((0, 20, 0)), noise_mm=NOISE, seed=2)
    found = run(reference, model)
    assert {made.stage for made in found.history} == {"medium", "fine"}
    last = found.history[-1]
    assert last.pairs > 1000 and 0 < last.threshold_mm < 10
    assert last.rotation_rad < 1e-4 and last.translation_mm < 1e-2
    # smoothed points on patches: 0.745 of a point's noise in windows of 3 pixels, times the harmonic mean of cosines
    assert last.rms_mm == pytest.approx(0.745 * 0.65 * np.hypot(NOISE, NOISE), rel=0.2)
    assert found.rms_mm == pytest.approx(np.hypot(NOISE, NOISE) / 2, rel=0.35)  # means of 2 x 2 points


def test_too_few_iterations_are_not_called_converged():
    from fringed_plugins.registration.icp import Settings

    few = Settings(iterations=1)
    found = run(see(seed=1), see(T=pose((0, 20, 0)), seed=2), medium=few, fine_iterations=1)
    assert not found.converged and "1 iterations" in found.reason


def test_whole_registration_can_be_stopped_at_every_report():
    surfaces = prepare(see(noise_mm=NOISE).xyz_mm), prepare(see(T=pose((0, 20, 0)), noise_mm=NOISE).xyz_mm)
    heard = []

    class StoppedError(Exception):
        pass

    def stop_at(number):
        def report(fraction, text):
            heard.append((fraction, text, time.perf_counter()))
            if len(heard) > number:
                raise StoppedError

        return report

    for number in (0, 5, 12):
        heard.clear()
        with pytest.raises(StoppedError):
            register(*surfaces, report=stop_at(number))
        assert len(heard) == number + 1
    assert all(0 <= fraction <= 1 and text for fraction, text, _ in heard)


def test_both_directions_are_inverse():
    a, b = see(noise_mm=NOISE, seed=1), see(T=pose((0, 20, 0)), noise_mm=NOISE, seed=2)
    there, back = run(a, b), run(b, a)
    points = b.clean_mm[np.isfinite(b.clean_mm[..., 0])]
    returned = apply(back.T_reference_model, apply(there.T_reference_model, points))
    assert np.abs(returned - points).max() < 0.1
