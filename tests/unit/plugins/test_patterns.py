"""Patterns: what is projected, and what is refused because nobody could decode it."""

from __future__ import annotations

import numpy as np
import pytest

from fringed.errors import UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder
from fringed_plugins.phase.projection import patterns

TARGET = ProjectorTarget(1024, 768)
GAMMA = (np.arange(256) / 255.0) ** 2.2


def encode(cls, target=TARGET, **params):
    return cls().encode(cls.Params(**params), target)


def test_multi_frequency_gives_twelve_lines_group_by_group():
    sequence = encode(MultiFrequencyEncoder)
    assert [frame.group for frame in sequence.frames] == [0] * 4 + [1] * 4 + [2] * 4
    assert [frame.period_px for frame in sequence.frames[::4]] == [1024, 128, 16]
    assert {pattern.shape for pattern in sequence.patterns} == {(1, 1024, 1)}
    assert sequence.groups() == {0: (0, 1, 2, 3), 1: (4, 5, 6, 7), 2: (8, 9, 10, 11)}


def test_pattern_follows_the_convention_of_the_contract():
    sequence = encode(PhaseShiftEncoder, periods=32.0, steps=5, initial_phase_rad=0.4, grey_low=20.0, grey_high=220.0)
    u = np.arange(1024)
    for frame, pattern in zip(sequence.frames, sequence.patterns, strict=True):
        wanted = 120 + 100 * np.cos(2 * np.pi * u / 32 + 0.4 + frame.shift_rad)
        assert np.abs(pattern[0, :, 0] - wanted).max() <= 0.5
        assert frame.shift_rad == pytest.approx(2 * np.pi * frame.step / 5)


def test_rows_vary_down_the_picture():
    sequence = encode(MultiFrequencyEncoder, orientation="rows", periods=[1, 8], steps=[3, 4])
    assert {pattern.shape for pattern in sequence.patterns} == {(768, 1, 1)}
    assert sequence.frames[0].period_px == 768
    assert len(sequence.frames) == 7


def test_coloured_light_has_three_channels_two_of_them_dark():
    pattern = encode(PhaseShiftEncoder, channel="red").patterns[0]
    assert pattern.shape == (1, 1024, 3)
    assert pattern[..., 0].max() == 255
    assert pattern[..., 1:].max() == 0


def test_precompensated_light_has_no_harmonics_above_quantisation():
    # Half a grey level of gamma 2.2 is at most 2.2 / 510 of the light; the harmonics of such rounding, spread over
    # the spectrum, stay below that bound for each line, where gamma itself leaves 0.2 at the second.
    sequence = encode(PhaseShiftEncoder, ProjectorTarget(1024, 768, GAMMA), periods=8.0)
    plain = encode(PhaseShiftEncoder, periods=8.0)
    assert sequence.precompensated
    assert not plain.precompensated

    def harmonics(grey):
        spectrum = np.abs(np.fft.rfft(GAMMA[grey])) / 512
        return spectrum[[16, 24, 32, 40]].max() / spectrum[8]

    assert harmonics(plain.patterns[0][0, :, 0]) > 0.1
    for pattern in sequence.patterns:
        assert harmonics(pattern[0, :, 0]) < 2.2 / 510


def test_precompensation_can_be_switched_off():
    sequence = encode(PhaseShiftEncoder, ProjectorTarget(1024, 768, GAMMA), precompensate=False)
    assert not sequence.precompensated
    assert np.array_equal(sequence.patterns[0], encode(PhaseShiftEncoder).patterns[0])


@pytest.mark.parametrize(
    ("cls", "params", "reason"),
    [
        (PhaseShiftEncoder, {"steps": 2}, "three unknowns"),
        (PhaseShiftEncoder, {"periods": 300.0}, "at most 256 periods"),
        (PhaseShiftEncoder, {"periods": float("nan")}, "above 0"),
        (PhaseShiftEncoder, {"grey_low": 100.0, "grey_high": 90.0}, "use 0 and 255"),
        (MultiFrequencyEncoder, {"periods": [8, 64]}, r"start with 1, as in \[1, 8, 64\]"),
        (MultiFrequencyEncoder, {"periods": [1, 64]}, "add a frequency of about 8"),
        (MultiFrequencyEncoder, {"periods": [1, 8, 300]}, "at most 256 periods"),
        (MultiFrequencyEncoder, {"periods": [8, 1]}, "rise"),
        (MultiFrequencyEncoder, {"periods": [1, 8], "steps": [4]}, "one number, or one for each"),
        (MultiFrequencyEncoder, {"steps": 2}, "three unknowns"),
    ],
)
def test_what_cannot_be_decoded_is_refused_with_reason_and_suggestion(cls, params, reason):
    with pytest.raises(UsageError, match=reason):
        encode(cls, **params)


def test_better_signal_allows_a_larger_ratio():
    sequence = encode(MultiFrequencyEncoder, periods=[1, 64], expected_snr=100.0)
    assert len(sequence.frames) == 8


def test_falling_tone_curve_is_refused():
    with pytest.raises(UsageError, match="must rise"):
        encode(PhaseShiftEncoder, ProjectorTarget(1024, 768, GAMMA[::-1].copy()))


def test_flat_parts_of_a_tone_curve_are_bridged():
    curve = np.clip(np.linspace(-0.1, 1.1, 256), 0, 1)
    grey = patterns.grey_levels(np.linspace(0, 1, 50), 0, 255, curve)
    assert np.abs(curve[grey] - np.linspace(0, 1, 50)).max() < 0.003  # half a step of the curve
