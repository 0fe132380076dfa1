"""Every snippet of the documentation runs.

`toml` blocks are valid station configurations; `python` blocks run as they are; of `console` blocks every
line that begins with `$ ` runs in one shell per page. A block whose fence says `norun` needs a machine or a
device that a test does not have. All run in an empty folder, with a small simulated station at work.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from fringed.config import StationConfig, check_station, merged, validate
from fringed.config.defaults import PIPELINES

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "ARCHITECTURE.md", *(ROOT / "docs").rglob("*.md")])
FENCE = re.compile(r"^```(?P<info>[^\n`]*)\n(?P<body>.*?)^```", re.M | re.S)


def snippets(page: Path) -> list[tuple[str, str]]:
    """Return (language, code) of every block that is meant to run."""
    found = []
    for match in FENCE.finditer(page.read_text(encoding="utf-8")):
        words = match["info"].split()
        if not words or "norun" in words or words[0] not in ("python", "console"):
            continue
        body = match["body"]
        if words[0] == "console":
            body = "\n".join(line[2:] for line in body.splitlines() if line.startswith("$ "))
        found.append((words[0], body))
    return found


@pytest.mark.parametrize("page", [p for p in PAGES if snippets(p)], ids=lambda p: str(p.relative_to(ROOT)))
@pytest.mark.timeout(240)
def test_snippets_of_the_page_run(page: Path, station_runtime: Path, tmp_path: Path) -> None:
    env = {
        **os.environ,
        "FRINGED_RUNTIME_DIR": str(station_runtime),
        "FRINGED_DATA_DIR": str(tmp_path / "data"),
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    }
    (tmp_path / "fringed").symlink_to(ROOT)
    for language, code in snippets(page):
        command = [sys.executable, "-W", "error", "-c", code] if language == "python" else ["bash", "-euc", code]
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=200, check=False)
        assert done.returncode == 0, f"{language} snippet failed:\n{code}\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_station_configurations_of_the_page_are_valid(page: Path) -> None:
    for match in FENCE.finditer(page.read_text(encoding="utf-8")):
        if match["info"].strip() == "toml":
            check_station(validate(merged(PIPELINES, tomllib.loads(match["body"])), StationConfig))


def test_every_page_is_linked_from_the_readme_or_the_index() -> None:
    index = (ROOT / "README.md").read_text() + (ROOT / "docs" / "README.md").read_text()
    missing = [
        str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md") if p.name != "README.md" and p.name not in index
    ]  # fmt: skip
    assert not missing, f"link these pages: {missing}"
