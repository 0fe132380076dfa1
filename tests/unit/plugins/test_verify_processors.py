"""The verifying processors: figures, limits and the light, notes, units noticed, refusals; means and depths joined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from artefact_truth import plane_depth, points, rays, sphere_depth, stairs_depth
from msgspec import convert

from fringed.config.simulated import SimulationConfig
from fringed.data import Provenance, RangeImage, Reject, Verification
from fringed.errors import DataError
from fringed.simulation.optics import exact_calibration
from fringed.testing import RecordingContext
from fringed_plugins.calibrators.judging import light
from fringed_plugins.calibrators.ranges import AverageRange, VerifyRange
from fringed_plugins.calibrators.verify import VerifyPlane, VerifySphere, VerifyStep

RAY = rays()
SPHERE = sphere_depth(RAY, (10.0, 0.0, 1000.0), 60.0)


def image(depth, noise_mm=0.06, seed=0, stated_mm=None):
    xyz, valid = points(RAY, depth, noise_mm, seed)
    rejected = np.where(valid, 0, int(Reject.LOW_MODULATION)).astype(np.uint16)
    sigma = np.where(valid, noise_mm if stated_mm is None else stated_mm, np.nan).astype(np.float32)
    grey = np.full(valid.shape, 120, np.uint8)
    return RangeImage(xyz, rejected, grey, sigma, calibration="c0ffee", provenance=Provenance(rig="bench"))


def run(processor, range_image, context=None, **params):
    inputs = {"range": range_image} if isinstance(range_image, RangeImage) else range_image
    return processor().run(inputs, processor.Params(**params), context or RecordingContext())


def test_plane_tells_flatness_with_its_uncertainty_and_where():
    found = run(VerifyPlane, image(plane_depth(RAY, (0.1, 0, -1), (0, 0, 1000.0))), temperature_c=20.5)
    assert (found.artefact, found.calibration, found.rig) == ("plane", "c0ffee", "bench")
    assert found.verdict == "green" == found.verdicts["flatness_error"]
    assert 0.04 < found.figures["flatness_error"] < 0.06 and 0 < found.figures["flatness_error_u"] < 0.005
    assert found.limits["flatness_error"] == pytest.approx(0.1, rel=0.02)
    assert found.depth_mm[0] == pytest.approx(980.4, abs=1) and found.depth_mm[1] == pytest.approx(1020.4, abs=1)
    assert found.temperature_c == 20.5 and any("7 x 7 px" in note for note in found.notes)


def test_sphere_of_the_wrong_size_is_red_and_of_the_right_size_green():
    good = run(VerifySphere, image(SPHERE), radius_mm=60.0)
    assert (
        good.verdict == "green" and abs(good.figures["probing_error_size"]) < 4 * good.figures["probing_error_size_u"]
    )
    bad = run(VerifySphere, image(SPHERE), radius_mm=60.2)
    assert bad.verdicts["probing_error_size"] == "red" == bad.verdict and bad.verdicts["probing_error_form"] == "green"
    assert bad.figures["probing_error_size"] == pytest.approx(-0.4, abs=0.03)


def test_sphere_without_a_nominal_radius_is_judged_by_its_form_only():
    found = run(VerifySphere, image(SPHERE))
    assert set(found.limits) == {"probing_error_form"} and "no nominal radius" in found.notes[0]


def test_ball_bar_has_a_spacing():
    a, b = np.array([-100.0, 5.0, 990.0]), np.array([90.0, -20.0, 1010.0])
    bar = image(np.fmin(sphere_depth(RAY, a, 25.0), sphere_depth(RAY, b, 25.0)))
    length = float(np.linalg.norm(b - a))
    found = run(VerifySphere, bar, radius_mm=25.0, spacing_mm=length)
    assert found.artefact == "ball-bar"
    assert abs(found.figures["sphere_spacing_error"]) < min(4 * found.figures["sphere_spacing_error_u"], 0.02)
    stretched = run(VerifySphere, bar, radius_mm=25.0, spacing_mm=length - 0.2)
    assert stretched.verdicts["sphere_spacing_error"] == "red"


def test_the_artefact_grows_with_its_temperature():
    warm = run(VerifySphere, image(SPHERE), radius_mm=59.9, temperature_c=45.0, expansion_per_k=1e-4)
    assert warm.nominal["radius"] == pytest.approx(59.9 * 1.0025)


def test_what_is_unknown_of_the_artefact_counts():
    known = run(VerifySphere, image(SPHERE), radius_mm=60.0)
    unknown = run(VerifySphere, image(SPHERE), radius_mm=60.0, artefact_uncertainty_mm=0.02)
    assert unknown.figures["probing_error_size_u"] > 0.04 > known.figures["probing_error_size_u"]
    assert unknown.verdicts["probing_error_size"] == "yellow"


def test_steps_tell_each_error_and_the_worst():
    found = run(VerifyStep, image(stairs_depth(RAY, (0.0, 10.0, 30.0))), heights_mm=(10.0, 29.9))
    assert found.figures["step_1_error"] == pytest.approx(0, abs=0.02)
    assert found.figures["step_error"] == found.figures["step_2_error"] == pytest.approx(0.1, abs=0.03)
    assert found.verdict == "red" and found.nominal == {"step_1": 10.0, "step_2": 29.9}


def test_wrong_stated_deviations_are_noted():
    assert not any("are stated" in note for note in run(VerifySphere, image(SPHERE)).notes)
    assert any("20 um are stated" in note for note in run(VerifySphere, image(SPHERE, stated_mm=0.02)).notes)


def test_another_calibration_in_force_and_another_temperature_are_noted():
    calibration = exact_calibration(convert({}, SimulationConfig), "bench")
    other = {"range": image(SPHERE), "calibration": calibration}
    assert any("in force" in note for note in run(VerifySphere, other).notes)
    own = replace(calibration, temperature_c=20.0)
    same = {"range": replace(image(SPHERE), calibration=own.hash), "calibration": own}
    assert any("may have moved" in note for note in run(VerifySphere, same, temperature_c=28.0).notes)
    assert not any("may have moved" in note for note in run(VerifySphere, same, temperature_c=21.0).notes)


@pytest.mark.parametrize(
    ("value", "doubt", "verdict"),
    [(0.9, 0.01, "green"), (-0.9, 0.01, "green"), (0.9, 0.06, "yellow"), (1.2, 0.01, "yellow"), (-1.4, 0.1, "yellow"),
     (1.6, 0.01, "red"), (-1.6, 0.01, "red"), (1.6, 0.4, "yellow")],
)  # fmt: skip
def test_the_light(value, doubt, verdict):
    assert light(value, doubt, 1.0) == verdict


@pytest.mark.parametrize(
    ("processor", "params", "said"),
    [
        (VerifySphere, {"radius_mm": 0.06}, "given in metres"),
        (VerifySphere, {"radius_mm": 120.0}, "such as a diameter"),
        (VerifySphere, {"radius_mm": 60_000.0}, "micrometres"),
        (VerifySphere, {"radius_mm": 60.0, "spacing_mm": 100.0}, "2 spheres should be in view, and 1 is"),
        (VerifySphere, {"limits": {"roundness": 1.0}}, "no figure roundness"),
        (VerifySphere, {"smooth_px": 4}, "odd"),
        (VerifySphere, {"max_depth_mm": 500.0}, "has 0 points"),
        (VerifyStep, {"heights_mm": (10.0,)}, "parallel"),
    ],
)
def test_what_cannot_be_meant_is_refused(processor, params, said):
    with pytest.raises(DataError, match=said):
        run(processor, image(SPHERE), **params)


def test_something_else_than_a_range_image_is_refused():
    with pytest.raises(DataError, match="takes a RangeImage"):
        run(VerifyPlane, {"range": None})


def test_mean_of_scans_has_less_noise_as_stated_and_keeps_gaps():
    scans = [image(SPHERE, seed=seed) for seed in range(4)]
    gone = scans[0].rejected.copy()
    gone[100:110, 170:180] = int(Reject.SATURATED)
    scans[0] = replace(scans[0], rejected=gone)
    mean = run(AverageRange, {"ranges": tuple(scans)})
    kept = mean.rejected == 0
    assert (kept == np.isfinite(SPHERE)).all()
    truth = SPHERE[kept]
    off = (mean.xyz_mm[..., 2][kept] - truth) / (mean.sigma_mm[kept] * 1.0)
    assert np.std(off) == pytest.approx(1.0, abs=0.05)
    assert np.nanmedian(mean.sigma_mm) == pytest.approx(0.03, rel=0.01)
    assert mean.sigma_mm[105, 175] == pytest.approx(0.06 / np.sqrt(3), rel=0.01)


def test_scans_of_what_has_moved_or_differs_are_not_averaged():
    moved = sphere_depth(RAY, (10.0, 0.0, 1000.2), 60.0)
    with pytest.raises(DataError, match="moved; take them again"):
        run(AverageRange, {"ranges": (image(SPHERE), image(moved, seed=1))})
    with pytest.raises(DataError, match="one camera setting"):
        run(AverageRange, {"ranges": (image(SPHERE), replace(image(SPHERE), calibration="other"))})
    with pytest.raises(DataError, match="one or more"):
        run(AverageRange, {"ranges": ()})


def at(depth_mm, verdict, error=0.01, calibration="c0ffee"):
    return Verification(
        artefact="plane", calibration=calibration, rig="bench", figures={"flatness_error": error}, points=10,
        limits={"flatness_error": 0.1}, verdicts={"flatness_error": verdict}, verdict=verdict,
        depth_mm=(depth_mm - 5.0, depth_mm + 5.0),
    )  # fmt: skip


def test_depths_in_which_all_hold_end_at_a_red_one():
    given = (at(1000, "yellow", 0.12), at(900, "green"), at(1100, "green"), at(1200, "red", 0.4), at(1300, "green"))
    found = run(VerifyRange, {"verifications": given})
    assert found.depth_mm == (895.0, 1105.0) and found.verdict == "yellow"
    assert found.figures["flatness_error"] == 0.12 and found.points == 30 and "3 of 5" in found.notes[0]
    assert run(VerifyRange, {"verifications": (at(1000, "red"),)}).verdict == "red"


def test_verifications_of_several_calibrations_are_not_joined():
    with pytest.raises(DataError, match="one artefact and one calibration"):
        run(VerifyRange, {"verifications": (at(900, "green"), at(1000, "green", calibration="other"))})


@pytest.mark.parametrize("processor", [VerifyPlane, VerifySphere, VerifyStep])
def test_processors_keep_the_contract(plugin_contract, processor):
    depths = {
        VerifyPlane: plane_depth(RAY, (0.1, 0, -1), (0, 0, 1000.0)), VerifySphere: SPHERE,
        VerifyStep: stairs_depth(RAY, (0.0, 10.0)),
    }  # fmt: skip
    plugin_contract.processor(processor, {"range": image(depths[processor])})
