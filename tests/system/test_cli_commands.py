"""`fringe` against a small simulated station: what people type, what programs read, exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
FRINGE = [sys.executable, "-W", "error", "-m", "fringed_client.cli.main"]


def fringe(*words: str, runtime: Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(runtime)}
    done = subprocess.run([*FRINGE, *words], env=env, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    assert "Traceback" not in done.stderr
    return done


def document(*words: str, runtime: Path, code: int = 0) -> Any:
    return json.loads(fringe(*words, "--json", runtime=runtime, code=code).stdout)


def test_scan_list_get_export_view_register(station_runtime: Path, tmp_path: Path) -> None:
    run = station_runtime
    assert document("status", runtime=run)["simulated"] is True
    found = document("scan", "--truth", "--output", str(tmp_path / "scan"), runtime=run)["scan"]
    kinds = {p["kind"]: p["id"] for p in found["products"]}
    assert set(kinds) == {"PhaseMap", "RangeImage", "Truth"}
    assert found["timings_s"]["last_frame_to_range_image"] > 0
    assert {p.name for p in (tmp_path / "scan").iterdir()} >= {"object.h5", "range.h5", "range.ply", "scan.json"}
    image = kinds["RangeImage"]
    assert image in [row["id"] for row in document("list", "--kind", "RangeImage", runtime=run)]
    assert document("get", image, runtime=run)["arrays"]["xyz_mm"]["shape"] == [174, 232, 3]
    assert "SIMULATED" in fringe("get", image, runtime=run).stdout
    for name in ("a.h5", "a.npz", "a.ply", "a.png"):
        fringe("get", image, "-o", str(tmp_path / name), runtime=run)
        assert (tmp_path / name).stat().st_size > 1000
    files = document("export", image, "-f", "pcd", "-f", "xyz", "-o", str(tmp_path), runtime=run)["files"]
    assert [Path(f).suffix for f in files] == [".pcd", ".xyz"]
    fringe("simulated", "scene", "face", "--rotation", "0,15,0", runtime=run)
    other = document("scan", runtime=run)["scan"]
    fringe("simulated", "scene", "face", runtime=run)
    turned = next(p["id"] for p in other["products"] if p["kind"] == "RangeImage")
    merged = document("register", image, turned, runtime=run)["scan"]
    assert [p["kind"] for p in merged["products"]] == ["Model"]
    drawn = document("view", merged["products"][0]["id"], "-o", str(tmp_path / "pictures"), runtime=run)["files"]
    assert len(drawn) == 6 and all(Path(f).stat().st_size > 5000 for f in drawn)
    points = tmp_path / "a.ply"
    refused = document("register", str(points), str(points), runtime=run, code=2)
    assert "--pair" in refused["error"]["message"]
    told = document("register", image, str(points), "--pair", "--param", "search=none", runtime=run)
    assert told["quality"][0]["converged"] and abs(told["quality"][0]["rotation_deg"]) < 0.05
    wish = ("--param", "surface=open", "--param", "voxel_mm=2")
    meshed = document("register", image, turned, *wish, runtime=run)["scan"]
    stl = document("export", meshed["products"][0]["id"], "-f", "stl", "-o", str(tmp_path), runtime=run)["files"]
    assert Path(stl[0]).stat().st_size > 100_000


def test_parameters_reach_the_patterns_and_the_stages(station_runtime: Path) -> None:
    run = station_runtime
    found = document("scan", "--encoder", "steps=5", "--param", "phase.min_modulation_dn=9", runtime=run)["scan"]
    assert document("get", found["frame_sets"]["object"], runtime=run)["arrays"]["frames"]["shape"][0] == 15
    wrong = document("scan", "--encoder", "stepps=5", runtime=run, code=2)
    assert "stepps" in wrong["error"]["message"]


def test_thesis_pipeline_takes_both_sets_and_reuses_a_reference(station_runtime: Path) -> None:
    run = station_runtime
    first = document("scan", "--pipeline", "thesis", runtime=run)["scan"]
    assert set(first["frame_sets"]) == {"reference", "object"}
    used = f"reference={first['frame_sets']['reference']}"
    again = document("scan", "--pipeline", "thesis", "--use", used, runtime=run)["scan"]
    assert again["frame_sets"]["reference"] == first["frame_sets"]["reference"]
    offline = document("process", used, f"object={again['frame_sets']['object']}", runtime=run)["scan"]
    assert offline["pipeline"] == "thesis" and offline["state"] == "done"


def test_wrong_words_are_usage_errors_that_help(station_runtime: Path) -> None:
    run = station_runtime
    assert "Did you mean 'scan'" in fringe("scam", runtime=run, code=2).stderr
    assert "hierarchical" in fringe("scan", "--pipeline", "nope", runtime=run, code=2).stderr
    assert "key=value" in fringe("scan", "--camera", "red", runtime=run, code=2).stderr
    assert "stage.key=value" in fringe("scan", "--param", "red=1", runtime=run, code=2).stderr
    assert "frameset" in fringe("watch", "pictures", runtime=run, code=2).stderr
    assert "fringe list" in fringe("process", "/nowhere", runtime=run, code=2).stderr


def test_lease_of_somebody_else_refuses_the_scan(station_runtime: Path) -> None:
    run = station_runtime
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(run)}
    holder = subprocess.Popen([*FRINGE, "lease", "hold", "--holder", "ann"], env=env, stderr=subprocess.PIPE)
    try:
        assert holder.stderr is not None
        holder.stderr.readline()
        assert "ann" in fringe("scan", runtime=run, code=4).stderr
        assert document("lease", "show", runtime=run)["holder"] == "ann"
        assert document("lease", "break", "--reason", "a test", runtime=run)["broken"] == "ann"
    finally:
        holder.send_signal(signal.SIGINT)
        holder.communicate(timeout=20)
    fringe("scan", runtime=run)


def test_watch_prints_one_line_of_json_for_each_message(station_runtime: Path) -> None:
    lines = fringe("watch", "state", "--count", "2", "--json", runtime=station_runtime).stdout.splitlines()
    assert [json.loads(line)["kind"] for line in lines] == ["StationState"] * 2


def test_interrupt_cancels_the_scan_and_exits_130(station_runtime: Path) -> None:
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(station_runtime)}
    words = ["scan", "--encoder", "steps=60", "--json"]
    process = subprocess.Popen([*FRINGE, *words], env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    while "acquiring" not in process.stderr.readline():
        assert process.poll() is None, "the scan ended before it could be interrupted"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert json.loads(out)["error"]["exit_code"] == 130
    deadline = time.monotonic() + 20
    while document("status", runtime=station_runtime)["scan"]:
        assert time.monotonic() < deadline


def test_scan_never_starts_a_station(tmp_path: Path) -> None:
    done = fringe("scan", runtime=tmp_path / "none", code=3)
    assert "fringed run" in done.stderr and "private" not in done.stderr


def test_plugins_quarantine_and_latency(station_runtime: Path) -> None:
    run = station_runtime
    names = [p["name"] for p in document("plugins", runtime=run)["plugins"]]
    assert {"phase", "triangulation", "registration", "exporters"} <= set(names)
    assert document("quarantine", "show", runtime=run) == []
    assert document("quarantine", "clear", runtime=run) == {"cleared": 0}
    assert 0 < document("latency", runtime=run)["timings_s"]["latency"] < 1


def test_fault_is_survived_by_taking_the_set_again(station_runtime: Path) -> None:
    fringe("simulated", "fault", "repeated", runtime=station_runtime)
    found = document("scan", runtime=station_runtime)["scan"]
    assert found["state"] == "done" and found["retakes"] >= 1


def test_reader_that_goes_away_ends_a_list_quietly(station_runtime: Path) -> None:
    fringe("scan", runtime=station_runtime)
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(station_runtime)}
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [*FRINGE, "list", "--limit", "1000"], env=env, stdout=writing, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


def test_interrupted_watch_leaves_only_its_lines(station_runtime: Path) -> None:
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(station_runtime)}
    watch = subprocess.Popen([*FRINGE, "watch", "state", "--json"], env=env, stdout=subprocess.PIPE, text=True)
    assert watch.stdout is not None
    first = watch.stdout.readline()
    watch.send_signal(signal.SIGINT)
    rest, _ = watch.communicate(timeout=20)
    assert watch.returncode == 130
    assert all("topic" in json.loads(line) for line in [first, *rest.splitlines()])


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts(shell: str, tmp_path: Path) -> None:
    assert "_FRINGE_COMPLETE" in fringe("completion", shell, runtime=tmp_path).stdout


def test_exit_codes_are_in_the_help(tmp_path: Path) -> None:
    text = fringe("--help", runtime=tmp_path).stdout
    assert all(f"{code} " in text for code in (0, 1, 2, 3, 4, 5, 130))


def test_examples_run_and_are_short(station_runtime: Path, tmp_path: Path) -> None:
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(station_runtime)}
    paths = [ROOT / "examples" / name for name in ("show_frame_sets.py", "scan_to_xyz.py")]
    for path in paths:
        lines = [line for line in path.read_text().splitlines() if line.strip() and not line.startswith('"""')]
        assert len(lines) <= 15
    shower = subprocess.Popen(
        [sys.executable, str(paths[0]), "2"], env=env, cwd=tmp_path, stdout=subprocess.PIPE, text=True
    )
    try:
        for _ in range(20):
            done = subprocess.run(
                [sys.executable, str(paths[1])],
                env=env,
                cwd=tmp_path,
                capture_output=True,
                text=True,
                timeout=60,
                check=True,
            )
            assert "SIMULATED" in done.stdout
            if shower.poll() is not None:
                break
        out, _ = shower.communicate(timeout=30)
    finally:
        shower.kill()
        shower.wait(10)
    assert out.count("missed") == 2
    assert len(list(tmp_path.glob("*.png"))) >= 1
    assert (tmp_path / "points.xyz").stat().st_size > 1000
