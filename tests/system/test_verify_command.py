"""`fringe verify` against a small simulated station: artefacts it has, one that it is given, and what is refused."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fringed.data import RangeImage
from fringed_client import Station

FRINGE = [sys.executable, "-W", "error", "-m", "fringed_client.cli.main"]


def fringe(*words: str, runtime: Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(runtime)}
    done = subprocess.run([*FRINGE, *words], env=env, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    assert "Traceback" not in done.stderr
    return done


def document(*words: str, runtime: Path, code: int = 0) -> Any:
    return json.loads(fringe(*words, "--json", runtime=runtime, code=code).stdout)


@pytest.fixture
def rig(station_runtime: Path) -> Iterator[Path]:
    """Yield the station's folder; the face is before the rig again afterwards."""
    yield station_runtime
    fringe("simulated", "scene", "face", runtime=station_runtime)


def scene(name: str, rig: Path, *words: str) -> None:
    fringe("simulated", "scene", name, *words, runtime=rig)


def ball_bar() -> RangeImage:
    """Return two spheres of 25 mm radius, 200 mm apart, as a pinhole camera of 300 x 220 px sees them."""
    v, u = np.mgrid[:220, :300]
    ray = np.stack([(u - 149.5) / 750, (v - 109.5) / 750, np.ones(u.shape)], axis=-1)
    depth = np.full(u.shape, np.inf)
    for centre in ([-100.0, 0.0, 1000.0], [100.0, 0.0, 1000.0]):
        a, b = np.einsum("...i,...i", ray, ray), ray @ centre
        root = b * b - a * (np.dot(centre, centre) - 25.0**2)
        depth = np.where(root > 0, np.minimum(depth, (b - np.sqrt(np.maximum(root, 0))) / a), depth)
    seen = np.isfinite(depth)
    depth = np.where(seen, depth + np.random.default_rng(3).normal(0, 0.03, depth.shape), np.nan)
    xyz = (ray * depth[..., None]).astype(np.float32)
    return RangeImage(xyz, np.where(seen, 0, 32).astype(np.uint16), np.full(u.shape, 100, np.uint8))


def test_sphere_is_measured_reported_and_listed_with_its_drift(rig: Path, tmp_path: Path) -> None:
    scene("sphere", rig)
    first = document("verify", "sphere", "--radius", "60", "--temperature", "21.5", runtime=rig)
    assert first["artefact"] == "sphere" and first["simulated"] and first["temperature_c"] == 21.5
    assert abs(first["figures"]["radius"] - 60) < 4 * first["figures"]["radius_u"] < 0.1
    told = document("verify", "sphere", "--radius", "60", "--average", "3", "-o", str(tmp_path / "out"), runtime=rig)
    assert told["figures"]["noise"] < 0.7 * first["figures"]["noise"]
    assert any("probing error" in line for line in told["drift"])
    assert {Path(f).name for f in told["files"]} == {"report.html", "verification.png", "verification.json"}
    assert all(Path(f).stat().st_size > 500 for f in told["files"])
    assert told["verification"] in (tmp_path / "out" / "report.html").read_text()
    rows = document("verify", "list", "--limit", "2", runtime=rig)
    assert [row["verification"] for row in rows] == [told["verification"], first["verification"]]
    assert rows[0]["calibration"] == first["calibration"] != ""
    text = fringe("verify", "list", runtime=rig).stdout
    assert first["verification"] in text and "SIM" in text
    drawn = document("view", told["verification"], "-o", str(tmp_path / "seen"), runtime=rig)["files"]
    assert drawn and all(Path(f).stat().st_size > 2000 for f in drawn)


def test_plane_and_steps_hold(rig: Path) -> None:
    scene("plane", rig)
    plane = document("verify", "plane", runtime=rig)
    assert plane["verdict"] in ("green", "yellow") and 0 < plane["figures"]["flatness_error"] < 0.3
    scene("steps", rig)
    steps = document("verify", "step", "--heights", "10,20,30,40", runtime=rig)
    assert abs(steps["figures"]["step_error"]) < 4 * steps["figures"]["step_error_u"] < 0.2
    assert "GREEN" in fringe("verify", "step", "--heights", "10,20", "--limit", "step_error=0.5", runtime=rig).stdout


def test_red_ends_with_the_quality_code_and_says_so_in_words(rig: Path) -> None:
    scene("sphere", rig)
    done = fringe("verify", "sphere", "--radius", "61", "--limit", "probing_error_size=0.1", runtime=rig, code=5)
    assert "RED: does NOT hold" in done.stdout and "probing error, size" in done.stdout


def test_ball_bar_of_a_recorded_range_image(rig: Path) -> None:
    with Station(rig) as station:
        given = station.add(ball_bar())
    told = document("verify", "ball-bar", "--radius", "25", "--spacing", "200", "--range", given, runtime=rig)
    assert told["artefact"] == "ball-bar"
    assert abs(told["figures"]["sphere_spacing_error"]) < 4 * told["figures"]["sphere_spacing_error_u"] < 0.05


def test_ball_bar_before_the_rig(rig: Path) -> None:
    options = ("--option", "radius_mm=45", "--option", "spacing_mm=200")
    scene("ball-bar", rig, *options, "--rotation", "0,15,20")
    told = document("verify", "ball-bar", "--radius", "45", "--spacing", "200", runtime=rig)
    assert abs(told["figures"]["sphere_spacing_error"]) < 4 * told["figures"]["sphere_spacing_error_u"] < 0.2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("sphere", "--radius", "0.06"), "given in metres"),
        (("sphere", "--radius", "120"), "diameter"),
        (("ball-bar", "--spacing", "200"), "2 spheres should be in view"),
        (("plane",), "no plane"),
        (("step", "--heights", "10"), "parallel"),
        (("sphere", "--radius", "60", "--limit", "roundness=1"), "no figure roundness"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(rig: Path, words: tuple[str, ...], said: str) -> None:
    scene("sphere", rig)
    assert said in document("verify", *words, runtime=rig, code=1)["error"]["message"]


def test_options_that_contradict_each_other_are_refused(rig: Path) -> None:
    assert "leave one out" in document("verify", "plane", "--range", "x.h5", "--average", "2", runtime=rig,
                                       code=2)["error"]["message"]  # fmt: skip
    assert (
        "expected millimetres" in document("verify", "step", "--heights", "a", runtime=rig, code=2)["error"]["message"]
    )
