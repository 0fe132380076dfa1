"""Patterns of a running station: previews, designs, and scans with patterns of every shape."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fringed.errors import ConfigurationError, NotFound, UsageError
from fringed_client import Station
from fringed_client.pattern_files import full_picture

FRINGE = [sys.executable, "-W", "error", "-m", "fringed_client.cli.main", "patterns"]


def fringe(*words: str, runtime: Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(runtime)}
    done = subprocess.run([*FRINGE, *words], env=env, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    assert "Traceback" not in done.stderr
    return done


def document(*words: str, runtime: Path, code: int = 0) -> Any:
    return json.loads(fringe(*words, "--json", runtime=runtime, code=code).stdout)


def test_previews_are_what_a_scan_projects(station_runtime: Path) -> None:
    with Station(station_runtime) as station:
        pipeline = station.config()["pipelines"]["hierarchical"]
        preview = station.patterns(pipeline["encoder"], {**pipeline["encoder_params"], "steps": 3})
        taken = station.scan("hierarchical", encoder_params={"steps": 3}, process=False)
        projected = taken.frame_sets["object"].sequence
    assert preview.precompensated and (preview.width_px, preview.height_px) == (1024, 768)
    assert preview.frames == projected.frames
    assert all(np.array_equal(a, b) for a, b in zip(preview.patterns, projected.patterns, strict=True))


def test_refusals_are_errors_of_their_kind(station_runtime: Path) -> None:
    with Station(station_runtime) as station:
        with pytest.raises(NotFound, match="phase-shift"):
            station.patterns("phase-shif")
        with pytest.raises(ConfigurationError, match="problem"):
            station.patterns("phase-shift", {"steps": 1})
        with pytest.raises(UsageError, match="longer than the projector"):
            station.patterns("phase-shift", {"periods": 0.5})


def test_exact_pictures_sheet_and_lines_are_written(station_runtime: Path, tmp_path: Path) -> None:
    words = ("phase-shift", "--set", "style=triangular", "--set", "periods=16", "--size", "320x200")
    told = document(*words, "--output", str(tmp_path), runtime=station_runtime)
    assert [frame["style"] for frame in told["frames"]] == ["triangular"] * 6
    assert {Path(file).name for file in told["files"]} >= {"sheet.png", "lines.png", "patterns.json"}
    with Station(station_runtime) as station:
        sequence = station.patterns("phase-shift", {"style": "triangular", "periods": 16}, (320, 200))
    for index, frame in enumerate(told["frames"]):
        picture = cv2.imread(str(tmp_path / frame["file"]), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(picture, full_picture(sequence, index)[..., 0])


def test_encoders_and_their_parameters_are_listed(station_runtime: Path) -> None:
    listed = fringe("--list", runtime=station_runtime).stdout
    assert "multi-frequency" in listed and "phase-shift" in listed
    rows = fringe("list", "phase-shift", runtime=station_runtime).stdout.splitlines()
    steps = next(row.split("\t") for row in rows if row.startswith("steps\t"))
    assert steps == ["steps", "6", "integer 3 to 64", "equal phase steps"]
    assert "triangular" in next(row for row in rows if row.startswith("style\t"))
    fringe("list", "nobody", runtime=station_runtime, code=2)


def test_designs_are_found_for_frames_and_noise(station_runtime: Path) -> None:
    rows = {row["encoder"]: row for row in document("design", "--frames", "12", "--snr", "20", runtime=station_runtime)}
    best = rows["multi-frequency"]
    assert sum(best["steps"]) == 12 and best["failure"] <= 1e-6 and best["periods"][0] == 1
    table = fringe("design", "--frames", "12", "--snr", "20", runtime=station_runtime).stdout
    assert " ".join(map(str, best["periods"])) in table


def test_wrong_words_end_with_code_two_and_a_reason(station_runtime: Path) -> None:
    wrong = document("phase-shift", "--set", "shifts_rad=[0,1]", runtime=station_runtime, code=2)
    assert "three unknowns" in wrong["error"]["message"]
    assert "WIDTHxHEIGHT" in fringe("phase-shift", "--size", "10", runtime=station_runtime, code=2).stderr


@pytest.mark.parametrize(
    "params",
    [
        {"inverse": True},
        {"double": True, "steps": 3},
        {"dither": "ordered", "periods": [1, 12], "steps": 3},
        {"initial_phase_rad": 1.0, "periods": "auto", "frames": 12},
        {"style": "triangular", "steps": 5},
    ],
)
def test_scans_decode_patterns_of_every_kind(station_runtime: Path, params: dict[str, Any]) -> None:
    with Station(station_runtime) as station:
        result = station.scan("hierarchical", encoder_params=params, truth=True)
        found, truth = result.phase_map, result.truth
    u = (found.phase_rad - found.initial_phase_rad) * found.period_px / (2 * np.pi)
    good = (found.rejected == 0) & (truth.lit > 0) & (truth.visible > 0)
    error = np.abs(u - truth.projector_px[..., 0])[good]
    assert good.mean() > 0.2
    assert np.median(error) < 0.5
    assert (error > found.period_px / 2).mean() < 1e-3
