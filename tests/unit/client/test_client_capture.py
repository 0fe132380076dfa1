"""Capture folders: what is read, and every problem that is told."""

from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from fringed.config import validate
from fringed.data import CameraSettings, FrameSet, Provenance
from fringed.errors import ConfigurationError
from fringed_client.capture import CaptureDescription
from fringed_client.capture_images import load_capture
from fringed_client.capture_patterns import sequence_of
from fringed_client.capture_plan import pipeline_of
from fringed_client.capture_write import write_capture

DESCRIPTION = """
[capture]
family = "phase-shift"
projector_px = [64, 32]
[sets]
object = "object/*.png"
[[group]]
periods = 4
steps = 3
"""


def folder_of(tmp_path: Path, text: str = DESCRIPTION, images: int = 3) -> Path:
    (tmp_path / "capture.toml").write_text(text)
    for number in range(images):
        write(tmp_path / f"object/{number}.png", np.full((6, 8), 10 * number, np.uint8))
    return tmp_path


def write(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), image)


def test_frames_carry_periods_and_shifts(tmp_path: Path) -> None:
    _, sets = load_capture(folder_of(tmp_path))
    frames = sets["object"]
    assert frames.frames.shape == (3, 6, 8)
    assert [f.period_px for f in frames.sequence.frames] == [16.0] * 3
    np.testing.assert_allclose([f.shift_rad for f in frames.sequence.frames], 2 * np.pi * np.arange(3) / 3)
    row = frames.sequence.patterns[1][0, :, 0].astype(float)
    expected = 127.5 + 127.5 * np.cos(2 * np.pi * np.arange(64) / 16 + 2 * np.pi / 3)
    assert np.abs(row - expected).max() <= 0.5


def test_files_are_sorted_by_number_not_by_letter(tmp_path: Path) -> None:
    folder_of(tmp_path, DESCRIPTION.replace("steps = 3", "steps = 11"), images=11)
    _, sets = load_capture(tmp_path)
    assert list(sets["object"].frames[:, 0, 0]) == [10 * n for n in range(11)]


def test_listed_files_keep_their_order_and_shifts_are_taken(tmp_path: Path) -> None:
    text = DESCRIPTION.replace('"object/*.png"', '["object/2.png", "object/0.png", "object/1.png"]')
    _, sets = load_capture(folder_of(tmp_path, text + "shifts_deg = [0, 90, 200]\n"))
    assert list(sets["object"].frames[:, 0, 0]) == [20, 0, 10]
    assert np.rad2deg(sets["object"].sequence.frames[2].shift_rad) == pytest.approx(200)


def test_colour_images_give_the_channel_that_was_asked_for(tmp_path: Path) -> None:
    text = DESCRIPTION.replace("[sets]", 'channel = "red"\n[sets]')
    folder = folder_of(tmp_path, text, images=0)
    for number in range(3):
        write(folder / f"object/{number}.png", np.dstack([np.full((6, 8), v, np.uint8) for v in (1, 2, 3)]))
    assert load_capture(folder)[1]["object"].frames.max() == 3


def test_sixteen_bits_stay_sixteen_bits(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, DESCRIPTION.replace("[sets]", "bits = 12\n[sets]"), images=0)
    for number in range(3):
        write(folder / f"object/{number}.png", np.full((6, 8), 4000, np.uint16))
    frames = load_capture(folder)[1]["object"]
    assert frames.frames.dtype == np.uint16 and frames.settings.bits == 12


def test_every_problem_with_images_is_told_at_once(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, images=4)
    write(folder / "object/1.png", np.zeros((5, 8), np.uint8))
    write(folder / "object/2.png", np.zeros((6, 8), np.uint16))
    (folder / "object/3.png").write_bytes(b"not an image")
    with pytest.raises(ConfigurationError) as caught:
        load_capture(folder)
    text = str(caught.value)
    assert "4 images" in text and "1 too many" in text
    assert "object/1.png: 8 x 5 pixels" in text
    assert "object/2.png: 16-bit" in text
    assert "object/3.png: a file of 12 bytes that is no image" in text


def test_missing_images_are_named(tmp_path: Path) -> None:
    text = DESCRIPTION.replace('"object/*.png"', '["object/0.png", "object/7.png", "object/1.png"]')
    with pytest.raises(ConfigurationError, match=r"object/7\.png is missing"):
        load_capture(folder_of(tmp_path, text))
    (tmp_path / "object/1.png").unlink()
    (tmp_path / "capture.toml").write_text(DESCRIPTION)
    with pytest.raises(ConfigurationError, match=r"2 images .* 1 missing"):
        load_capture(tmp_path)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("periods = 4", ""), "periods"),
        (("periods = 4", "periods = 4\nperiod_px = 3"), "both"),
        (("steps = 3", "steps = 2"), ">= 3"),
        (("[capture]", "[capture]\nfamilly = 1"), "did you mean 'family'"),
        (("steps = 3", "steps = 3\nshifts_deg = [1]"), "one per step"),
    ],
)
def test_wrong_description_is_told(tmp_path: Path, change: tuple[str, str], told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        load_capture(folder_of(tmp_path, DESCRIPTION.replace(*change)))


def test_folder_without_description_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="fringe simulate"):
        load_capture(tmp_path)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    text = DESCRIPTION.replace("steps = 3", "steps = 3\nshifts_deg = [0, 100, 240]\ninitial_phase_rad = 0.5")
    described = validate(tomllib.loads(text), CaptureDescription)
    rng = np.random.default_rng(1)
    frames = FrameSet(
        rng.integers(0, 4096, (3, 6, 8)).astype(np.uint16), sequence_of(described), "object",
        settings=CameraSettings(bits=12, electrons_per_dn=51.0, read_noise_electrons=12.0),
        provenance=Provenance(simulated=True),
    )  # fmt: skip
    write_capture(tmp_path / "out", {"object": frames})
    back = load_capture(tmp_path / "out")[1]["object"]
    np.testing.assert_array_equal(back.frames, frames.frames)
    assert back.provenance.simulated and back.settings == frames.settings
    for mine, theirs in zip(back.sequence.frames, frames.sequence.frames, strict=True):
        assert mine.shift_rad == pytest.approx(theirs.shift_rad)
        assert (mine.period_px, mine.initial_phase_rad) == (theirs.period_px, theirs.initial_phase_rad)


def test_pipeline_follows_sets_and_calibration() -> None:
    multi = validate({"sets": {"object": "x"}, "group": [{"periods": 1}]}, CaptureDescription)
    both = validate({"sets": {"object": "x", "reference": "y"}, "group": [{"periods": 1}]}, CaptureDescription)
    assert pipeline_of(multi, True) == {"pipeline": "hierarchical"}
    assert [s["plugin"] for s in pipeline_of(multi, False)["stages"]] == ["multi-frequency"]
    assert pipeline_of(both, True) == {"pipeline": "thesis"}
    assert pipeline_of(both, False)["stages"][-1]["plugin"] == "unwrap-difference"


def test_examples_of_the_documentation_are_valid() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "capture-toml.md").read_text()
    blocks = [part.split("```")[0] for part in page.split("```toml capture\n")[1:]]
    assert len(blocks) == 3
    for block in blocks:
        validate(tomllib.loads(block), CaptureDescription)


def test_every_key_is_documented() -> None:
    from fringed_client.capture import CaptureTable, GroupTable, SensorTable

    page = (Path(__file__).resolve().parents[3] / "docs" / "capture-toml.md").read_text()
    for table in (CaptureTable, GroupTable, SensorTable):
        assert all(name in page for name in table.__struct_fields__)


GRAY = """
[capture]
family = "gray-phase-shift"
projector_px = [64, 32]
images = "pictures"
[sets]
object = "*.png"
[[group]]
style = "skip"
steps = 2
[[group]]
period_px = 16
steps = 3
[[group]]
style = "gray"
bits = 3
cell_px = 8
inverse = true
white = true
black = true
"""


def gray_folder(tmp_path: Path, text: str = GRAY, images: int = 13) -> Path:
    (tmp_path / "capture.toml").write_text(text)
    for number in range(images):
        write(tmp_path / f"pictures/{number}.png", np.full((6, 8), 10 * number, np.uint8))
    return tmp_path


def test_gray_code_lies_in_a_folder_of_its_own_behind_images_without_use(tmp_path: Path) -> None:
    _, sets = load_capture(gray_folder(tmp_path))
    frames = sets["object"]
    assert list(frames.frames[:, 0, 0]) == [10 * n for n in range(2, 13)]
    code = [f for f in frames.sequence.frames if f.style == "gray"]
    assert [(f.bit, f.inverted) for f in code] == [(b, i) for b in (0, 1, 2, -1) for i in (False, True)]
    assert {(f.period_px, f.group, f.steps) for f in code} == {(16.0, 1, 3)}
    shown = np.array([frames.sequence.patterns[3 + 2 * b][0, :, 0] // 255 for b in range(3)], int)
    binary = np.bitwise_xor.accumulate(shown)  # a Gray code's bit is that of the number xor the one before it
    np.testing.assert_array_equal(binary[0] * 4 + binary[1] * 2 + binary[2], np.arange(64) // 8)
    np.testing.assert_array_equal(frames.sequence.patterns[4], 255 - frames.sequence.patterns[3])


def test_both_orientations_give_two_phase_stages() -> None:
    text = GRAY + '[[group]]\nperiod_px = 16\nsteps = 3\norientation = "rows"\n'
    described = validate(tomllib.loads(text), CaptureDescription)
    stages = pipeline_of(described, calibrated=False)["stages"]
    assert [(s["name"], s["params"]) for s in stages] == [
        ("phase-columns", {"orientation": "columns"}), ("phase-rows", {"orientation": "rows"}),
    ]  # fmt: skip
    assert pipeline_of(described, calibrated=True)["stages"][-1]["inputs"] == {"phase": "phase-columns"}


def test_colour_images_carry_the_three_frames_of_a_shot(tmp_path: Path) -> None:
    text = DESCRIPTION.replace("phase-shift", "one-shot-phase-shift")
    folder = folder_of(tmp_path, text, images=0)
    write(folder / "object/0.png", np.dstack([np.full((6, 8), v, np.uint8) for v in (3, 2, 1)]))  # blue, green, red
    frames = load_capture(folder)[1]["object"]
    assert list(frames.frames[:, 0, 0]) == [1, 2, 3]
    assert [(f.shot, f.channel) for f in frames.sequence.frames] == [(0, "red"), (0, "green"), (0, "blue")]
    assert frames.sequence.patterns[0].shape == (1, 64, 3)
    write(folder / "object/0.png", np.zeros((6, 8), np.uint8))
    with pytest.raises(ConfigurationError, match="a grey image is not allowed; expected a colour image"):
        load_capture(folder)


@pytest.mark.parametrize("family", ["gray-phase-shift", "one-shot-phase-shift"])
def test_codes_and_colours_are_written_and_read_back(tmp_path: Path, family: str) -> None:
    text = GRAY if family == "gray-phase-shift" else DESCRIPTION.replace("phase-shift", family)
    sequence = sequence_of(validate(tomllib.loads(text), CaptureDescription))
    images = np.random.default_rng(1).integers(0, 256, (len(sequence.frames), 6, 8)).astype(np.uint8)
    write_capture(tmp_path / "out", {"object": FrameSet(images, sequence)})
    back = load_capture(tmp_path / "out")[1]["object"]
    np.testing.assert_array_equal(back.frames, images)
    for mine, theirs in zip(back.sequence.frames, sequence.frames, strict=True):
        same = ("style", "orientation", "bit", "inverted", "shot", "channel", "group")
        assert [getattr(mine, name) for name in same] == [getattr(theirs, name) for name in same]
        assert (mine.period_px, mine.initial_phase_rad) == pytest.approx((theirs.period_px, theirs.initial_phase_rad))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("bits = 3\n", ""), r"group\[2\]\.bits"),
        (("cell_px = 8", "cell_px = 8\nperiods = 4"), "a key of sinusoids"),
        (("gray-phase-shift", "multi-frequency"), "no Gray code in family"),
        (('style = "gray"\nbits = 3\ncell_px = 8', "periods = 4"), 'a group of style "gray"'),
        (("period_px = 16\nsteps = 3", "period_px = 16\nsteps = 2"), ">= 3 for family"),
        (("period_px = 16\nsteps = 3", "period_px = 16\nsteps = 3\nbits = 2"), "a code's key"),
    ],
)
def test_wrong_gray_description_is_told(tmp_path: Path, change: tuple[str, str], told: str) -> None:
    assert change[0] in GRAY
    with pytest.raises(ConfigurationError, match=told):
        load_capture(gray_folder(tmp_path, GRAY.replace(*change)))


def test_profiles_have_the_wanted_fundamental() -> None:
    for style in ("sinusoidal", "sawtooth", "triangular", "trapezoidal", "binary"):
        table = {
            "capture": {"family": "phase-shift", "projector_px": [64, 8]}, "sets": {"object": "x"},
            "group": [{"style": style, "period_px": 64, "steps": 3, "initial_phase_rad": 0.7}],
        }  # fmt: skip
        sequence = sequence_of(validate(table, CaptureDescription))
        for frame, pattern in zip(sequence.frames, sequence.patterns, strict=True):
            phase = np.angle(np.fft.fft(pattern[0, :, 0].astype(float))[1])
            assert abs(np.angle(np.exp(1j * (phase - 0.7 - frame.shift_rad)))) < 0.06  # 64 samples of a jump
