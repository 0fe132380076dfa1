"""Grey ramp, tone response, verification, tables and harmonic correction as plug-ins: contract, refusals, drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fringe_truth import run, small_rig
from gamma_truth import field, gamma_curve, seen

from fringed.data import Calibration, FrameSet, PhaseErrorTable, PhaseMap
from fringed.errors import DataError, UsageError
from fringed.hookspecs import ProjectorTarget
from fringed.testing import RecordingContext
from fringed_plugins.decoders.correction import CorrectPhase, HarmonicCorrection, PhaseErrorTableMaker
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.decoders.tone import ToneResponse, ToneVerify
from fringed_plugins.decoders.tone_drift import second_harmonic_of, warn_of_drift
from fringed_plugins.encoders.grey_ramp import GreyRampEncoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder

RIG = small_rig(320, 90, (1024, 768))
SIZES = ProjectorTarget(1024, 768)
BENT = {"max_order_error": 0.5, "max_residual": 2.0}


def encoded(encoder, curve=None, **params):
    return encoder().encode(encoder.Params(**params), replace(SIZES, tone_curve=curve))


def taken(sequence, gamma=2.2, **more):
    u, sigma = field()
    return seen(sequence, u, sigma, gamma_curve(gamma), **more)


@pytest.fixture(scope="module")
def ramp():
    return replace(taken(encoded(GreyRampEncoder), noise_dn=0.7), id="ramp")


@pytest.fixture(scope="module")
def measured(ramp):
    return run(ToneResponse, {"frames": ramp, "calibration": RIG})


@pytest.fixture(scope="module")
def many():
    return taken(encoded(PhaseShiftEncoder, periods=64, steps=12))


@pytest.fixture(scope="module")
def scan():
    return taken(encoded(MultiFrequencyEncoder, periods=[1, 8, 64], steps=3))


def test_a_ramp_shows_every_level_and_its_ends_again_and_again():
    sequence = encoded(GreyRampEncoder, levels=33, repeats=5, channel="green")
    greys = [int(pattern.max()) for pattern in sequence.patterns]
    assert greys[:2] == [255, 0] == greys[-2:]
    assert greys.count(255) == greys.count(0) == 5
    assert set(greys) == set(np.rint(np.linspace(0, 255, 33)).astype(int))
    assert np.abs(np.corrcoef(np.arange(len(greys)), greys)[0, 1]) < 0.3  # order and level have nothing in common
    assert all(pattern.shape == (1, 1, 3) and pattern[..., [0, 2]].max() == 0 for pattern in sequence.patterns)
    assert not encoded(GreyRampEncoder, gamma_curve()).precompensated


@pytest.mark.parametrize("params", [{"grey_low": 200.0}, {"levels": 200, "grey_high": 100.0}])
def test_a_ramp_too_narrow_is_refused(params):
    with pytest.raises(UsageError, match="use 0 to 255"):
        encoded(GreyRampEncoder, **params)


def test_processors_keep_the_contract(plugin_contract, ramp, measured, many, scan):
    absolute = run(MultiFrequencyDecoder, {"frames": scan}, **BENT)
    plugin_contract.processor(ToneResponse, {"frames": ramp, "calibration": RIG})
    tables = plugin_contract.processor(PhaseErrorTableMaker, {"frames": many, "calibration": RIG}, {"steps": 3})
    plugin_contract.processor(CorrectPhase, {"phase": absolute, "calibration": tables})
    plugin_contract.processor(HarmonicCorrection, {"frames": scan, "phase": absolute})
    straight = taken(encoded(PhaseShiftEncoder, measured.tone_curve, periods=64, steps=12))
    inputs = {"plain": many, "compensated": straight, "calibration": measured}
    plugin_contract.processor(ToneVerify, inputs, {"another_surface": True})


def test_the_curve_is_added_and_all_else_kept(measured):
    assert np.abs(measured.tone_curve - gamma_curve()).max() < 2e-3
    assert measured.hash == RIG.hash
    assert measured.residuals["tone_levels"] == 33
    assert measured.residuals["tone_verified"] == 0
    assert measured.residuals["tone_rms"] < 1e-3
    known = replace(RIG, residuals={"camera_px": 0.1, "tone_ripple_3_rad": 1.0}, crosstalk=np.eye(3))
    ramp = taken(encoded(GreyRampEncoder))
    again = run(ToneResponse, {"frames": ramp, "calibration": known})
    assert again.residuals["camera_px"] == 0.1
    assert "tone_ripple_3_rad" not in again.residuals  # an older curve's
    assert again.crosstalk is not None


def test_no_calibration_no_ramp_no_light_are_explained(ramp, many):
    with pytest.raises(DataError, match="Calibrate the rig first"):
        run(ToneResponse, {"frames": ramp})
    with pytest.raises(DataError, match="take the ramp with the encoder grey-ramp"):
        run(ToneResponse, {"frames": many, "calibration": RIG})
    dark = replace(ramp, frames=ramp.frames // 64)
    with pytest.raises(DataError, match="choose the exposure"):
        run(ToneResponse, {"frames": dark, "calibration": RIG})
    with pytest.raises(DataError, match="whole periods of the mains"):
        run(ToneResponse, {"frames": ramp, "calibration": RIG}, max_rms=1e-6)


# The loop.


def fringes(curve, gain=180.0, gamma=2.2):
    plain = taken(encoded(PhaseShiftEncoder, periods=64, steps=12), gamma, gain=gain)
    straight = taken(encoded(PhaseShiftEncoder, curve, periods=64, steps=12), gamma, gain=gain)
    return {"plain": plain, "compensated": straight}


def shaded():
    u, _ = field()
    return 60 + 110 * np.exp(-(((u - 500) / 150) ** 2))


def test_a_curve_is_verified_on_another_surface(measured, ramp):
    found = run(ToneVerify, {**fringes(measured.tone_curve, shaded()), "ramp": ramp, "calibration": measured})
    kept = found.residuals
    assert kept["tone_verified"] == 1
    assert kept["tone_ripple_3_before_rad"] > 20 * kept["tone_ripple_3_rad"]
    assert kept["tone_second_harmonic_before"] > 0.1 > 20 * kept["tone_second_harmonic"]
    np.testing.assert_array_equal(found.tone_curve, measured.tone_curve)


def test_the_surface_of_the_ramp_verifies_nothing(measured, ramp):
    inputs = {**fringes(measured.tone_curve), "calibration": measured}
    with pytest.raises(DataError, match="looks like the surface that the tone curve was measured on"):
        run(ToneVerify, {**inputs, "ramp": ramp})
    with pytest.raises(DataError, match="not at hand"):
        run(ToneVerify, inputs)
    small = replace(ramp, frames=ramp.frames[:, ::2])
    with pytest.raises(DataError, match="take both alike"):
        run(ToneVerify, {**inputs, "ramp": small})
    assert run(ToneVerify, inputs, another_surface=True).residuals["tone_verified"] == 1


def test_a_wrong_curve_is_not_verified(measured):
    wrong = replace(measured, tone_curve=gamma_curve(1.6))
    context = RecordingContext()
    inputs = {**fringes(wrong.tone_curve), "calibration": wrong}
    found = ToneVerify().run(inputs, ToneVerify.Params(another_surface=True), context)
    assert found.residuals["tone_verified"] == 0
    assert [level for level, _ in context.logged] == ["warning"]
    assert "NOT verified" in context.logged[0][1]


def test_sets_that_cannot_be_compared_are_refused(measured, many, scan, ramp):
    straight = fringes(measured.tone_curve)["compensated"]
    with pytest.raises(DataError, match="plain set is not compensated, the other is not"):
        run(ToneVerify, {"plain": many, "compensated": many, "calibration": measured})
    with pytest.raises(DataError, match="one frequency in 12 or 24"):
        run(ToneVerify, {"plain": scan, "compensated": straight, "calibration": measured})
    with pytest.raises(DataError, match="has no tone curve"):
        run(ToneVerify, {"plain": many, "compensated": straight, "calibration": RIG})
    dark = replace(straight, frames=np.zeros_like(straight.frames))
    with pytest.raises(DataError, match="cannot be verified with"):
        run(ToneVerify, {"plain": dark_plain(many), "compensated": dark, "calibration": measured}, another_surface=True)


def dark_plain(frames):
    return replace(frames, frames=np.zeros_like(frames.frames))


@pytest.mark.parametrize(("gamma", "warned"), [(2.2, False), (2.25, False), (2.5, True), (1.8, True)])
def test_a_tone_that_has_drifted_is_warned_of(measured, gamma, warned):
    known = replace(measured, residuals={**measured.residuals, "tone_second_harmonic": 0.002})
    frames = taken(encoded(MultiFrequencyEncoder, known.tone_curve, periods=[1, 8, 64], steps=4), gamma)
    context = RecordingContext()
    warn_of_drift(frames, known, context)
    assert bool(context.logged) == warned
    if warned:
        assert "measure it again with `fringe tone measure`" in context.logged[0][1]


def test_drift_is_silent_where_nothing_can_be_told(measured, many, scan):
    context = RecordingContext()
    warn_of_drift(many, measured, context)  # not compensated: harmonics are expected
    warn_of_drift(many, RIG, context)
    assert not context.logged
    assert second_harmonic_of(scan) is None  # three steps
    assert second_harmonic_of(replace(many, frames=np.zeros_like(many.frames))) is None


# Tables and harmonics.


def test_a_table_of_a_plane_straightens_that_plane_and_less_another_blur(many, scan):
    tables = run(PhaseErrorTableMaker, {"frames": many, "calibration": RIG}, steps=3)
    assert [(table.steps, table.period_px) for table in tables.phase_errors] == [(3, 16.0)]
    assert tables.residuals["phase_error_3_rms_rad"] > 0.1
    bent = run(MultiFrequencyDecoder, {"frames": scan}, **BENT)
    corrected = run(CorrectPhase, {"phase": bent, "calibration": tables})
    u, _ = field()
    true = 2 * np.pi * u / 16
    before, after = (np.nanstd(found.phase_rad - true, axis=1) for found in (bent, corrected))
    middle = len(u) // 2  # blurred as the mean of the table's own field
    assert after[middle] < 0.25 * before[middle]
    assert after[0] > 0.02
    assert np.array_equal(np.isnan(bent.phase_rad), np.isnan(corrected.phase_rad))
    again = run(PhaseErrorTableMaker, {"frames": many, "calibration": tables}, steps=3)
    assert len(again.phase_errors) == 1


def test_a_table_from_a_plane_s_own_absolute_phase(scan):
    bent = run(MultiFrequencyDecoder, {"frames": scan}, **BENT)
    found = run(PhaseErrorTableMaker, {"frames": scan, "calibration": RIG, "phase": bent})
    (table,) = found.phase_errors
    assert (table.steps, table.period_px) == (3, 16.0)
    many = taken(encoded(PhaseShiftEncoder, periods=64, steps=12))
    (other,) = run(PhaseErrorTableMaker, {"frames": many, "calibration": RIG}, steps=3).phase_errors
    assert np.std(table.error_rad - other.error_rad) < 0.1 * np.std(other.error_rad)


def test_wrapped_maps_are_corrected_within_a_turn(many):
    tables = run(PhaseErrorTableMaker, {"frames": many, "calibration": RIG}, steps=4)
    wrapped = run(PhaseShiftDecoder, {"frames": taken(encoded(PhaseShiftEncoder, periods=64, steps=4))}, **{
        "max_residual": 2.0})  # fmt: skip
    corrected = run(CorrectPhase, {"phase": wrapped, "calibration": tables})
    assert np.nanmax(np.abs(corrected.phase_rad)) <= np.pi + 1e-5
    assert corrected.kind == "wrapped"


def test_wrong_tables_and_phases_are_refused(many, scan):
    bent = run(MultiFrequencyDecoder, {"frames": scan}, **BENT)
    two = (PhaseErrorTable(3, 16.0, np.zeros(64)), PhaseErrorTable(4, 16.0, np.zeros(64)))
    with pytest.raises(DataError, match="the calibration has: none"):
        run(CorrectPhase, {"phase": bent, "calibration": RIG})
    with pytest.raises(DataError, match="2 phase error tables"):
        run(CorrectPhase, {"phase": bent, "calibration": replace(RIG, phase_errors=two)})
    np.testing.assert_array_equal(
        run(CorrectPhase, {"phase": bent, "calibration": replace(RIG, phase_errors=two)}, steps=3).phase_rad,
        bent.phase_rad,
    )
    with pytest.raises(DataError, match="correct both wrapped"):
        run(CorrectPhase, {"phase": replace(bent, kind="relative"), "calibration": RIG})
    with pytest.raises(DataError, match="do not hold two or more sets of 5"):
        run(PhaseErrorTableMaker, {"frames": many, "calibration": RIG}, steps=5)
    with pytest.raises(DataError, match="needs an absolute PhaseMap"):
        run(PhaseErrorTableMaker, {"frames": scan, "calibration": RIG}, reference="plane")


def test_harmonics_come_off_a_scan_by_itself(scan):
    bent = run(MultiFrequencyDecoder, {"frames": scan}, **BENT)
    corrected = run(HarmonicCorrection, {"frames": scan, "phase": bent})
    u, _ = field()
    true = 2 * np.pi * u / 16
    before, after = (np.nanstd(found.phase_rad - true) for found in (bent, corrected))
    assert after < 0.1 * before
    assert corrected.period_px == bent.period_px


def test_harmonics_that_cannot_be_told_are_explained(scan, many):
    bent = run(MultiFrequencyDecoder, {"frames": scan}, **BENT)
    with pytest.raises(DataError, match="takes an absolute PhaseMap"):
        run(HarmonicCorrection, {"frames": scan, "phase": replace(bent, kind="wrapped")})
    with pytest.raises(DataError, match="one frequency"):
        run(HarmonicCorrection, {"frames": many, "phase": bent})
    with pytest.raises(DataError, match="decoded from these frames"):
        run(HarmonicCorrection, {"frames": scan, "phase": replace(bent, period_px=20.0)})
    sharp = seen(scan.sequence, field()[0], np.full(field()[0].shape, 0.4), gamma_curve(2.6))
    bent = run(MultiFrequencyDecoder, {"frames": sharp}, **BENT)
    with pytest.raises(DataError, match="take more steps"):
        run(HarmonicCorrection, {"frames": sharp, "phase": bent})


def test_inputs_are_of_their_types():
    assert ToneVerify.inputs["ramp"] is FrameSet
    assert ToneVerify.output is ToneResponse.output is Calibration
    assert HarmonicCorrection.output is PhaseMap
