"""One frame to a phase by the Fourier transform: against known phases, with holes, backgrounds and noise."""

from __future__ import annotations

import fringe_truth as truth
import numpy as np
import pytest

from fringed.data import CameraSettings, FrameSet, PatternFrame, PatternSequence, Reject
from fringed.errors import DataError, UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.decoders.fourier import FourierDecoder
from fringed_plugins.encoders.fourier import FourierEncoder
from fringed_plugins.phase.single_frame.bands import Band, band_around, find_carrier, noise_gain, smooth
from fringed_plugins.phase.single_frame.fourier import analytic_signal, frame_noise

TARGET = ProjectorTarget(1024, 768)
HEIGHT, WIDTH = 220, 320


def relief(width=WIDTH, height=HEIGHT, bump_px=12.0):
    """Return projector columns of a smooth relief."""
    x, y = np.arange(width), np.arange(height)[:, None]
    bump = bump_px * np.exp(-((x - width / 2) ** 2 + (y - height / 2) ** 2) / (2 * 45.0**2))
    return truth.columns(width, height, 100, 800) + bump


def sequence(periods=64, **params):
    return FourierEncoder().encode(FourierEncoder.Params(periods=periods, **params), TARGET)


def error(phase_map, u):
    period = phase_map.period_px
    return truth.wrapped(phase_map.phase_rad - 2 * np.pi * u / period - phase_map.initial_phase_rad)


@pytest.mark.parametrize("background", ["none", "inverse", "flat"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_phase_of_a_relief_is_found(background, dtype):
    u = relief()
    gain = 0.8 if dtype == np.uint8 else 0.8 * 257
    settings = CameraSettings(bits=8 if dtype == np.uint8 else 16)
    frames = truth.seen(sequence(background=background, initial_phase_rad=0.4), u, 0.0, gain=gain, dtype=dtype,
                        settings=settings)  # fmt: skip
    found = truth.run(FourierDecoder, {"frames": frames})
    assert (found.rejected == 0).mean() > 0.9
    # The relief's own second derivative within a filter of about a period bounds what is lost.
    assert np.sqrt(np.nanmean(error(found, u) ** 2)) < 0.012
    assert found.kind == "wrapped" and found.period_px == 16.0


@pytest.mark.parametrize("orientation", ["columns", "rows"])
@pytest.mark.parametrize("rises", [True, False])
def test_rows_and_mirrored_pictures_are_decoded_alike(orientation, rises):
    u = relief() if orientation == "columns" else relief(HEIGHT, WIDTH).T * 0.7
    frames = truth.seen(sequence(orientation=orientation, periods=48), u, gain=0.8).frames
    turn = (slice(None), slice(None, None, 1 if orientation == "rows" or rises else -1))
    if orientation == "rows" and not rises:
        turn = (slice(None, None, -1), slice(None))
    shown = FrameSet(frames[(slice(None), *turn)], sequence(orientation=orientation, periods=48))
    found = truth.run(FourierDecoder, {"frames": shown}, rises=rises)
    off = truth.wrapped(found.phase_rad[turn] - 2 * np.pi * u / found.period_px)
    assert (found.rejected == 0).mean() > 0.9
    assert np.sqrt(np.nanmean(off**2)) < 0.02


@pytest.mark.parametrize("background", ["none", "inverse", "flat"])
def test_stated_noise_is_the_noise(background):
    u = truth.columns(200, 120, 100, 600)
    made = sequence(background=background)
    read = CameraSettings(electrons_per_dn=1e6, read_noise_electrons=3e6)  # 3 grey levels, no shot noise
    maps = [
        truth.run(FourierDecoder, {"frames": truth.seen(made, u, 3.0, seed=s, gain=0.7, settings=read)})
        for s in range(24)
    ]  # fmt: skip
    inner = (slice(20, -20), slice(30, -30))
    phases = np.array([m.phase_rad[inner] for m in maps], float)
    scatter = np.sqrt(np.var(truth.wrapped(phases - phases[0]), axis=0, ddof=1).mean())
    stated = float(np.mean([m.sigma_rad[inner].mean() for m in maps]))
    # 24 maps of some 60 independent patches each: the ratio is known to 2 %; the background's share adds up to 10 %.
    assert 0.93 < scatter / stated < 1.15


def test_noise_bandwidth_is_that_of_least_squares_for_a_full_band():
    # A window that lets half of the plane through leaves all of the noise that one quadrature can have.
    assert noise_gain(np.ones((64, 33), np.float32), 64) == pytest.approx(1.0, rel=0.05)


def test_noise_is_estimated_from_the_frame():
    u = relief()
    frames = truth.seen(sequence(), u, 2.0, gain=0.7)
    assert np.sqrt(frame_noise(frames.frames[0].astype(np.float32)).constant_dn2) == pytest.approx(2.0, rel=0.1)


def test_hole_is_continued_and_its_surroundings_stay_right():
    u = relief()
    frames = truth.seen(sequence(), u, 1.0, gain=0.8)
    spoilt = frames.frames.copy()
    spoilt[0, 90:130, 150:180] = 255
    found = truth.run(FourierDecoder, {"frames": FrameSet(spoilt, frames.sequence)})
    assert (found.rejected[92:128, 152:178] & Reject.SATURATED).all()
    around = np.zeros(u.shape, bool)
    around[70:150, 130:200] = True
    kept = around & (found.rejected == 0)
    assert kept.sum() > 0.4 * (around.sum() - 40 * 30)
    assert np.sqrt(np.nanmean(error(found, u)[kept] ** 2)) < 0.06


def test_shadow_and_depth_step_are_dropped_with_their_reasons():
    u = relief()
    u[:, 200:] += 6.0
    frames = truth.seen(sequence(), u, 1.0, gain=0.8)
    spoilt = frames.frames.copy()
    spoilt[0, 60:120, 60:110] = 10
    found = truth.run(FourierDecoder, {"frames": FrameSet(spoilt, frames.sequence)})
    assert (found.rejected[70:110, 75:100] & Reject.LOW_MODULATION).all()
    assert (found.rejected[20:-20, 198:202] & Reject.RESIDUAL).mean() > 0.9
    assert np.nanpercentile(np.abs(error(found, u)), 99) < 0.2


def test_second_frame_removes_a_background_that_passes_for_fringes():
    u = truth.columns(WIDTH, HEIGHT, 100, 800)
    texture = 40 * np.cos(2 * np.pi * np.arange(WIDTH) / 9.0) * np.ones((HEIGHT, 1))  # inside the carrier's band
    errors = {}
    for background in ("none", "inverse"):
        frames = truth.seen(sequence(background=background), u, gain=0.6)
        textured = np.clip(frames.frames + texture + 40, 0, 255).astype(np.uint8)
        found = truth.run(FourierDecoder, {"frames": FrameSet(textured, frames.sequence)}, max_misfit=5.0)
        errors[background] = np.sqrt(np.nanmean(error(found, u)[:, 30:-30] ** 2))
    assert errors["inverse"] < 0.03 < 0.1 < errors["none"]


def test_any_frame_of_a_phase_shifting_set_decodes_alone():
    shifts = 2 * np.pi * np.arange(4) / 4
    u = truth.columns(WIDTH, HEIGHT, 100, 800)
    parts = tuple(
        PatternFrame("sinusoidal", period_px=16.0, shift_rad=s, step=k, steps=4) for k, s in enumerate(shifts)
    )
    lines = tuple(
        np.rint(127.5 + 127 * np.cos(2 * np.pi * np.arange(1024) / 16 + s)).astype(np.uint8).reshape(1, -1, 1)
        for s in shifts
    )  # fmt: skip
    frames = truth.seen(PatternSequence("phase-shift", 1024, 768, parts, lines), u, gain=0.8)
    for frame in range(4):
        for second in (True, False):
            found = truth.run(FourierDecoder, {"frames": frames}, frame=frame, use_second_frame=second)
            assert np.sqrt(np.nanmean(error(found, u) ** 2)) < 0.02


def test_carrier_is_found_off_axis():
    x, y = np.arange(300), np.arange(200)[:, None]
    picture = 100 + 40 * np.cos(2 * np.pi * (x / 12.5 + y / 60)) + 30 * np.cos(2 * np.pi * x / 150)
    along, across = find_carrier(picture, 1 / 15)
    assert along == pytest.approx(1 / 12.5, rel=0.01)
    assert across == pytest.approx(1 / 60, rel=0.1)


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (np.full((64, 300), 90.0), "no fringes stand out"),
        (np.random.default_rng(0).normal(90, 5, (64, 300)), "no fringes stand out"),
        (100 + 50 * np.cos(np.arange(20) / 2.0) + np.zeros((20, 1)), "periods across the picture"),
    ],
)
def test_picture_without_a_carrier_is_refused(picture, words):
    with pytest.raises(ValueError, match=words):
        find_carrier(picture, 1 / 15 if picture.shape[1] > 20 else 1 / 60)


def test_all_saturated_and_tiny_pictures_end_in_words():
    made = sequence()
    with pytest.raises(DataError):
        truth.run(FourierDecoder, {"frames": FrameSet(np.full((1, 60, 200), 255, np.uint8), made)})
    with pytest.raises(DataError):
        truth.run(FourierDecoder, {"frames": FrameSet(np.zeros((1, 1, 1), np.uint8), made)})
    flat = PatternSequence("grey", 1024, 768, (PatternFrame("uniform"),), (np.zeros((1, 1, 1), np.uint8),))
    with pytest.raises(DataError, match="no frame has sinusoidal"):
        truth.run(FourierDecoder, {"frames": FrameSet(np.zeros((1, 9, 9), np.uint8), flat)})


def test_one_line_is_decoded():
    u = truth.columns(400, 1, 100, 800)
    found = truth.run(FourierDecoder, {"frames": truth.seen(sequence(), u, gain=0.8)}, min_support=0.0)
    assert np.nanmax(np.abs(error(found, u)[:, 60:-60])) < 0.05


def test_memory_layout_does_not_matter():
    frame = truth.seen(sequence(), relief(), gain=0.8).frames[0].astype(np.float32)
    band, valid = band_around((700 / 320 / 16, 0.0), 0.6, 0.6, 0.5), np.ones(frame.shape, bool)
    plain = analytic_signal(frame, valid, band, threads=1)
    turned = analytic_signal(np.asfortranarray(frame), np.asfortranarray(valid), band, threads=2)
    frozen = frame.copy()
    frozen.flags.writeable = False
    again = analytic_signal(frozen, valid, band, threads=2)
    for other in (turned, again):
        assert np.allclose(plain.cosine, other.cosine, atol=1e-3) and np.allclose(plain.sine, other.sine, atol=1e-3)


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"periods": 4}, "too few for a single frame"),
        ({"periods": 300}, "at most 170 periods"),
        ({"grey_low": 100, "grey_high": 105}, "make no fringes"),
    ],
)
def test_impossible_carriers_are_refused_before_projection(params, words):
    with pytest.raises(UsageError, match=words):
        sequence(**params)


def test_band_refuses_what_a_picture_cannot_hold():
    with pytest.raises(ValueError, match="camera pixels a period"):
        band_around((0.3, 0.0), 0.5, 0.5, 0.5)
    with pytest.raises(ValueError, match="half widths"):
        band_around((0.1, 0.0), 1.5, 0.5, 0.5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (50, 33)])
@pytest.mark.parametrize("length", [1, 2, 9, 60])
def test_smoothing_is_the_convolution_with_a_triangle(shape, length):
    values = np.random.default_rng(0).normal(100, 10, shape).astype(np.float32)
    triangle = np.maximum(length - np.abs(np.arange(-length, length + 1)), 0) / length**2
    wanted = values.astype(float)
    for axis in (0, 1):
        wanted = np.apply_along_axis(lambda v: np.convolve(v, triangle)[length : length + len(v)], axis, wanted)
    for threads in (1, 2):
        assert np.allclose(smooth(values, length, threads), wanted, rtol=2e-6)


def test_windows_end_where_they_say():
    window = Band(0.1, 0.0, 0.05, 0.05, 0.5).window((100, 200))
    right = np.fft.rfftfreq(200)
    assert window[0, right < 0.0499].max() == 0 and window[0, np.isclose(right, 0.1)].min() == 1


def test_contract_is_kept(plugin_contract):
    plugin_contract.processor(FourierDecoder, {"frames": truth.seen(sequence(), relief(), 1.0, gain=0.8)})
    plugin_contract.encoder(FourierEncoder, {"background": "inverse", "channel": "green"})
