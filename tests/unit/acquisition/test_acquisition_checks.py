from __future__ import annotations

import numpy as np
import pytest
from acquisition_fakes import NOISY, SHAPE, Scene, exposed, sinusoids

from fringed.acquisition.checks import SetCheck, check_frames
from fringed.config import CheckConfig
from fringed.data import FrameStamp, PatternFrame, PatternSequence
from fringed.errors import DataError

LIMITS = CheckConfig(saturated_max=0.3)
SEQUENCES = {"3x4": sinusoids(), "1x6": sinusoids((16,), 6), "rows": sinusoids((1, 4, 12), 4, "rows")}


def lights(sequence, scene, gamma=1.0):
    return np.array([scene.light(sequence, i, gamma) for i in range(len(sequence.frames))])


def taken(light, seed=0):
    rng = np.random.default_rng(seed)
    return np.array([exposed(frame, rng) for frame in light])


def names(report):
    return {finding.fault for finding in report.findings}


@pytest.mark.parametrize("albedo", [0.9, 0.3, 0.1])
@pytest.mark.parametrize("sequence", SEQUENCES.values(), ids=SEQUENCES)
@pytest.mark.parametrize("kind", ["plane", "object"])
def test_clean_set_passes(sequence, kind, albedo):
    light = lights(sequence, Scene(albedo=albedo, kind=kind))
    for seed in range(5):
        report = check_frames(taken(light, seed), sequence, NOISY, LIMITS)
        assert report.passed, report.findings
        assert report.lit_fraction > 0.2


@pytest.mark.parametrize("albedo", [0.9, 0.3])
@pytest.mark.parametrize("sequence", SEQUENCES.values(), ids=SEQUENCES)
@pytest.mark.parametrize("fault", ["late", "blended", "torn", "repeated"])
def test_fault_of_any_frame_is_found_and_the_frame_is_named(sequence, fault, albedo):
    scene = Scene(albedo=albedo)
    light = lights(sequence, scene)
    idle = scene.light(sequence, -1)
    for index in range(1 if fault == "repeated" else 0, len(light)):
        before = light[index - 1] if index else idle
        wrong = light.copy()
        if fault == "late":
            wrong[index] = before
        elif fault == "blended":
            wrong[index] = 0.5 * light[index] + 0.5 * before
        elif fault == "torn":
            wrong[index, SHAPE[0] // 2 :] = before[SHAPE[0] // 2 :]
        frames = taken(wrong, index)
        if fault == "repeated":
            frames[index] = frames[index - 1]
        report = check_frames(frames, sequence, NOISY, LIMITS)
        assert not report.passed, f"frame {index}"
        groups = sequence.groups()
        group = groups[sequence.frames[index].group]
        assert any(set(finding.frames) & set(group) for finding in report.findings), report.findings
        if index > group[0]:  # inside a group nothing else explains it
            assert fault in names(report), report.findings


@pytest.mark.parametrize("sequence", SEQUENCES.values(), ids=SEQUENCES)
def test_whole_set_that_is_one_pattern_late_is_found(sequence):
    scene = Scene()
    light = lights(sequence, scene)
    shifted = np.concatenate([scene.light(sequence, -1)[None], light[:-1]])
    report = check_frames(taken(shifted), sequence, NOISY, LIMITS)
    assert not report.passed
    assert "late" in names(report)


def test_first_frame_of_a_group_that_shows_the_last_of_the_group_before_is_found():
    sequence = SEQUENCES["3x4"]
    light = lights(sequence, Scene())
    light[8] = light[7]
    report = check_frames(taken(light), sequence, NOISY, LIMITS)
    assert [finding.frames for finding in report.findings] == [(8,)]


@pytest.mark.parametrize("fault", ["late", "torn"])
def test_groups_of_three_are_judged_by_their_siblings(fault):
    sequence = sinusoids((8, 12, 16), 3)
    light = lights(sequence, Scene())
    assert check_frames(taken(light), sequence, NOISY, LIMITS).passed
    for index in range(1, 9):
        wrong = light.copy()
        rows = slice(None) if fault == "late" else slice(SHAPE[0] // 2, None)
        wrong[index, rows] = light[index - 1, rows]
        report = check_frames(taken(wrong, index), sequence, NOISY, LIMITS)
        assert not report.passed, f"frame {index}"


def test_tone_curve_that_nobody_undid_is_no_fault_of_a_frame():
    sequence = SEQUENCES["3x4"]
    light = lights(sequence, Scene(), gamma=2.2)
    assert check_frames(taken(light), sequence, NOISY, LIMITS).passed
    light[6] = light[5]
    assert not check_frames(taken(light), sequence, NOISY, LIMITS).passed


def test_pattern_shown_twice_on_purpose_is_not_called_repeated():
    one = sinusoids((16,), 4)
    frames = (*one.frames, *(PatternFrame("sinusoid", "columns", f.period_px, f.shift_rad, 0.0, f.step, 4, 1)
                             for f in one.frames))  # fmt: skip
    twice = PatternSequence("test", one.width_px, one.height_px, frames, one.patterns * 2)
    light = lights(twice, Scene())
    noiseless = np.round(light).astype(np.uint8)  # equal to the last bit
    assert "repeated" not in names(check_frames(noiseless, twice, NOISY, LIMITS))


def test_single_patterns_are_judged_for_exact_repeats_only():
    frames = (PatternFrame("black", group=0), PatternFrame("white", group=1), PatternFrame("black", group=2))
    patterns = tuple(np.full((1, 1, 1), level, np.uint8) for level in (0, 255, 0))
    sequence = PatternSequence("test", 256, 192, frames, patterns)
    images = taken(lights(sequence, Scene()))
    assert check_frames(images, sequence, NOISY, LIMITS).passed
    images[1] = images[0]
    assert names(check_frames(images, sequence, NOISY, LIMITS)) >= {"repeated"}


def test_ten_bit_frames_are_judged_on_their_own_scale():
    sequence = SEQUENCES["3x4"]
    light = lights(sequence, Scene())
    rng = np.random.default_rng(1)
    electrons = light * 51 + rng.standard_normal(light.shape) * np.sqrt(light * 51 + 144)
    images = np.clip(np.round(electrons / 51 * 1023 / 255), 0, 1023).astype(np.uint16)
    settings = type(NOISY)(bits=10, electrons_per_dn=51 * 255 / 1023, read_noise_electrons=12.0)
    assert check_frames(images, sequence, settings, LIMITS).passed
    images[5] = images[4]
    assert not check_frames(images, sequence, settings, LIMITS).passed


def test_saturated_and_unlit_sets_are_told_apart():
    sequence = SEQUENCES["1x6"]
    light = lights(sequence, Scene(kind="plane"))
    assert names(check_frames(taken(light * 2.5), sequence, NOISY, CheckConfig())) == {"saturated"}
    dark = np.full((6, *SHAPE), 3.0)
    report = check_frames(taken(dark), sequence, NOISY, CheckConfig())
    assert names(report) == {"unlit"}
    assert report.lit_fraction == 0


def stamps(count):
    return [FrameStamp(i * 0.2, i * 0.2 + 0.05, i * 0.2 + 0.06, i) for i in range(count)]


def judged(changed, skipped=None, delay_s=0.05):
    sequence = SEQUENCES["1x6"]
    check = SetCheck(sequence, NOISY, LIMITS)
    for index, image in enumerate(taken(lights(sequence, Scene()))):
        check.add(index, image)
    return check.finish(tuple(changed), skipped, delay_s)


def test_times_and_counters_are_judged():
    good = stamps(6)
    assert judged(good).passed
    early = [*good[:2], FrameStamp(0.4, 0.44, 0.45, 2), *good[3:]]
    assert [(f.fault, f.frames) for f in judged(early).findings] == [("exposure", (2,))]
    over = [*good[:2], FrameStamp(0.4, 0.59, 0.61, 2), *good[3:]]
    assert [(f.fault, f.frames) for f in judged(over).findings] == [("exposure", (2,))]
    swapped = [*good[:2], FrameStamp(0.4, 0.45, 0.46, 1), *good[3:]]
    assert [(f.fault, f.frames) for f in judged(swapped).findings] == [("order", (2,))]
    lost = judged(good, {4: 2})
    assert names(lost) == {"dropped"} and lost.counters_skipped == 2
    assert names(judged(good[:5])) == {"count"}


def test_set_with_a_frame_missing_is_no_set():
    sequence = SEQUENCES["1x6"]
    check = SetCheck(sequence, NOISY, LIMITS)
    check.add(0, taken(lights(sequence, Scene()))[0])
    report = check.finish(())
    assert names(report) == {"count"}
    with pytest.raises(DataError, match="expected"):
        check_frames(np.zeros((5, 8, 8), np.uint8), sequence, NOISY, LIMITS)
