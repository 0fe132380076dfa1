"""The reading examples of the format pages run as they stand, without this project."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from fringed import data, wire
from fringed.recording import Store
from fringed.recording.places import KIND_OF_NAME
from fringed.recording.preface import BLOCK_BYTES, FORMAT, LARGE_BYTES

DOCS = Path(__file__).resolve().parents[2] / "docs"
RECORDING = (DOCS / "recording-format.md").read_text(encoding="utf-8")
WIRE = (DOCS / "wire.md").read_text(encoding="utf-8")


def example(page: str) -> str:
    (code,) = re.findall(r"^```python norun\n(.*?)^```", page, re.M | re.S)
    return str(code)


def frame_set() -> data.FrameSet:
    frames = tuple(data.PatternFrame("sine", period_px=16.0, step=k, steps=3, shift_rad=2.0 * k) for k in range(3))
    sequence = data.PatternSequence("phase-shift", 8, 6, frames, (np.zeros((1, 8, 1), np.uint8),) * 3)
    stamps = tuple(data.FrameStamp(k + 0.0, k + 0.25, k + 0.5, k) for k in range(3))
    made = data.Provenance(simulated=True)
    images = np.full((3, 6, 8), 77, np.uint8)
    return data.FrameSet(images, sequence, id=data.new_id(), stamps=stamps, provenance=made)


def test_recording_is_read_by_the_example_without_this_project(tmp_path: Path) -> None:
    item = frame_set()
    path = Store(tmp_path).save(item)
    code = example(RECORDING) + "\nassert not [m for m in sys.modules if m.startswith('fringed')]\n"
    done = subprocess.run(
        [sys.executable, "-I", "-W", "error", "-c", code, str(path)], capture_output=True, text=True, check=False
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        f"FrameSet {item.id} simulated",
        "sine 16.0 0.0 exposed at 0.25",
        "sine 16.0 2.0 exposed at 1.25",
        "sine 16.0 4.0 exposed at 2.25",
        "brightest grey level 77",
    ]


def test_message_is_read_by_the_example() -> None:
    names: dict[str, object] = {}
    exec(example(WIRE), names)
    item = frame_set()
    topic, header, arrays = names["read"](  # type: ignore[operator]
        [memoryview(part).tobytes() for part in wire.encode(item, "frameset", 3)]
    )
    assert (topic, header["kind"], header["seq"]) == ("frameset", "FrameSet", 3)
    assert np.array_equal(arrays[header["body"]["frames"]["$array"]], item.frames)


def test_pages_state_todays_numbers_and_names() -> None:
    assert f"bytes 0 to {BLOCK_BYTES - 1}" in RECORDING
    assert f"fringed-recording {FORMAT} <length>" in RECORDING
    assert f"{LARGE_BYTES // 1024} KiB and more" in RECORDING
    assert all(f"`{name}`" in RECORDING for name in KIND_OF_NAME)
    (types,) = re.findall(r"^Types: `([^`]*)`", WIRE, re.M)
    assert set(types.split()) == set(wire.DTYPES)
    assert f"at most {wire.MAX_BUFFERS}" in WIRE
    assert f"{wire.MAX_HEADER_BYTES // 2**20} MiB" in WIRE.replace("\n", " ")
    assert f'"v": {wire.VERSION},' in WIRE
