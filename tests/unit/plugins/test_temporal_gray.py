"""Gray code, alone and with fringes, against columns that are known."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fringe_truth import columns, run, seen
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.data import FrameSet, PatternFrame, PatternSequence, Reject
from fringed.errors import DataError, UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.decoders.gray import GrayCodeDecoder, GrayPhaseShiftDecoder
from fringed_plugins.encoders.gray import GrayCodeEncoder, GrayPhaseShiftEncoder
from fringed_plugins.encoders.sinusoidal import PhaseShiftEncoder
from fringed_plugins.phase.projection.graycode import Code, bits_needed, cell_of, line

TARGET = ProjectorTarget(1024, 768)


def encode(cls, target=TARGET, **params):
    return cls().encode(cls.Params(**params), target)


def column_of(phase):
    return (phase.phase_rad - phase.initial_phase_rad) * phase.period_px / (2 * np.pi)


@given(bits=st.integers(1, 12), cell=st.floats(2, 40), offset=st.floats(-50, 0))
def test_neighbouring_cells_differ_in_one_bit_and_all_cells_differ(bits, cell, offset):
    code = Code(bits, cell, offset)
    u = offset + cell * (np.arange(code.cells) + 0.5) - 0.5
    cells = cell_of(u, code)
    assert cells.tolist() == list(range(code.cells))
    gray = cells ^ (cells >> 1)
    words = [bin(a ^ b).count("1") for a, b in pairwise(gray)]
    assert set(words) <= {1}
    assert len(set(gray.tolist())) == code.cells


def test_lines_of_a_code_read_back_as_its_cells():
    code = Code(bits_needed(1024, 7.5), 7.5)
    lines = np.array([line(1024, code, bit) for bit in range(code.bits)]).astype(int)
    binary = np.cumsum(lines, axis=0) % 2  # a binary bit is the parity of Gray's from the coarsest on
    assert np.array_equal(binary.T @ (1 << np.arange(code.bits)[::-1]), ((np.arange(1024) + 0.5) // 7.5).astype(int))
    assert np.array_equal(line(1024, code, 2) + line(1024, code, 2, inverted=True), np.ones(1024))
    assert line(8, code, -1).all()


@pytest.mark.parametrize("threshold", ["fringes", "inverse", "white-black"])
@pytest.mark.parametrize("orientation", ["columns", "rows"])
def test_gray_and_fringes_give_the_column_of_every_pixel(threshold, orientation):
    sequence = encode(GrayPhaseShiftEncoder, threshold=threshold, orientation=orientation)
    u = columns(700, 12, 2, 1021 if orientation == "columns" else 765)
    phase = run(GrayPhaseShiftDecoder, {"frames": seen(sequence, u, gain=0.9)})
    assert phase.kind == "absolute"
    assert phase.period_px == 16.0
    assert not phase.rejected.any()
    # Half a grey level of rounding in four frames of modulation 115, and the interpolated pattern: 0.02 rad.
    assert np.abs(column_of(phase) - u).max() < 0.08


@pytest.mark.parametrize("blur_px", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("noise_dn", [0.0, 6.0])
def test_no_column_at_the_edge_of_a_stripe_is_a_period_off(blur_px, noise_dn):
    from scipy.ndimage import gaussian_filter1d

    sequence = encode(GrayPhaseShiftEncoder)
    u = columns(4000, 8, 16, 144)  # 31 columns of camera for one of the projector: every edge is sampled
    lines = [gaussian_filter1d(p[0, :, 0].astype(float), blur_px) if blur_px else p[0, :, 0] for p in sequence.patterns]
    rng = np.random.default_rng(1)
    frames = [0.5 * np.interp(u, np.arange(1024), one) + 30 + rng.normal(0, noise_dn, u.shape) for one in lines]
    shown = FrameSet(np.clip(np.rint(frames), 0, 255).astype(np.uint8), sequence)
    phase = run(GrayPhaseShiftDecoder, {"frames": shown}, min_similar_neighbours=0, min_border_modulation=0.0)
    kept = phase.rejected == 0
    assert kept.mean() > 0.99
    assert np.abs(column_of(phase) - u)[kept].max() < 4  # a quarter of a period


def third_party(periods, cell_px, bits, inverse=True, steps=3):
    """Return fringes of several periods and a code of whole cells, as others project them."""
    length, frames, lines = 1920, [], []
    u = np.arange(length)
    for group, period in enumerate(periods):
        for step in range(steps):
            shift = 2 * np.pi * step / steps
            frames.append(PatternFrame("sinusoidal", "columns", period, shift, step=step, steps=steps, group=group))
            lines.append(127.5 + 127.5 * np.cos(2 * np.pi * u / period + shift))
    code = Code(bits, cell_px)
    for bit in range(bits):
        for inverted in (False, True)[: 1 + inverse]:
            common = PatternFrame("gray", "columns", code.period_px, 0.0, code.initial_rad, bit, bits, len(periods))
            frames.append(replace(common, bit=bit, inverted=inverted))
            cell = np.floor((u + 0.5) / cell_px).astype(int)
            bright = ((cell ^ (cell >> 1)) >> (bits - 1 - bit)) & 1
            lines.append(255.0 * (bright != inverted))
    pictures = tuple(np.rint(one).astype(np.uint8).reshape(1, -1, 1) for one in lines)
    return PatternSequence("gray-phase-shift", length, 1080, tuple(frames), pictures)


def test_cells_of_a_whole_period_are_counted_with_the_help_of_another_period():
    sequence = third_party((100.0, 200 / 3), 100.0, 5)
    u = columns(900, 40, 5, 1915)
    phase = run(GrayPhaseShiftDecoder, {"frames": seen(sequence, u, noise_dn=1.0, gain=0.3)})
    kept = phase.rejected == 0
    assert kept.mean() > 0.98
    assert np.abs(column_of(phase) - u)[kept].max() < 8


def test_cells_of_a_whole_period_alone_go_wrong_nowhere():
    sequence = third_party((100.0,), 100.0, 5)
    u = columns(1900, 20, 5, 1915)
    phase = run(GrayPhaseShiftDecoder, {"frames": seen(sequence, u, noise_dn=1.0, gain=0.5)})
    kept = phase.rejected == 0
    assert kept.mean() > 0.75  # what lies at the edge of a cell may stay in doubt, and be dropped
    assert np.abs(column_of(phase) - u)[kept].max() < 50


@pytest.mark.parametrize("threshold", ["inverse", "white-black"])
def test_gray_code_alone_gives_the_cell_or_its_edge(threshold):
    sequence = encode(GrayCodeEncoder, threshold=threshold, cell_px=4.0)
    u = columns(900, 30, 3, 1020)
    phase = run(GrayCodeDecoder, {"frames": seen(sequence, u, noise_dn=1.0, gain=0.8)})
    kept = phase.rejected == 0
    assert kept.mean() > 0.99
    error = (column_of(phase) - u)[kept]
    assert np.abs(error).max() < 2.7  # half a cell, and the half pixel over which an edge is interpolated
    # Uniform over a cell has 1.15 px; pixels at edges know better.
    assert 0.9 < np.std(error) < 1.16
    assert abs(error.mean()) < 0.02


def test_a_wrong_coarse_bit_is_found_or_outvoted_but_never_believed():
    sequence = encode(GrayPhaseShiftEncoder)
    u = columns(300, 60, 20, 1000)
    shown = seen(sequence, u, noise_dn=1.0, gain=0.8)
    frames = shown.frames.astype(float)
    frames[5, 20:22, 100:103] = 255 - frames[5, 20:22, 100:103]  # a reflection in one bit's frame
    broken = replace(shown, frames=frames.astype(np.uint8))
    phase = run(GrayPhaseShiftDecoder, {"frames": broken})
    kept = phase.rejected == 0
    assert np.abs(column_of(phase) - u)[kept].max() < 8
    assert kept.mean() > 0.999


def test_a_pixel_that_is_bright_in_every_frame_is_saturated():
    sequence = encode(GrayPhaseShiftEncoder, threshold="inverse")
    shown = seen(sequence, columns(100, 20, 100, 400), gain=0.7)
    frames = shown.frames.copy()
    frames[4:, 7:12, 30:40] = 255
    phase = run(GrayPhaseShiftDecoder, {"frames": replace(shown, frames=frames)})
    assert (phase.rejected[7:12, 30:40] & Reject.SATURATED).all()
    assert (phase.rejected == 0).mean() > 0.95


def test_darkness_and_single_pixels_are_no_trouble():
    for cls, decoder in ((GrayPhaseShiftEncoder, GrayPhaseShiftDecoder), (GrayCodeEncoder, GrayCodeDecoder)):
        sequence = encode(cls)
        for shape in ((1, 1), (1, 30), (30, 1)):
            dark = FrameSet(np.zeros((len(sequence.frames), *shape), np.uint8), sequence)
            phase = run(decoder, {"frames": dark})
            assert (phase.rejected & Reject.LOW_MODULATION).all()
            assert np.isnan(phase.phase_rad).all()


def test_encoders_refuse_what_cannot_be_shown_or_counted():
    with pytest.raises(UsageError, match="cells of 2 px or more"):
        encode(GrayCodeEncoder, cell_px=1.0)
    with pytest.raises(UsageError, match="below 4 px"):
        encode(GrayPhaseShiftEncoder, period_px=3.0)
    with pytest.raises(UsageError, match="take several exposures"):
        encode(GrayPhaseShiftEncoder, levels=[1.0, 0.5])
    with pytest.raises(UsageError, match="make no fringes"):
        encode(GrayCodeEncoder, grey_low=100, grey_high=105)


def only(sequence, chosen):
    frames = [i for i, frame in enumerate(sequence.frames) if chosen(frame)]
    return replace(
        sequence, frames=tuple(sequence.frames[i] for i in frames), patterns=tuple(sequence.patterns[i] for i in frames)
    )


def test_decoders_say_what_a_set_lacks():
    whole = encode(GrayPhaseShiftEncoder)
    bits, waves = only(whole, lambda f: f.style == "gray"), only(whole, lambda f: f.style != "gray")

    def blank(sequence):
        return {"frames": FrameSet(np.zeros((len(sequence.frames), 4, 4), np.uint8), sequence)}

    with pytest.raises(DataError, match="complements"):
        run(GrayCodeDecoder, blank(bits))
    with pytest.raises(DataError, match="no Gray code"):
        run(GrayPhaseShiftDecoder, blank(waves))
    with pytest.raises(DataError, match="no fringes"):
        run(GrayPhaseShiftDecoder, blank(bits))
    with pytest.raises(DataError, match="gray-phase-shift"):
        run(GrayCodeDecoder, blank(whole))
    with pytest.raises(DataError, match=r"bits \[3\] missing"):
        run(GrayPhaseShiftDecoder, blank(only(whole, lambda f: f.bit != 3)))
    with pytest.raises(DataError, match="cannot count fringes"):
        run(GrayPhaseShiftDecoder, blank(third_party((16.0,), 100.0, 5)))
    with pytest.raises(DataError, match="decodes a Gray code alone"):
        run(GrayCodeDecoder, blank(encode(PhaseShiftEncoder)))


@settings(max_examples=30, deadline=None)
@given(
    period=st.floats(5, 60), steps=st.integers(3, 6), size=st.integers(200, 1400),
    threshold=st.sampled_from(["fringes", "inverse", "white-black"]),
)  # fmt: skip
def test_any_accepted_period_counts_every_column(period, steps, size, threshold):
    try:
        sequence = encode(
            GrayPhaseShiftEncoder, ProjectorTarget(size, 200), period_px=period, steps=steps, threshold=threshold
        )
    except UsageError:
        return
    u = np.arange(2, size - 2, dtype=float)[None]  # at pixel centres, where the pattern is what it says
    phase = run(GrayPhaseShiftDecoder, {"frames": seen(sequence, u, gain=0.9)}, min_similar_neighbours=0)
    kept = phase.rejected == 0
    assert kept.mean() > 0.98
    assert np.abs(column_of(phase) - u)[kept].max() < period / 20
