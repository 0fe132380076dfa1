"""Encoders of fringes: whatever they accept can be decoded, and what they refuse they explain."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from fringed import wire
from fringed.config import validate
from fringed.errors import ConfigurationError, UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder

TARGET = ProjectorTarget(512, 384)
GAMMA = (np.arange(256) / 255.0) ** 2.2
# Amplitudes of the fundamental and of harmonic k of a light from 0 to 1 (Fourier series).
AMPLITUDE = {
    "sinusoidal": lambda k: 0.5 * (k == 1),
    "triangular": lambda k: (k % 2) * 4 / (np.pi * k) ** 2,
    "trapezoidal": lambda k: (k % 2) * 2 / (np.pi * k) * abs(np.sinc(k / 6)),
}


def encode(cls, target=TARGET, **params):
    return cls().encode(validate(params, cls.Params), target)


def line(sequence, index):
    """Return the grey levels along the phase's direction, the mean of all lines; of all channels that are lit."""
    pattern = sequence.patterns[index].max(axis=2).astype(float)
    return pattern.mean(axis=0 if sequence.frames[index].orientation == "columns" else 1)


def least_squares(sequence, indices, tone=None):
    """Return phase (minus the frames' own initial one) and modulation of a group by pseudo-inverse, and error bound."""
    frames = [sequence.frames[i] for i in indices]
    shifts = np.array([frame.shift_rad for frame in frames])
    model = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    inverse = np.linalg.pinv(model)
    light = np.array([line(sequence, i) for i in indices])
    if tone is not None:
        light = np.array([tone[sequence.patterns[i].max(axis=2)].mean(axis=0) for i in indices])
    _, c, s = inverse @ light
    return np.arctan2(s, c) - frames[0].initial_phase_rad, np.hypot(c, s), np.abs(inverse[1:]).sum()


def off(angle):
    return np.abs(np.angle(np.exp(1j * angle)))


def shape_bound(style, steps):
    """Return how far harmonics that N equal steps take for the fundamental can turn the phase.

    Where N steps see a jump (sawtooth, two levels) all light between two shifts looks alike: half a step.
    """
    if style not in AMPLITUDE:
        return np.pi / steps + 0.01
    orders = [m * steps + d for m in range(1, 60) for d in (-1, 1)]
    return math.asin(min(1.0, sum(AMPLITUDE[style](k) for k in orders if k > 1) / AMPLITUDE[style](1)))


COMMON = {
    "style": st.sampled_from(["sinusoidal", "sawtooth", "triangular", "trapezoidal", "binary"]),
    "orientation": st.sampled_from(["columns", "rows", "both"]),
    "grey_low": st.sampled_from([0.0, 10.5, 100.0]),
    "grey_high": st.sampled_from([255.0, 200.25, 120.0]),
    "channel": st.sampled_from(["white", "red", "green", "blue"]),
    "inverse": st.booleans(),
    "double": st.booleans(),
    "levels": st.sampled_from([[1.0], [1.0, 0.5], [0.25, 0.75]]),
    "initial_phase_rad": st.floats(-6, 6),
}


def check_groups(sequence, params):
    for indices in sequence.groups().values():
        frames = [sequence.frames[i] for i in indices]
        first = frames[0]
        assert (
            len({(f.period_px, f.orientation, f.channel, f.level, f.initial_phase_rad, f.steps) for f in frames}) == 1
        )
        assert [f.step for f in frames] == list(range(len(frames)))
        assert {f.steps for f in frames} == {len(frames)}
        phase, modulation, gain = least_squares(sequence, indices)
        own = [f.shift_rad for f in frames if not f.inverted]  # complements say nothing new of an ideal shape
        turns = np.unique(np.round(np.mod(own, 2 * np.pi), 6) % round(2 * np.pi, 6))
        quantisation = np.arcsin(np.minimum(1.0, 0.75 * gain / modulation))  # a complement is off by 1/4 level more
        u = np.arange(phase.size)
        pixel = 2 / first.period_px**2 + 1e-6 if first.style != "sinusoidal" else 1e-6
        bound = shape_bound(first.style, len(turns)) + quantisation + pixel * np.pi
        assert (off(phase - 2 * np.pi * u / first.period_px) <= bound).all()


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    params=st.fixed_dictionaries(
        COMMON | {"periods": st.floats(0.8, 140), "steps": st.integers(3, 9), "period_px": st.sampled_from([0.0, 16.0])}
    )
)
def test_phase_shift_is_refused_or_decoded(params):
    refused = ""
    try:
        sequence = encode(PhaseShiftEncoder, **params)
    except UsageError as refusal:
        refused = str(refusal)
    if refused:
        assert re.match(r"phase-shift: .{40,}", refused)  # a reason
        return
    check_groups(sequence, params)
    assert len(sequence.frames) == (
        params["steps"] * (1 + params["inverse"]) * (1 + params["double"]) * len(params["levels"])
        * (2 if params["orientation"] == "both" else 1)
    )  # fmt: skip


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    params=st.fixed_dictionaries(
        COMMON
        | {
            "style": st.sampled_from(["sinusoidal", "sinusoidal", "triangular", "trapezoidal", "sawtooth", "binary"]),
            "periods": st.sampled_from([[1, 8, 64], [1, 5, 20], [1, 3, 9], [1], [1, 90], [2, 8], [8, 1], "auto"]),
            "steps": st.sampled_from([3, 4, 9, 12, [3, 4, 6], [4, 7]]),
            "frames": st.integers(3, 30),
            "expected_snr": st.floats(1, 200),
        }
    )
)
def test_multi_frequency_is_refused_or_decoded_to_the_column(params):
    refused = ""
    try:
        sequence = encode(MultiFrequencyEncoder, **params)
    except UsageError as refusal:
        refused = str(refusal)
    if refused:
        assert re.match(r"multi-frequency: .{40,}", refused)  # a reason
        return
    check_groups(sequence, params)
    sets = {}
    for indices in sequence.groups().values():
        first = sequence.frames[indices[0]]
        sets.setdefault((first.orientation, first.level), []).append((first.period_px, indices))
    for (orientation, _), groups in sets.items():
        size = sequence.width_px if orientation == "columns" else sequence.height_px
        assert groups == sorted(groups, key=lambda g: -g[0])
        column = None
        for period, indices in groups:
            phase, modulation, gain = least_squares(sequence, indices)
            turns = phase / (2 * np.pi)
            turns = np.mod(turns, 1) if column is None else turns + np.rint(column / period - turns)
            column = turns * period
        error = np.mod(column - np.arange(size) + size / 2, size) - size / 2  # the first column's wrap is its own
        finest = [sequence.frames[i] for i in groups[-1][1]]
        steps = len({round(f.shift_rad, 6) for f in finest if not f.inverted})
        rad = np.arcsin(np.minimum(1.0, 0.75 * gain / modulation)) + shape_bound(params["style"], steps)
        pixel = 2 * np.pi / groups[-1][0] ** 2 if params["style"] != "sinusoidal" else 0.0
        bound = groups[-1][0] / (2 * np.pi) * (rad + pixel) + 1e-6
        assert (np.abs(error) <= bound).all()


@pytest.mark.parametrize("cls", [PhaseShiftEncoder, MultiFrequencyEncoder])
@pytest.mark.parametrize("style", ["sinusoidal", "sawtooth", "triangular", "trapezoidal", "binary", "binary-dithered"])
@pytest.mark.parametrize("orientation", ["columns", "rows", "both"])
def test_sequences_survive_the_wire(cls, style, orientation):
    periods = 16.0 if cls is PhaseShiftEncoder else [1, 4, 16]
    params = {"periods": periods, "style": style, "orientation": orientation, "inverse": True, "channel": "green"}
    sequence = encode(cls, **params, levels=[1, 0.5], steps=12 if style in ("sawtooth", "binary") else 4)
    back = wire.decode([bytes(part) for part in wire.encode(sequence)]).content
    assert back.frames == sequence.frames
    assert back.parameters == sequence.parameters
    assert all(np.array_equal(a, b) for a, b in zip(back.patterns, sequence.patterns, strict=True))


@pytest.mark.parametrize("dither", ["none", "ordered", "error-diffusion"])
@pytest.mark.parametrize("style", ["sinusoidal", "triangular"])
def test_complements_add_up_to_a_constant(style, dither):
    sequence = encode(PhaseShiftEncoder, style=style, inverse=True, grey_low=20.0, grey_high=231.0, dither=dither)
    for i in range(0, len(sequence.frames), 2):
        pattern, complement = (sequence.patterns[k].astype(int) for k in (i, i + 1))
        assert (pattern + complement == 251).all()
        a, b = sequence.frames[i], sequence.frames[i + 1]
        assert not a.inverted and b.inverted and b.shift_rad == pytest.approx(a.shift_rad + np.pi)


def test_complements_through_a_tone_curve_add_up_in_light():
    sequence = encode(PhaseShiftEncoder, ProjectorTarget(512, 384, GAMMA), inverse=True, levels=[1.0, 0.5])
    widest = np.diff(GAMMA).max() / 2
    for i in range(0, len(sequence.frames), 2):
        light = GAMMA[sequence.patterns[i]] + GAMMA[sequence.patterns[i + 1]]
        assert np.abs(light - sequence.frames[i].level).max() <= 2 * widest


def test_double_steps_are_the_steps_between():
    sequence = encode(PhaseShiftEncoder, steps=3, double=True)
    shifts = np.degrees([frame.shift_rad for frame in sequence.frames])
    assert shifts == pytest.approx([0, 120, 240, 60, 180, 300])
    six = encode(PhaseShiftEncoder, steps=6)
    for i, j in enumerate([0, 2, 4, 1, 3, 5]):
        assert np.array_equal(sequence.patterns[i], six.patterns[j])


@pytest.mark.parametrize("steps", [3, 4])
def test_double_steps_cancel_the_strongest_error_of_a_tone_curve(steps):
    # The error of N steps comes from harmonics N - 1 and N + 1 (gamma 2.2: 20 % and 1 % of the second and third), that
    # of 2 N from 2 N - 1 and 2 N + 1, which are smaller than half a grey level from 5 steps on.
    def worst(double):
        sequence = encode(PhaseShiftEncoder, steps=steps, double=double, periods=8.0)
        phase, _, _ = least_squares(sequence, range(len(sequence.frames)), GAMMA)
        return off(phase - 2 * np.pi * np.arange(512) / 64).max()

    assert worst(True) < worst(False) / 4


def test_levels_are_sets_of_their_own_the_brightest_first():
    sequence = encode(MultiFrequencyEncoder, levels=[0.25, 1.0], orientation="both", periods=[1, 8, 32])
    frames = sequence.frames
    order = [(f.orientation, f.level, f.period_px) for f in frames[::4]]
    assert order == [
        (o, level, size / n)
        for o, size in (("columns", 512), ("rows", 384)) for level in (1.0, 0.25) for n in (1, 8, 32)
    ]  # fmt: skip
    assert [f.group for f in frames] == [i // 4 for i in range(48)]
    assert max(p.max() for p, f in zip(sequence.patterns, frames, strict=True) if f.level == 0.25) == 64


def test_level_is_a_share_of_the_light_above_the_projectors_black():
    curve = 0.05 + 0.95 * GAMMA
    sequence = encode(PhaseShiftEncoder, ProjectorTarget(512, 384, curve), levels=[1.0, 0.3], periods=4.0)
    full, third = (curve[sequence.patterns[i][0, :, 0]] - 0.05 for i in (0, 6))
    assert np.abs(third - 0.3 * full).max() < np.diff(curve).max()


@pytest.mark.parametrize("style", ["binary", "binary-pulse-width", "binary-dithered"])
def test_binary_patterns_have_two_levels(style):
    sequence = encode(PhaseShiftEncoder, ProjectorTarget(512, 384, GAMMA), style=style, periods=8.0, grey_low=16.0)
    assert set(np.unique(np.concatenate([p.ravel() for p in sequence.patterns]))) == {16, 255}


@pytest.mark.parametrize("style", ["binary", "binary-pulse-width", "binary-dithered"])
def test_binary_patterns_out_of_focus_are_fringes(style):
    # A Gaussian of a sixth of the period leaves exp(-2 (pi / 6)^2) = 58 % of the fundamental and 0.7 % of harmonic 3:
    # of a square wave 0.4 % of the fundamental, which turns the phase of 4 steps by 0.004 rad (0.003 rms). Pulse
    # widths leave less. Dots of 50 % noise, blue (less than white at low frequencies), leave about as much.
    period = 32
    sequence = encode(PhaseShiftEncoder, style=style, periods=512 / period, steps=4)
    light = np.array([gaussian_filter(p[:, :, 0].astype(float), (0, period / 6)) for p in sequence.patterns])
    if style == "binary-dithered":
        light = np.array([gaussian_filter(p[:, :, 0].astype(float), period / 6) for p in sequence.patterns])[:, 64:-64]
    phase = np.arctan2(light[3] - light[1], light[0] - light[2]) - sequence.frames[0].initial_phase_rad
    error = off(phase - 2 * np.pi * np.arange(512) / period)[..., 64:-64]
    assert np.sqrt((error**2).mean()) < 0.004
    assert error.max() < 0.02


@pytest.mark.parametrize("style", ["sinusoidal", "triangular"])
@pytest.mark.parametrize("dither", ["ordered", "error-diffusion"])
def test_dithered_levels_follow_the_light_through_the_tone_curve(style, dither):
    target = ProjectorTarget(512, 384, GAMMA)
    plain, dithered = (
        encode(PhaseShiftEncoder, target, style=style, periods=8.0, steps=3, dither=d) for d in ("none", dither)
    )
    assert dithered.patterns[0].shape == (384, 512, 1)
    phase = 2 * np.pi * np.arange(512) / 64
    turns = phase / (2 * np.pi)
    wanted = (1 + np.cos(phase)) / 2 if style == "sinusoidal" else 1 - 2 * np.abs(turns - np.rint(turns))
    columns = [GAMMA[s.patterns[0]].mean(axis=0)[:, 0] for s in (plain, dithered)]
    errors = [np.sqrt(((gaussian_filter1d(c - wanted, 2))[16:-16] ** 2).mean()) for c in columns]
    assert errors[1] < (errors[0] / 3 if style == "sinusoidal" else 0.002)


def test_designed_frequencies_tell_what_they_promise():
    sequence = encode(MultiFrequencyEncoder, periods="auto", frames=15, expected_snr=8.0, orientation="both")
    design = sequence.parameters["design"]
    assert set(design) == {"columns", "rows"}
    for orientation, size in (("columns", 512), ("rows", 384)):
        periods = sorted({f.period_px for f in sequence.frames if f.orientation == orientation}, reverse=True)
        assert periods == pytest.approx([size / n for n in design[orientation]["periods"]])
        assert design[orientation]["failure"] <= 1e-6
    assert len(sequence.frames) == 30


@pytest.mark.parametrize(
    ("cls", "params", "reason"),
    [
        (PhaseShiftEncoder, {"shifts_rad": [0.0, 1.0]}, "2 different ones"),
        (PhaseShiftEncoder, {"shifts_rad": [0.0, 1.0, 1.0 + 2 * np.pi]}, "2 different ones"),
        (PhaseShiftEncoder, {"periods": 0.5}, "longer than the projector"),
        (PhaseShiftEncoder, {"period_px": 600.0}, "longer than the projector"),
        (PhaseShiftEncoder, {"period_px": 3.0}, "at most 128 periods"),
        (PhaseShiftEncoder, {"style": "binary-pulse-width"}, "use 18 px or more, or the style sinusoidal"),
        (PhaseShiftEncoder, {"style": "binary", "periods": 128.0, "steps": 8}, "patterns repeat"),
        (PhaseShiftEncoder, {"style": "binary", "periods": 8.0, "dither": "ordered"}, "has two only"),
        (PhaseShiftEncoder, {"levels": [1.0, 0.01]}, "use 0.0627 or more"),
        (PhaseShiftEncoder, {"levels": [0.5, 0.5]}, "each once"),
        (MultiFrequencyEncoder, {"periods_px": [400.0, 40.0]}, "start with 1"),
        (MultiFrequencyEncoder, {"periods": "auto", "frames": 12, "min_period_px": 400.0}, "allow shorter"),
        (MultiFrequencyEncoder, {"shifts_rad": [0.0, 0.1, 0.2]}, "add a frequency"),
        (MultiFrequencyEncoder, {"style": "binary", "periods": [1, 8]}, "ratios to 2.4, more steps"),
        (MultiFrequencyEncoder, {"style": "sawtooth", "periods": "auto"}, "or the encoder heterodyne"),
    ],
)
def test_what_cannot_be_decoded_is_refused_with_reason_and_suggestion(cls, params, reason):
    with pytest.raises(UsageError, match=reason):
        encode(cls, **params)


@pytest.mark.parametrize(
    ("curve", "params", "reason"),
    [
        (GAMMA[::-1].copy(), {}, "must rise"),
        (np.full(256, 0.7), {}, "must rise"),
        (np.clip(np.linspace(0, 1.5, 256), 0, 1), {"grey_low": 200.0}, "widen grey_low and grey_high"),
        (np.clip(np.linspace(0, 1.5, 256), 0, 1), {"precompensate": False}, "use grey_high = 17"),
        (np.where(np.arange(256) < 128, 0.0, 1.0) + np.arange(256) * 1e-6, {}, "from grey level 127 to 128"),
        (np.where(np.arange(256) == 7, np.nan, GAMMA), {}, "finite"),
    ],
)
def test_tone_curves_that_show_no_fringes_are_refused(curve, params, reason):
    with pytest.raises(UsageError, match=reason):
        encode(PhaseShiftEncoder, ProjectorTarget(512, 384, curve), **params)


def test_a_clipping_projector_is_compensated():
    curve = np.clip(np.linspace(0, 1.5, 256), 0, 1)
    sequence = encode(PhaseShiftEncoder, ProjectorTarget(512, 384, curve), periods=8.0)
    light = curve[sequence.patterns[0][0, :, 0]]
    assert np.abs(light - (1 + np.cos(2 * np.pi * np.arange(512) / 64)) / 2).max() < 0.003


def test_wrong_values_are_told_by_their_names():
    for params in ({"style": "round"}, {"dither": "some"}, {"levels": []}, {"levels": [2.0]}, {"periods": "many"}):
        with pytest.raises(ConfigurationError, match=next(iter(params))):
            encode(MultiFrequencyEncoder, **params)


def test_too_many_dithered_pictures_are_refused():
    with pytest.raises(UsageError, match="more than 256"):
        encode(PhaseShiftEncoder, ProjectorTarget(4096, 2160), dither="ordered", steps=64)
