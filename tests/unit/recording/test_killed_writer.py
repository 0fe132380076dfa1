"""A writer killed at any instant leaves only whole files and at most one `.part` file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from fringed.recording import Store
from fringed.recording.store import load_file

KILLS = 30
SCRIPT = Path(__file__).with_name("kill_writers.py")


def test_files_of_killed_writers_are_whole_and_the_next_start_needs_no_hand(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPT), str(tmp_path), str(KILLS)]
    announced = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.split()
    assert len(announced) >= KILLS
    left = len(list(tmp_path.rglob("*.part")))
    store = Store(tmp_path)
    assert store.recover() == left <= 1  # each start removed what the one before it left
    visible = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert all(path.name.endswith(".h5") for path in visible)
    for path in visible:
        load_file(path)
    missing = set(announced) - {entry["id"] for entry in store.list(limit=10**6)}
    assert not missing
