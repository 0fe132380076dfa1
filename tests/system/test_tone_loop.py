"""The loop of the tone curve on a simulated station: measured, put into force, verified elsewhere, watched."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import pytest
from daemonkit import SMALL, Daemon

from fringed_client.calibration_file import load_calibration

LARGER = SMALL.replace("width_px = 160\nheight_px = 120", "width_px = 232\nheight_px = 174")
STATION = LARGER.replace('object = "sphere"', 'object = "plane"')


@pytest.fixture
def daemon(tmp_path):
    started = Daemon(tmp_path, STATION).until_ready().until_worker()
    yield started
    started.end()


def fringe(daemon, *words, code=0):
    """Run `fringe`; return what it wrote as JSON."""
    done = subprocess.run(
        [sys.executable, "-m", "fringed_client.cli.main", *words, "--json"],
        env=daemon.env, cwd=daemon.folder, capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stderr + done.stdout
    return json.loads(done.stdout)


def put_in_force(daemon, path):
    """Name a calibration in the configuration and have the station read it."""
    text = daemon.config.read_text()
    old = next(line for line in text.splitlines() if line.startswith("calibration"))
    daemon.config.write_text(text.replace(old, f'calibration = "{path}"'))
    daemon.send(signal.SIGHUP)
    wanted = load_calibration(path).id
    deadline = time.monotonic() + 10
    while fringe(daemon, "tone", "show")["calibration"] != wanted:
        assert time.monotonic() < deadline, daemon.log
        time.sleep(0.1)


@pytest.mark.timeout(240)
def test_measure_verify_elsewhere_and_watch(daemon):
    measured = daemon.folder / "tone.h5"
    told = fringe(daemon, "tone", "measure", "-o", str(measured), "--plot", str(daemon.folder / "tone.png"))
    assert told["tone"]["tone_levels"] == 33
    assert told["tone"]["tone_rms"] < 0.005
    assert (daemon.folder / "tone.png").stat().st_size > 5000
    known = load_calibration(measured)
    assert 0.15 < known.tone_curve[128] < 0.3  # gamma 2.2 gives 0.22

    put_in_force(daemon, measured)
    same = fringe(daemon, "tone", "verify", code=1)
    assert "looks like the surface" in same["error"]["message"]

    fringe(daemon, "simulated", "scene", "face")
    verified = daemon.folder / "verified.h5"
    told = fringe(daemon, "tone", "verify", "-o", str(verified))
    assert told["tone"]["tone_verified"] == 1
    assert told["tone"]["tone_ripple_3_before_rad"] > 10 * told["tone"]["tone_ripple_3_rad"]
    put_in_force(daemon, verified)
    assert not fringe(daemon, "scan")["warnings"]
    assert load_calibration(verified).residuals["tone_second_harmonic"] < 0.01


@pytest.mark.timeout(240)
def test_a_drifted_projector_is_warned_of_in_the_scan(tmp_path):
    """The station keeps its old calibration while the projector's gamma has changed."""
    first = Daemon(tmp_path, STATION).until_ready().until_worker()
    try:
        fringe(first, "tone", "measure", "-o", str(tmp_path / "tone.h5"))
    finally:
        first.end()
    changed = STATION.replace('calibration = "simulated"', f'calibration = "{tmp_path / "tone.h5"}"')
    changed = changed.replace("[simulation.sensor]", "[simulation.projector]\ngamma = 1.7\n[simulation.sensor]")
    second = Daemon(tmp_path, changed).until_ready().until_worker()
    try:
        warnings = fringe(second, "scan")["warnings"]
        assert any("the projector's tone has drifted" in text for text in warnings), warnings
        fringe(second, "simulated", "scene", "sphere")
        assert fringe(second, "tone", "verify", code=5)["tone"]["tone_verified"] == 0
    finally:
        second.end()
