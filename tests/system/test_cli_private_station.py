"""Offline commands start a private station, say so, and leave nothing behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from fringed.errors import ConfigurationError
from fringed_client.calibration_file import load_calibration, load_recording
from fringed_client.private import NO_DEVICES, PrivateStation

FRINGE = [sys.executable, "-W", "error", "-m", "fringed_client.cli.main"]


@pytest.fixture
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FRINGED_RUNTIME_DIR", str(tmp_path / "none"))
    monkeypatch.setenv("FRINGED_DATA_DIR", str(tmp_path / "data"))
    return tmp_path


def left_behind() -> list[str]:
    own = f"fringe-private-{os.getpid()}-"
    return [p.name for p in Path(tempfile.gettempdir()).glob("fringe-private-*") if not p.name.startswith(own)]


def fringe(*words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([*FRINGE, *words], capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


def test_simulated_folder_is_processed_to_its_truth(alone: Path) -> None:
    done = fringe("simulate", "sphere", "--output", str(alone / "capture"), "--camera", "232x174", "--json")
    assert json.loads(done.stdout)["simulated"] and "private station" in done.stderr
    done = fringe("process", str(alone / "capture"), "--output", str(alone / "result"), "--json")
    assert "private" in done.stderr
    image = load_recording(alone / "result" / "range.h5")
    truth = np.load(alone / "capture" / "truth.npz")
    kept = image.rejected == 0
    wanted = (truth["visible"] > 0) & (truth["lit"] > 0) & (truth["is_object"] > 0)
    error = np.linalg.norm(image.xyz_mm, axis=2) - np.linalg.norm(truth["xyz_mm"], axis=2)
    assert kept[wanted].mean() > 0.9  # 232 px: the outermost ring of the sphere is a larger share than at 1392
    # n > 1000 points of sigma_mm each: the mean is good to sigma / 30, the ratio's deviation to 1 / 45
    good = kept & (np.abs(error) < 1)
    assert np.abs(error[good].mean()) < 0.02
    assert np.std(error[good] / image.sigma_mm[good]) < 1.15
    assert image.provenance.simulated
    assert load_calibration(alone / "capture" / "calibration.json").hash == image.calibration
    listed = json.loads(fringe("list", "--kind", "RangeImage", "--json").stdout)
    assert [row["id"] for row in listed] == [image.id]  # what was made offline is kept in the user's recordings


def test_thesis_folder_goes_round(alone: Path) -> None:
    fringe("simulate", "sphere", "--pipeline", "thesis", "--output", str(alone / "c"), "--camera", "232x174")
    done = json.loads(fringe("process", str(alone / "c"), "--json").stdout)["scan"]
    assert done["pipeline"] == "thesis"
    assert "RangeImage" in [p["kind"] for p in done["products"]]


def test_damaged_folder_is_refused_before_a_station_starts(alone: Path) -> None:
    (alone / "capture.toml").write_text('[sets]\nobject = "*.png"\n[[group]]\nperiods = 8\nsteps = 4\n')
    done = fringe("process", str(alone), code=2)
    assert "4 missing" in done.stderr and "private" not in done.stderr


def test_folder_that_keeps_no_pixel_ends_at_the_quality_gate(alone: Path) -> None:
    fringe("simulate", "sphere", "--output", str(alone / "c"), "--camera", "64x48")
    for path in (alone / "c").rglob("*.png"):
        cv2.imwrite(str(path), np.full((48, 64), 90, np.uint8))
    done = fringe("process", str(alone / "c"), "--output", str(alone / "r"), "--json", code=5)
    found = json.loads(done.stdout)
    assert [row["kept"] for row in found["quality"]] == [0] and "pixels kept" in found["warnings"][0]
    assert (alone / "r" / "range.h5").exists()


def test_wrong_words_for_a_private_station_are_usage_errors(alone: Path) -> None:
    wrong = fringe("simulate", "sphere", "--output", str(alone / "c"), "--option", "radius=4", code=2)
    assert "radius_mm" in wrong.stderr and not (alone / "c").exists()
    fringe("simulate", "sphere", "--output", str(alone / "c"), "--camera", "64x48")
    assert "reference" in fringe("process", str(alone / "c"), "--pipeline", "thesis", code=2).stderr
    (alone / "c" / "calibration.json").unlink()
    assert "capture.calibration" in fringe("process", str(alone / "c"), code=2).stderr
    assert "neither an id nor a file" in fringe("register", "nope", "nope", code=2).stderr


def test_private_station_ends_with_a_killed_client(alone: Path) -> None:
    code = (
        "import time; from fringed_client.private import *\n"
        "with PrivateStation(NO_DEVICES) as s: print(s.hello['pid'], flush=True); time.sleep(60)"
    )
    client = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert client.stdout is not None
    pid = int(client.stdout.readline())
    client.kill()
    client.communicate(timeout=10)
    deadline = time.monotonic() + 20
    while Path(f"/proc/{pid}").exists() and ") Z" not in Path(f"/proc/{pid}/stat").read_text():
        assert time.monotonic() < deadline, "the private station outlived its client"
        time.sleep(0.05)
    with PrivateStation(NO_DEVICES) as station:  # the next one clears what the killed one left
        assert station.status().camera.state == "ABSENT"
    assert not [name for name in left_behind() if name.startswith(f"fringe-private-{client.pid}-")]


def test_interrupted_command_stops_its_station(alone: Path) -> None:
    words = ["simulate", "face", "--output", str(alone / "c")]
    client = subprocess.Popen([*FRINGE, *words], stderr=subprocess.PIPE, text=True)
    assert client.stderr is not None
    while "acquiring" not in client.stderr.readline():
        assert client.poll() is None
    client.send_signal(signal.SIGINT)
    client.communicate(timeout=30)
    assert client.returncode == 130
    assert not [name for name in left_behind() if name.startswith(f"fringe-private-{client.pid}-")]


def test_station_that_cannot_start_tells_why(alone: Path) -> None:
    with pytest.raises(ConfigurationError, match="familly"), PrivateStation({**NO_DEVICES, "familly": 1}):
        pass


def test_named_station_has_to_be_there(alone: Path) -> None:
    assert "private" not in fringe("list", "--station", str(alone / "x"), code=3).stderr
