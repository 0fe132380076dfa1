"""A line's trace: what passed is written down, whatever happens to the disk."""

from __future__ import annotations

import pytest

from fringed.errors import DeviceAbsent
from fringed.transports import tracing
from fringed.transports.loopback import Loopback
from fringed.transports.tracing import FOLDER, Traced, traced


def a_talk(path):
    near, far = Loopback.pair("/dev/tty X")
    far.open()
    line = Traced(near, path)
    line.open()
    line.write(b"\x02\xfa")
    assert far.read(1.0) == b"\x02\xfa"
    far.write(b"\x06")
    assert line.read(1.0) == b"\x06" and line.read(0.0) == b""
    near.unplug()
    with pytest.raises(DeviceAbsent):
        line.read(0.0)
    line.close()


def test_trace_tells_what_passed_and_when(tmp_path):
    a_talk(tmp_path / "trace")
    lines = [line.split(" ", 1) for line in (tmp_path / "trace").read_text().splitlines()]
    assert all(float(time) >= 0 for time, _ in lines)
    said = [text for _, text in lines]
    assert said[:3] == ["# opened /dev/tty X", "> 02 FA", "< 06"] and "unplugged" in said[3] and said[4] == "# closed"


def test_trace_that_cannot_be_written_harms_nobody(tmp_path):
    a_talk(tmp_path / "no folder" / "trace")  # the talk's own checks hold
    assert not (tmp_path / "no folder").exists()


def test_trace_ends_before_it_fills_the_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(tracing, "MOST_BYTES", 60)
    a_talk(tmp_path / "trace")
    assert (tmp_path / "trace").stat().st_size <= 60


def test_environment_chooses(tmp_path, monkeypatch):
    near, _ = Loopback.pair("/dev/ttyUSB0")
    monkeypatch.delenv(FOLDER, raising=False)
    assert traced(near) is near
    monkeypatch.setenv(FOLDER, str(tmp_path))
    line = traced(near)
    line.open()
    line.close()
    assert (tmp_path / "dev-ttyUSB0.trace").exists()
