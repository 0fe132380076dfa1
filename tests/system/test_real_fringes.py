"""Somebody else's images, decoded as their capture.toml says; skipped where they are not at hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fringed.data import FrameSet, PhaseMap
from fringed.loading import load_plugins
from fringed.testing import RecordingContext
from fringed_client.capture_images import load_capture

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT.parent / "shared" / "data" / "kamino410-object1"
CELL_PX = 100.0

pytestmark = pytest.mark.skipif(
    not IMAGES.is_dir(), reason=f"{IMAGES} is not there: the images of https://github.com/kamino410/phase-shifting"
)


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> FrameSet:
    folder = tmp_path_factory.mktemp("kamino410")
    text = (ROOT / "examples" / "kamino410-object1" / "capture.toml").read_text()
    (folder / "capture.toml").write_text(text.replace('images = "."', f'images = "{IMAGES}"'))
    return load_capture(folder)[1]["object"]


def decoded(frames: FrameSet, orientation: str) -> PhaseMap:
    decoder = load_plugins().get("processor", "gray-phase-shift")
    phase: PhaseMap = decoder().run(
        {"frames": frames}, decoder.Params(orientation=orientation), RecordingContext(threads=2)
    )
    return phase


def bits_of(frames: FrameSet, orientation: str) -> list[tuple[int, int]]:
    """Return each bit's frame and that of its complement, coarse to fine."""
    code = [i for i, f in enumerate(frames.sequence.frames) if f.style == "gray" and f.orientation == orientation]
    return list(zip(code[::2], code[1::2], strict=True))


@pytest.mark.parametrize("orientation", ["columns", "rows"])
def test_most_of_the_scene_gets_an_order_that_its_bits_and_neighbours_agree_with(
    frames: FrameSet, orientation: str
) -> None:
    phase = decoded(frames, orientation)
    kept = phase.rejected == 0
    assert kept.mean() > 0.55  # 38 % of the picture lies in the dark
    display_px = (phase.phase_rad - phase.initial_phase_rad) * phase.period_px / (2 * np.pi)
    # The bits, read plainly: a pixel may lie in the next cell by the width of the edge, not by a quarter of a period.
    bit, cell = np.zeros(kept.shape, bool), np.zeros(kept.shape, int)
    for straight, inverse in bits_of(frames, orientation):
        bit ^= frames.frames[straight] > frames.frames[inverse]
        cell = 2 * cell + bit
    beyond = np.abs(display_px - (CELL_PX * (cell + 0.5) - 0.5)) - CELL_PX / 2
    assert np.mean(beyond[kept] > phase.period_px / 4) < 0.005
    pairs = kept[:, 1:] & kept[:, :-1]
    assert np.mean(np.abs(np.diff(display_px, axis=1))[pairs] > phase.period_px / 2) < 0.005


def test_the_shadow_and_the_dark_are_dropped_for_what_they_are(frames: FrameSet) -> None:
    phase = decoded(frames, "rows")
    shadow = phase.rejected[250:1000, 1150:1500]
    assert np.mean((shadow & 2) > 0) > 0.99


def test_images_of_one_period_alone_are_decoded_too(frames: FrameSet) -> None:
    """The cells are as wide as the period: what lies at their edges may stay in doubt, nothing may go wrong."""
    wanted = [i for i, f in enumerate(frames.sequence.frames) if f.orientation == "rows" and f.period_px >= CELL_PX]
    sequence = replace(
        frames.sequence,
        frames=tuple(frames.sequence.frames[i] for i in wanted),
        patterns=tuple(frames.sequence.patterns[i] for i in wanted),
    )
    alone = decoded(replace(frames, frames=frames.frames[wanted], sequence=sequence), "rows")
    both = decoded(frames, "rows")
    kept = (alone.rejected == 0) & (both.rejected == 0)
    assert kept.mean() > 0.4
    off = (alone.phase_rad * alone.period_px - both.phase_rad * both.period_px)[kept] / (2 * np.pi)
    off -= np.median(off)
    assert np.mean(np.abs(off) > CELL_PX / 2) < 0.005
