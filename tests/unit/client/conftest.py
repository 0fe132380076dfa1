from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fakestation import FakeStation


@pytest.fixture
def fake(tmp_path: Path) -> Iterator[FakeStation]:
    station = FakeStation(tmp_path / "run")
    try:
        yield station
    finally:
        station.stop()
