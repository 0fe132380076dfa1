"""`fringe demo`: the folder that it promises, and figures that hold."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

FRINGE = [sys.executable, "-W", "error", "-m", "fringed_client.cli.main"]
PICTURES = ("fringes", "wrapped-phase", "mask", "depth", "error", "shaded-x-y", "shaded-oblique")
SHEETS = ("shaded-x-y", "shaded-y-z", "shaded-x-z", "shaded-oblique", "registration-error", "convergence")


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_demo_writes_models_pictures_and_an_honest_report(tmp_path: Path) -> None:
    words = ["demo", "--quick", "--output", str(tmp_path), "--json"]
    done = subprocess.run([*FRINGE, *words], capture_output=True, text=True, timeout=390, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["simulated"] and report == json.loads((tmp_path / "report.json").read_text())
    made = report["calibration"]
    assert made["found"] == made["poses"] == 12 and made["residuals"]["camera_rms_px"] < 0.05
    assert all(abs(row["relative"]) < 2e-3 and abs(row["sigmas"]) < 4 for row in made["parameters"])
    trueness_mm = made["residuals"]["trueness_rms_mm"]  # 0.1 mm with a ninth of the pixels
    assert trueness_mm < 0.2 and made["against_truth"]["rms_mm"] < 3 * trueness_mm
    for name, found in report["objects"].items():
        for number in (1, 2, 3):
            folder = tmp_path / name / f"view-{number}"
            assert all((folder / f"{picture}.png").exists() for picture in PICTURES)
            assert (folder / "range-image.ply").exists() and (folder / "range-image.h5").exists()
        assert all((tmp_path / name / f"{sheet}.png").exists() for sheet in SHEETS)
        assert (tmp_path / name / "model.ply").read_bytes()[:4] == b"ply\n"
        for view in found["views"]:
            assert abs(view["bias_mm"]) < 3 * trueness_mm
            assert view["scatter_ratio"] < 1.15
            assert view["completeness"] > 0.9  # 464 pixels: edges are a larger share than at 1392
        assert all(registration["converged"] for registration in found["registrations"])
        # three times coarser samples than at full size, of about 0.8 mm: a tenth of that, and the calibration's error
        assert found["model"]["median_abs_error_mm"] < 0.08 + 0.5 * trueness_mm
    page = (tmp_path / "report.html").read_text()
    links = set(re.findall(r'(?:src|href)="([^"#][^"]*)"', page))
    assert len(links) > 30 and all((tmp_path / link).exists() for link in links)
    assert "SIMULATED" in page


def test_interrupted_demo_leaves_no_station(tmp_path: Path) -> None:
    words = ["demo", "--quick", "--output", str(tmp_path)]
    demo = subprocess.Popen([*FRINGE, *words], stderr=subprocess.PIPE, text=True)
    assert demo.stderr is not None
    said = ""
    while "pose-03" not in said:
        said += demo.stderr.readline()
        assert demo.poll() is None, said
    demo.send_signal(signal.SIGINT)
    _, err = demo.communicate(timeout=60)
    assert (demo.returncode, "Traceback" in err) == (130, False), said + err
    assert not list(Path(tempfile.gettempdir()).glob(f"fringe-private-{demo.pid}-*"))
