"""Three patterns in one exposure: phases on grey, coloured and moving surfaces, and their noise."""

from __future__ import annotations

from dataclasses import replace

import colour_truth as colour
import fringe_truth as truth
import numpy as np
import pytest

from fringed.data import FrameSet, PatternSequence
from fringed.errors import DataError, UsageError
from fringed.hookspecs import ProjectorTarget
from fringed.testing import RecordingContext
from fringed_plugins.decoders.one_shot import OneShotFrequenciesDecoder, OneShotPhaseShiftDecoder
from fringed_plugins.encoders.one_shot import OneShotFrequenciesEncoder, OneShotPhaseShiftEncoder
from fringed_plugins.phase.colours.colour import balance
from fringed_plugins.phase.single_frame.single_frame_rules import check_carriers, order_margin

TARGET = ProjectorTarget(1024, 768)
HEIGHT, WIDTH = 200, 300
X, Y = np.arange(WIDTH), np.arange(HEIGHT)[:, None]
RELIEF = 15 * np.exp(-((X - 150) ** 2 + (Y - 100) ** 2) / (2 * 45.0**2))
U = truth.columns(WIDTH, HEIGHT, 100, 760) + RELIEF
KNOWN = replace(
    truth.small_rig(), crosstalk=colour.MIX, residuals={f"black_{c}_dn": 2.0 for c in ("red", "green", "blue")}
)
STAINED = np.stack([0.8 + 0.15 * np.sin(X / 60 + k) * np.cos(Y / 45 + 2 * k) for k in range(3)])


def steps(**params):
    return OneShotPhaseShiftEncoder().encode(OneShotPhaseShiftEncoder.Params(**params), TARGET)


def carriers(periods=(25, 40, 64), **params):
    """Return three carriers, coarser than the default ones: the pictures here are small."""
    return OneShotFrequenciesEncoder().encode(OneShotFrequenciesEncoder.Params(periods=list(periods), **params), TARGET)


def decoded(frame_set, decoder=OneShotPhaseShiftDecoder, calibration=KNOWN, **params):
    return truth.run(decoder, {"frames": frame_set, "calibration": calibration}, **params)


def rms(phase_map, u=U):
    off = truth.wrapped(phase_map.phase_rad - 2 * np.pi * u / phase_map.period_px - phase_map.initial_phase_rad)
    return float(np.sqrt(np.nanmean(off**2)))


@pytest.mark.parametrize("orientation", ["columns", "rows"])
def test_unmixed_steps_on_a_grey_surface_leave_only_noise(orientation):
    u = U if orientation == "columns" else 0.9 * truth.columns(HEIGHT, WIDTH, 100, 700).T + RELIEF
    made = steps(orientation=orientation, initial_phase_rad=0.7)
    found = decoded(colour.shots(made, u))
    assert (found.rejected == 0).mean() > 0.97
    assert found.orientation == orientation and found.kind == "wrapped"
    assert rms(found, u) < 1.15 * float(np.nanmedian(found.sigma_rad))


def test_crosstalk_left_in_costs_more_than_the_noise():
    frames = colour.shots(steps(), U)
    assert rms(decoded(frames)) < 0.02
    raw = replace(truth.small_rig(), crosstalk=np.eye(3))
    assert rms(decoded(frames, calibration=raw)) > 0.045


@pytest.mark.parametrize(
    ("balanced", "surface", "limit"),
    [
        ("none", colour.GREY, 0.02),
        ("global", colour.MILD, 0.03),
        ("local", colour.MILD, 0.03),
        ("local", STAINED, 0.03),
        ("white", colour.MILD, 0.03),
        ("white", STAINED, 0.03),
    ],
)
def test_balance_makes_coloured_surfaces_right(balanced, surface, limit):
    frames = colour.shots(steps(white=balanced == "white"), U, reflectance=surface)
    assert rms(decoded(frames, balance=balanced)) < limit


def test_coloured_surface_without_balance_is_wrong():
    frames = colour.shots(steps(), U, reflectance=colour.MILD)
    assert rms(decoded(frames, balance="none")) > 0.1


def test_balance_takes_the_white_frame_by_itself():
    frames = colour.shots(steps(white=True), U, reflectance=STAINED)
    assert np.array_equal(decoded(frames).phase_rad, decoded(frames, balance="white").phase_rad, equal_nan=True)
    with pytest.raises(DataError, match="white = true"):
        decoded(colour.shots(steps(), U), balance="white")


@pytest.mark.parametrize("white", [False, True])
@pytest.mark.parametrize("surface", [colour.GREY, colour.MILD])
def test_stated_noise_is_the_noise(surface, white):
    made = steps(white=white)
    method = "white" if white else "none"
    settings = replace(colour.shots(made, U).settings, electrons_per_dn=1e6, read_noise_electrons=1.5e6)
    maps = [
        decoded(replace(colour.shots(made, U, surface, seed_offset=100 * s), settings=settings), balance=method)
        for s in range(10)
    ]  # fmt: skip
    phases = np.array([m.phase_rad for m in maps], float)
    scatter = np.sqrt(np.nanmean(np.var(truth.wrapped(phases - phases[0]), axis=0, ddof=1)))
    stated = np.sqrt(np.nanmean(maps[0].sigma_rad.astype(float) ** 2))
    assert scatter == pytest.approx(stated, rel=0.04)


@pytest.mark.parametrize("surface", [colour.GREY, colour.MILD, STAINED])
def test_three_carriers_give_an_absolute_phase(surface):
    found = decoded(colour.shots(carriers(), U, reflectance=surface), OneShotFrequenciesDecoder)
    assert found.kind == "absolute" and found.period_px == 16.0
    column = found.phase_rad * found.period_px / (2 * np.pi)
    assert (found.rejected == 0).mean() > 0.85
    assert np.nanmax(np.abs(column - U)) < 0.5  # no order wrong anywhere
    assert np.sqrt(np.nanmean((column - U) ** 2)) < 0.04
    assert np.nanmin(found.confidence) > 0


def test_three_carriers_along_rows_and_mirrored():
    v = truth.columns(HEIGHT, WIDTH, 60, 700).T + 0.5 * RELIEF
    made = carriers(orientation="rows", periods=[20, 31, 48], expected_phase_noise_rad=0.03)
    found = decoded(colour.shots(made, v), OneShotFrequenciesDecoder)
    assert np.nanmax(np.abs(found.phase_rad * found.period_px / (2 * np.pi) - v)) < 0.5
    shown = colour.shots(carriers(), U)
    mirrored = decoded(replace(shown, frames=shown.frames[:, :, ::-1]), OneShotFrequenciesDecoder, rises=False)
    assert np.nanmax(np.abs(mirrored.phase_rad[:, ::-1] * 16 / (2 * np.pi) - U)) < 0.5


def test_wrong_orders_behind_a_step_are_dropped_or_right():
    u = U.copy()
    u[:, 180:] += 90.0
    found = decoded(colour.shots(carriers(), u), OneShotFrequenciesDecoder)
    column = found.phase_rad * found.period_px / (2 * np.pi)
    away = np.abs(X - 180) > 25
    assert np.nanmax(np.abs(column - u)[:, away]) < 1.0
    assert (np.abs(column - u) > 8.0).mean() < 0.01


def test_one_shot_holds_still_what_moves():
    """A sphere crosses the view: three exposures ripple, one exposure of three colours does not."""

    def seen_at(time):
        depth = np.sqrt(np.maximum(80.0**2 - (X - 140 - 3.0 * time) ** 2 - (Y - 100) ** 2, 0))
        return truth.columns(WIDTH, HEIGHT, 100, 760) + 0.4 * depth + 2.0 * time

    made = steps()
    middle = seen_at(1)
    once = decoded(colour.shots(made, middle))
    one_by_one = [colour.shots(made, seen_at(t)).frames[t] for t in range(3)]
    thrice = decoded(FrameSet(np.array(one_by_one), made))
    smooth = np.hypot(X - 143, Y - 100) < 55
    errors = []
    for found in (once, thrice):
        off = truth.wrapped(found.phase_rad - 2 * np.pi * middle / found.period_px)[smooth]
        errors.append(float(np.sqrt(np.nanmean((off - np.nanmedian(off)) ** 2))))
    assert errors[0] < 0.02
    assert errors[1] > 5 * errors[0]


def test_unknown_crosstalk_is_warned_of():
    frame_set, context = colour.shots(steps(), U), RecordingContext()
    OneShotPhaseShiftDecoder().run({"frames": frame_set}, OneShotPhaseShiftDecoder.Params(), context)
    assert any(level == "warning" and "colour-bars" in text for level, text in context.logged)


def test_saturated_and_dark_pixels_are_dropped():
    frame_set = colour.shots(steps(), U)
    spoilt = frame_set.frames.copy()
    spoilt[1, 20:40, 30:60] = 255
    spoilt[:, 100:140, 100:150] = 3
    found = decoded(FrameSet(spoilt, frame_set.sequence))
    assert (found.rejected[20:40, 30:60] & 1).all() and (found.rejected[105:135, 105:145] & 2).all()
    nothing = decoded(FrameSet(np.full_like(spoilt, 255), frame_set.sequence), balance="none")
    assert (nothing.rejected != 0).all() and np.isnan(nothing.phase_rad).all()


def test_sets_that_are_no_shot_are_refused():
    made = steps()
    plain = PatternSequence("x", 1024, 768, tuple(replace(f, shot=-1) for f in made.frames), made.patterns)
    frames = colour.shots(made, U).frames
    with pytest.raises(DataError, match="part of a shot"):
        decoded(FrameSet(frames, plain))
    two = PatternSequence("x", 1024, 768, made.frames[:2], made.patterns[:2])
    with pytest.raises(DataError, match="no frame in blue"):
        decoded(FrameSet(frames[:2], two))
    with pytest.raises(DataError, match="decode with one-shot-frequencies"):
        decoded(colour.shots(carriers(), U))


@pytest.mark.parametrize(
    ("periods", "words"),
    [
        ([25, 27, 64], "bands of 25 and 27 periods overlap"),
        ([64, 40, 25], "three rising numbers"),
        ([5, 20, 64], "too few for a single frame"),
        ([25, 40, 400], "at most 170 periods"),
        ([16, 32, 64], "differ by only"),
    ],
)
def test_carriers_that_cannot_be_separated_or_unwrapped_are_refused(periods, words):
    with pytest.raises(UsageError, match=words):
        carriers(periods=periods)


def test_default_carriers_leave_a_margin_for_noise():
    check_carriers(1024, OneShotFrequenciesEncoder.Params().periods, 0.05)
    assert order_margin([16, 32, 64]) < 1e-6 < order_margin([25, 40, 64])


def test_steps_that_the_projector_cannot_show_are_refused():
    with pytest.raises(UsageError, match="at most 256 periods"):
        steps(periods=400)


def test_balance_names_what_it_lacks():
    with pytest.raises(ValueError, match="period"):
        balance(np.ones((3, 8, 8), np.float32), "local")


def test_patterns_of_a_shot_are_one_picture():
    made = steps(white=True)
    assert [f.shot for f in made.frames] == [0, 0, 0, 1, 1, 1]
    assert all(p is made.patterns[0] or np.array_equal(p, made.patterns[0]) for p in made.patterns[:3])
    assert (made.patterns[3] == 255).all()


def test_contract_is_kept(plugin_contract):
    inputs = {"frames": colour.shots(steps(), U), "calibration": KNOWN}
    plugin_contract.processor(OneShotPhaseShiftDecoder, inputs)
    plugin_contract.processor(OneShotFrequenciesDecoder, {**inputs, "frames": colour.shots(carriers(), U)})
    plugin_contract.encoder(OneShotPhaseShiftEncoder, {"white": True})
    plugin_contract.encoder(OneShotFrequenciesEncoder)
