"""The real drivers on the emulated laboratory: the demo's figures, small, as a lab would run it."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="Xvfb is not installed (Debian: apt install xvfb)")
def test_phase_is_that_of_the_pure_simulation_and_cables_may_be_pulled(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "tools" / "demo_hardware.py"), "--small", "--output", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400, check=False)
    report = json.loads((tmp_path / "out" / "report.json").read_text()) if done.returncode in {0, 1} else {}
    assert report, done.stdout[-3000:] + done.stderr[-3000:]
    found = {figure["what"]: figure for figure in report["figures"]}
    timed = [what for what in found if "unplugged to" in what or "plugged to" in what]  # figures of the machine too
    missed = [f for what, f in found.items() if f["good"] is False and what not in timed]
    assert not missed and len(timed) == 6, done.stdout[-3000:]
    assert found["kept pixels of a scan after all that"]["value"] > 0.1
    assert (tmp_path / "out" / "phase-difference.png").stat().st_size > 5000
