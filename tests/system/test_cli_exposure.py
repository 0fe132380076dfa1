"""`fringe exposure` and the scan that it names, on a small simulated station."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

FRINGE = [sys.executable, "-W", "error", "-m", "fringed_client.cli.main"]


def fringe(*words, runtime, code=0):
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(runtime)}
    done = subprocess.run([*FRINGE, *words], env=env, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def test_exposure_is_suggested_drawn_and_leads_to_a_scan_that_passes(station_runtime: Path, tmp_path: Path):
    picture = tmp_path / "exposure.png"
    found = json.loads(fringe("exposure", "--json", "-o", str(picture), runtime=station_runtime))
    assert picture.stat().st_size > 5000
    assert found["enough"] and found["served"] > 0.98
    assert len(found["measured_us"]) == 3 and sum(found["histogram"]["pixels"]) > 1000
    # A white plane needs 8,333 us for 80 % of full scale, 10,400 us for all of it; the brightest skin is a bit darker.
    full_scale_us = found["quantiles_us"]
    assert 10400 < full_scale_us["0.99"] < 1.5 * 10400
    # The shortest exposure spares the brightest pixels, the longest is no longer than what saturates the darkest.
    assert found["exposures_us"][0] < full_scale_us["0.99"]
    assert found["exposures_us"][0] <= found["exposures_us"][-1] < full_scale_us["0.01"]
    command = found["next"].split()
    assert command[:2] == ["fringe", "scan"]
    scanned = json.loads(fringe(*command[1:], "--json", runtime=station_runtime))
    assert scanned["scan"]["state"] == "done"
    told = fringe("exposure", "--snr", "15", runtime=station_runtime)
    assert "enough" in told and "SIMULATED" in told


def test_range_that_no_exposure_covers_ends_with_the_quality_code(station_runtime: Path):
    told = fringe("exposure", "--most", "1", "--snr", "90", runtime=station_runtime, code=5)
    assert "does not cover the range" in told
