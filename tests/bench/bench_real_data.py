"""Real fringes: two periods of three steps and a Gray code, decoded from examples/kamino410-object1/capture.toml.

The code counts the periods of 100 px; what that says of each pixel is compared with the phase of the other period,
66.7 px, which had no part in it. They differ by noise, by wrong orders, and by the ripple that three steps have where
light does not follow grey levels. Correct orders leave less than a quarter of a period.

    python tests/bench/bench_real_data.py [--images FOLDER]
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from stationkit import figure, info

from fringed.data import FrameSet, PhaseMap
from fringed.loading import load_plugins
from fringed.testing import RecordingContext
from fringed_client.capture_images import load_capture

ROOT = Path(__file__).resolve().parents[2]
CAPTURE = ROOT / "examples" / "kamino410-object1" / "capture.toml"
IMAGES = ROOT.parent / "shared" / "data" / "kamino410-object1"
COUNTED_PX, OTHER_PX = 100.0, 200.0 / 3
OUTLIER_PX = OTHER_PX / 4


def capture(images: Path) -> FrameSet:
    """Return the set that the example describes, with its images from `images`."""
    with tempfile.TemporaryDirectory() as folder:
        text = CAPTURE.read_text().replace('images = "."', f'images = "{images}"')
        (Path(folder) / "capture.toml").write_text(text)
        return load_capture(Path(folder))[1]["object"]


def with_period(frames: FrameSet, orientation: str, period_px: float | None) -> FrameSet:
    """Return the frames of one orientation: those of one period (None: of both), and the code."""
    sequence = frames.sequence
    wanted = [
        i
        for i, frame in enumerate(sequence.frames)
        if frame.orientation == orientation
        and (frame.style == "gray" or period_px is None or abs(frame.period_px - period_px) < 0.1)
    ]
    chosen = replace(
        sequence,
        frames=tuple(sequence.frames[i] for i in wanted),
        patterns=tuple(sequence.patterns[i] for i in wanted),
    )
    return replace(frames, frames=frames.frames[wanted], sequence=chosen)


def without_code(frames: FrameSet) -> FrameSet:
    """Return the fringes alone."""
    sequence = frames.sequence
    wanted = [i for i, frame in enumerate(sequence.frames) if frame.style != "gray"]
    chosen = replace(
        sequence,
        frames=tuple(sequence.frames[i] for i in wanted),
        patterns=tuple(sequence.patterns[i] for i in wanted),
    )
    return replace(frames, frames=frames.frames[wanted], sequence=chosen)


def display_px(phase: PhaseMap) -> np.ndarray[Any, Any]:
    """Return the column or row of the display, float64, NaN where dropped."""
    return (phase.phase_rad.astype(float) - phase.initial_phase_rad) * phase.period_px / (2 * np.pi)


def decode(name: str, frames: FrameSet, **params: Any) -> PhaseMap:
    decoder = load_plugins().get("processor", name)
    phase: PhaseMap = decoder().run({"frames": frames}, decoder.Params(**params), RecordingContext(threads=2))
    return phase


def consistency(absolute: PhaseMap, wrapped: PhaseMap) -> dict[str, float]:
    """Return how far an absolute map and a wrapped one of the same surface are apart, in display pixels."""
    off = display_px(wrapped) - display_px(absolute)
    both = np.isfinite(off)
    off = off[both] - wrapped.period_px * np.rint(off[both] / wrapped.period_px)
    middle = float(np.median(off))
    return {
        "pixels": float(both.mean()),
        "bias": middle,
        "rms": float(np.sqrt(np.mean((off - middle) ** 2))),
        "outliers": float(np.mean(np.abs(off) > OUTLIER_PX)),
    }


def plain_cells(frames: FrameSet) -> np.ndarray[Any, Any]:
    """Return the cell that each pixel's bits say, read without any thought: brighter than their complements or not."""
    code = [i for i, frame in enumerate(frames.sequence.frames) if frame.style == "gray"]
    bit, cell = np.zeros(frames.frames.shape[1:], bool), np.zeros(frames.frames.shape[1:], int)
    for straight, inverse in zip(code[::2], code[1::2], strict=True):
        bit ^= frames.frames[straight] > frames.frames[inverse]
        cell = 2 * cell + bit
    return cell


def beyond_cell_px(phase: PhaseMap, frames: FrameSet) -> np.ndarray[Any, Any]:
    """Return how far the kept pixels of a map lie outside of the cell that their bits say."""
    off = np.abs(display_px(phase) - (COUNTED_PX * (plain_cells(frames) + 0.5) - 0.5)) - COUNTED_PX / 2
    return np.asarray(off[phase.rejected == 0])


def leaps(phase: PhaseMap) -> float:
    """Return the share of kept pixels half a period and more from the median of 9 x 9 kept ones around them."""
    from scipy.ndimage import median_filter

    kept = phase.rejected == 0
    dropped = -1e4
    around = median_filter(np.where(kept, display_px(phase), dropped), 9)
    inside = kept & (around > dropped / 2)
    return float(np.mean(np.abs(display_px(phase) - around)[inside] > OTHER_PX / 2))


def wall_rms_px(phase: PhaseMap) -> float:
    """Return how far the wall at the upper right is from a smooth surface of fifth degree: relief, noise and ripple."""
    wall = display_px(phase)[20:180, 900:1900]
    y, x = np.mgrid[0:1:160j, 0:1:1000j]
    terms = np.stack([x**i * y**j for i in range(6) for j in range(6 - i)], axis=-1)
    kept = np.isfinite(wall)
    fit, *_ = np.linalg.lstsq(terms[kept], wall[kept], rcond=None)
    return float(np.std(wall[kept] - terms[kept] @ fit))


def without_ripple(frames: FrameSet, phase: PhaseMap) -> PhaseMap:
    """Return the map less the harmonics that its two periods tell."""
    corrector = load_plugins().get("processor", "harmonic-correction")
    # Three steps of full contrast without a tone curve are beyond what the correction vouches for.
    params = corrector.Params(blur_terms=1, require_convergence=False)
    corrected: PhaseMap = corrector().run({"frames": frames, "phase": phase}, params, RecordingContext(threads=2))
    return corrected


def show_joint(frames: FrameSet, orientation: str) -> None:
    """Print what both periods and the code give together, and what the correction of harmonics makes of it."""
    set_ = with_period(frames, orientation, None)
    joint = decode("gray-phase-shift", set_)
    kept, beyond, jumps = float(np.mean(joint.rejected == 0)), beyond_cell_px(joint, set_), leaps(joint)
    wrong = float(np.mean(beyond > OUTLIER_PX))
    figure(
        f"real data, {orientation}: both periods and the code together",
        f"{kept:.1%} of the pixels kept; {wrong:.3%} beyond {OUTLIER_PX:.1f} px outside of the cell of their bits, "
        f"{jumps:.3%} half a period and more off their neighbours",
        "50 % kept, under 1 % of each",
        kept >= 0.5 and wrong < 0.01 and jumps < 0.01,
    )
    corrected = without_ripple(set_, joint)
    info(
        f"real data, {orientation}: the wall from a smooth surface",
        f"RMS {wall_rms_px(joint):.2f} px, with harmonic-correction {wall_rms_px(corrected):.2f} px",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=Path, default=IMAGES)
    images: Path = parser.parse_args().images
    if not images.is_dir():
        info("real data", f"skipped: {images} is not there (https://github.com/kamino410/phase-shifting)")
        return
    frames = capture(images.resolve())
    for orientation in ("columns", "rows"):
        counted = decode("gray-phase-shift", with_period(frames, orientation, COUNTED_PX))
        other = without_code(with_period(frames, orientation, OTHER_PX))
        found = consistency(counted, decode("phase-shift", other))
        figure(
            f"real data, {orientation}: the phase of 66.7 px agrees with that of 100 px",
            f"bias {found['bias']:+.2f} px, RMS {found['rms']:.2f} px, {found['outliers']:.2%} beyond "
            f"{OUTLIER_PX:.1f} px, on {found['pixels']:.1%} of the pixels",
            "bias under 0.5 px, under 1 % beyond a quarter of a period",
            abs(found["bias"]) < 0.5 and found["outliers"] < 0.01 and found["pixels"] > 0.3,
        )
        show_joint(frames, orientation)


if __name__ == "__main__":
    main()
