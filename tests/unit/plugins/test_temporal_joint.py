"""Heterodyne and number-theoretic sets against columns that are known."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from fringe_truth import columns, intensities, run, seen
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.data import CameraSettings, FrameSet, PatternSequence, Reject
from fringed.errors import DataError, UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.decoders.heterodyne import HeterodyneDecoder
from fringed_plugins.decoders.number_theoretic import NumberTheoreticDecoder
from fringed_plugins.encoders.heterodyne import HeterodyneEncoder
from fringed_plugins.encoders.number_theoretic import NumberTheoreticEncoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder
from fringed_plugins.phase.decode import Keep
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group
from fringed_plugins.phase.temporal.absolute import decode_joint
from fringed_plugins.phase.temporal.joint import find_orders, search_of
from fringed_plugins.phase.temporal.sets import repeat_px

TARGET = ProjectorTarget(1024, 768)
PAIRS = [(HeterodyneEncoder, HeterodyneDecoder), (NumberTheoreticEncoder, NumberTheoreticDecoder)]
OPEN = Thresholds(modulation_dn=0.0, modulation_snr=0.0, residual=10.0, similar_neighbours=0, border_glow=0.0)


def encode(cls, target=TARGET, **params):
    return cls().encode(cls.Params(**params), target)


def column_of(phase):
    return (phase.phase_rad - phase.initial_phase_rad) * phase.period_px / (2 * np.pi)


def groups_and_frames(u, periods, steps=4, modulation=80.0, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    groups, frames = [], []
    for index, period in enumerate(periods):
        shifts = tuple(2 * np.pi * np.arange(steps) / steps)
        groups.append(Group(tuple(range(index * steps, (index + 1) * steps)), shifts, period))
        frames.append(intensities(u, period, steps, modulation=modulation))
    stack = np.concatenate(frames)
    return groups, (stack + rng.normal(0, noise, stack.shape) * (noise > 0)).astype(np.float32)


@pytest.mark.parametrize(("encoder", "decoder"), PAIRS)
@pytest.mark.parametrize("orientation", ["columns", "rows"])
def test_default_set_gives_the_column_of_every_pixel(encoder, decoder, orientation):
    sequence = encode(encoder, orientation=orientation)
    u = columns(600, 24, 3, (1020 if orientation == "columns" else 764))
    phase = run(decoder, {"frames": seen(sequence, u, gain=0.9)})
    assert phase.kind == "absolute"
    assert not phase.rejected.any()
    # Half a grey level of rounding in 12 frames of modulation 115, and the interpolated pattern: 0.02 rad of 16 px.
    assert np.abs(column_of(phase) - u).max() < 0.06


@pytest.mark.parametrize("periods", [[59.0, 64.0, 70.0], [56.0, 63.0, 64.0], [30.0, 31.0], [49.5, 57.25, 64.0]])
def test_classic_and_uneven_frequencies_are_unwrapped(periods):
    u = columns(600, 8, 3, 1020)
    sequence = encode(HeterodyneEncoder, periods=periods, expected_snr=60.0)
    phase = run(HeterodyneDecoder, {"frames": seen(sequence, u, gain=0.9)})
    assert not phase.rejected.any()
    assert np.abs(column_of(phase) - u).max() < 0.1


def test_the_search_finds_the_order_that_trying_all_of_them_finds():
    periods = np.array([1024 / 49, 1024 / 57, 16.0])
    rng = np.random.default_rng(3)
    u = rng.uniform(0, 1023, (3, 150))
    turns = u / periods[:, None, None] + rng.normal(0, 0.03, (3, *u.shape))
    wrapped = (2 * np.pi * (turns - np.rint(turns))).astype(np.float32)
    light = rng.uniform(20, 80, wrapped.shape).astype(np.float32)
    noise = (9.0, 0.0)
    search = search_of(periods, 1024, (0,) * 3, (0.5,) * 3, noise, systematic_rad=0.0)
    found = find_orders(wrapped, light, np.zeros(u.shape, np.float32), search, threads=1)
    # Independently: weighted least squares over all triples of orders, in columns, without any lattice.
    weight = (2 * np.pi) ** 2 * light.astype(float) ** 2 / (0.5 * noise[0])
    best = np.full(u.shape, np.inf)
    column = np.zeros(u.shape)
    for shift in product((-1, 0, 1), repeat=2):
        for order in range(-1, 65):
            near = (wrapped[2] / (2 * np.pi) + order) * 16.0
            guess = [
                np.rint(near / p - w / (2 * np.pi)) + s for p, w, s in zip(periods, wrapped, (*shift, 0), strict=True)
            ]
            phases = [w / (2 * np.pi) + k for w, k in zip(wrapped, guess, strict=True)]
            mean = sum(w * t / p for w, t, p in zip(weight, phases, periods, strict=True))
            mean = mean / sum(w / p**2 for w, p in zip(weight, periods, strict=True))
            cost = sum(w * (t - mean / p) ** 2 for w, t, p in zip(weight, phases, periods, strict=True))
            column, best = np.where(cost < best, mean, column), np.minimum(cost, best)
    off = (found.turns * 16.0 - column + 512) % 1024 - 512  # the set repeats after the projector's width
    assert np.abs(off).max() < 1e-2  # float32 of columns up to 1024, and of weights
    assert np.allclose(found.best, best, rtol=1e-3, atol=2e-2)


def test_all_periods_average_the_noise_and_sigma_tells_it():
    u = columns(300, 200, 20, 1000)
    periods = [1024 / 56, 1024 / 63, 16.0]
    groups, frames = groups_and_frames(u, periods, noise=4.0)
    for combine, bound in ((True, np.sum(1 / np.square(periods)) ** -0.5), (False, 16.0)):
        got = decode_joint(
            frames, groups, NoiseModel(16.0, 0.0), OPEN, 1024, combine=combine, systematic_rad=0.0, threads=1
        )
        assert (got.rejected != 0).mean() < 1e-3  # chi^2 of two beyond 20 happens to 4 pixels of 100,000
        error = (got.phase_rad * 16 / (2 * np.pi) - u)[got.rejected == 0]
        wanted = bound * np.sqrt(0.5) * 4.0 / 80.0 / (2 * np.pi)
        # 60,000 pixels know a deviation to 0.3 %; 3 % leave room for what weights of measured modulations cost.
        assert np.std(error) == pytest.approx(wanted, rel=0.03)
        assert np.nanmedian(got.sigma_rad) * 16 / (2 * np.pi) == pytest.approx(wanted, rel=0.03)


def test_confidence_tells_how_often_orders_are_wrong():
    u = columns(400, 400, 40, 980)
    groups, frames = groups_and_frames(u, [1024 / 56, 1024 / 63, 16.0], noise=16.0)  # 5 times the noise
    alone, keep = replace(OPEN, window_snr=0.0), Keep(wrapped=True, confidence=True)
    got = decode_joint(
        frames, groups, NoiseModel(256.0, 0.0), alone, 1024, systematic_rad=0.0, keep=keep, threads=1
    )  # fmt: skip
    assert np.isfinite(got.confidence).all()
    sure = got.confidence > 1.5
    wrong = sure & ~(np.abs(got.phase_rad * 16 / (2 * np.pi) - u) < 8) & (got.rejected == 0)
    assert sure.mean() > 0.2
    assert wrong.sum() <= 1e-3 * sure.sum()


def test_every_pixel_dropped_or_one_pixel_is_no_trouble():
    sequence = encode(HeterodyneEncoder)
    for shape in ((1, 1), (1, 40), (40, 1), (5, 7)):
        dark = FrameSet(np.zeros((12, *shape), np.uint8), sequence)
        phase = run(HeterodyneDecoder, {"frames": dark})
        assert (phase.rejected & Reject.LOW_MODULATION).all()
        assert np.isnan(phase.phase_rad).all()
    lit = run(HeterodyneDecoder, {"frames": seen(sequence, np.array([[500.0]]), gain=0.9)}, min_similar_neighbours=0)
    assert column_of(lit)[0, 0] == pytest.approx(500.0, abs=0.06)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, np.float64])
def test_frames_of_any_type_and_layout_give_the_same_phase(kind):
    u = columns(64, 20, 100, 800)
    groups, frames = groups_and_frames(u, [1024 / 56, 1024 / 63, 16.0])
    whole = np.rint(frames).astype(kind)
    wanted = decode_joint(whole, groups, NoiseModel(1.0, 0.0), OPEN, 1024, threads=1).phase_rad
    for variant in (np.asfortranarray(whole), whole[:, ::1].copy(), np.repeat(whole, 2, axis=2)[:, :, ::2]):
        variant.flags.writeable = False
        got = decode_joint(variant, groups, NoiseModel(1.0, 0.0), OPEN, 1024, threads=2).phase_rad
        assert np.array_equal(got, wanted, equal_nan=True)


def test_nan_in_float_frames_drops_that_pixel_alone():
    u = columns(64, 20, 100, 800)
    groups, frames = groups_and_frames(u, [1024 / 56, 1024 / 63, 16.0])
    frames[5, 7, 9] = np.nan
    got = decode_joint(frames, groups, NoiseModel(1.0, 0.0), OPEN, 1024, threads=1)
    assert np.argwhere(~np.isfinite(got.phase_rad)).tolist() == [[7, 9]]


REFUSALS = [
    (HeterodyneEncoder, {"periods": [56.0, 64.0]}, "128 px apart share all phases"),
    (HeterodyneEncoder, {"periods": [63.0, 64.0], "expected_snr": 3.0}, "wrong fringe order"),
    (HeterodyneEncoder, {"periods": [64.0]}, "two or more"),
    (HeterodyneEncoder, {"periods": [64.0, 63.0]}, "long to short"),
    (HeterodyneEncoder, {"periods": [63.0, 64.0], "steps": [3, 3, 3]}, "numbers of steps"),
    (HeterodyneEncoder, {"periods": [300.0, 301.0]}, "px"),
    (NumberTheoreticEncoder, {"periods_px": [17.0, 15.0]}, "255 px apart"),
    (NumberTheoreticEncoder, {"periods_px": [18.0, 16.0]}, "144 px apart"),
    (NumberTheoreticEncoder, {"frames": 6, "expected_snr": 2.0}, "number-theoretic set of 6 frames"),
]


@pytest.mark.parametrize(("encoder", "params", "said"), REFUSALS)
def test_sets_that_nobody_could_decode_are_refused_with_a_suggestion(encoder, params, said):
    with pytest.raises(UsageError, match=said):
        encode(encoder, **params)


def test_suggestion_of_a_refusal_is_accepted():
    with pytest.raises(UsageError) as refused:
        encode(HeterodyneEncoder, periods=[56.0, 64.0], steps=6)
    periods, steps = (
        [float(n) for n in text.split("]")[0].split(",")] for text in str(refused.value).split("[")[1:3]
    )  # fmt: skip
    sequence = encode(HeterodyneEncoder, periods=periods, steps=[int(n) for n in steps])
    assert len(sequence.frames) == 12


def test_decoder_refuses_periods_that_leave_columns_alike():
    u = columns(64, 8, 100, 800)
    sequence = encode(MultiFrequencyEncoder, periods=[1, 8, 64])
    some = [i for i, frame in enumerate(sequence.frames) if frame.group > 0]
    frames = seen(sequence, u, gain=0.9)
    half = PatternSequence(
        family="heterodyne", width_px=1024, height_px=768, frames=tuple(sequence.frames[i] for i in some),
        patterns=tuple(sequence.patterns[i] for i in some),
    )  # fmt: skip
    with pytest.raises(DataError, match="128 px apart share all phases"):
        run(HeterodyneDecoder, {"frames": FrameSet(frames.frames[some], half)})


def test_one_orientation_of_two_has_to_be_chosen():
    sequence = encode(HeterodyneEncoder, orientation="both")
    blank = FrameSet(np.zeros((len(sequence.frames), 4, 4), np.uint8), sequence)
    with pytest.raises(DataError, match="choose one of columns, rows"):
        run(HeterodyneDecoder, {"frames": blank})
    assert run(HeterodyneDecoder, {"frames": blank}, orientation="rows").orientation == "rows"


@settings(max_examples=40, deadline=None)
@given(
    periods=st.lists(st.floats(8, 80), min_size=2, max_size=4, unique=True),
    steps=st.integers(3, 6),
    size=st.integers(300, 1400),
    data=st.data(),
)
def test_a_set_is_refused_or_gives_the_column_back(periods, steps, size, data):
    lengths = sorted((float(p) for p in periods), reverse=True)
    target = ProjectorTarget(size, 200)
    try:
        sequence = encode(NumberTheoreticEncoder, target, periods_px=lengths, steps=steps, expected_snr=100.0)
    except UsageError:
        return
    assert repeat_px(lengths, size) is None
    u = np.array([data.draw(st.lists(st.floats(2, size - 3), min_size=12, max_size=12))])
    frames = np.concatenate([intensities(u, f.period_px, 1, 120.0, 100.0, f.shift_rad) for f in sequence.frames])
    deep = np.rint(frames * 200).astype(np.uint16)  # rounding a hundred times below the noise it was checked for
    quiet = CameraSettings(bits=16, electrons_per_dn=1e6, read_noise_electrons=1e6)
    phase = run(
        NumberTheoreticDecoder, {"frames": FrameSet(deep, sequence, settings=quiet)}, min_similar_neighbours=0,
        systematic_rad=0.0, min_border_modulation=0.0,
    )  # fmt: skip
    assert not phase.rejected.any()
    assert np.abs(column_of(phase) - u).max() < 0.01
