"""The driver and its process where nothing is shown (SDL's dummy): life, death, time-outs."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from fringed.data import PatternFrame, PatternSequence
from fringed.devices.projector.window import WindowOptions, WindowProjector, environment_of
from fringed.devices.projector.window_process import DisplayProcess
from fringed.display.messages import LONGEST, Load
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError
from fringed.hookspecs import Watched

SIZE = (320, 240)
OPTIONS = WindowOptions(backend="dummy", size_px=SIZE, connector="")


@pytest.fixture
def projector():
    made = WindowProjector(OPTIONS, "bench-3")
    yield made
    made.close()
    made.close()


@pytest.fixture
def process(projector):
    made = DisplayProcess(projector.setup(), environment_of(OPTIONS))
    yield made
    made.end()
    made.end()


def two():
    patterns = tuple(np.full((1, 1, 1), level, np.uint8) for level in (0, 255))
    return PatternSequence("flat", *SIZE, (PatternFrame("flat"),) * 2, patterns)


def test_patterns_are_shown_one_period_apart_on_the_machines_clock(projector):
    assert isinstance(projector, Watched)
    assert projector.open() == projector.open()
    projector.load(two(), "object")
    before = time.monotonic()
    flips = [projector.show(index) for index in (0, 1, 0)]
    projector.idle()
    assert before < flips[0] < flips[1] < flips[2] < time.monotonic()


def test_a_closed_window_says_so(projector):
    with pytest.raises(DeviceAbsent, match="closed: open it"):
        projector.show(0)
    with pytest.raises(DeviceAbsent, match="closed: open it"):
        projector.load(two(), "object")
    with pytest.raises(DeviceError, match="panel is 320 x 240"):
        projector.load(PatternSequence("flat", 9, 9, two().frames, two().patterns), "object")


def test_a_dead_process_is_absent_with_its_signal_until_it_is_opened_again(projector):
    projector.open()
    os.kill(projector.pid, signal.SIGKILL)
    for _ in range(2):
        with pytest.raises(DeviceAbsent, match="killed by SIGKILL"):
            projector.check()
    projector.open()
    projector.check()


def test_a_hanging_process_is_stalled_and_replaced():
    projector = WindowProjector(WindowOptions(backend="dummy", size_px=SIZE, connector="", timeout_s=0.3))
    try:
        projector.open()
        first = projector.pid
        os.kill(first, signal.SIGSTOP)
        with pytest.raises(DeviceStalled, match=r"did not answer within 0\.3 s"):
            projector.idle()
        assert not Path(f"/proc/{first}").exists()
        projector.open()
        projector.check()
    finally:
        projector.close()


def test_a_window_that_does_not_open_in_time_is_stalled_and_leaves_nothing():
    projector = WindowProjector(WindowOptions(backend="dummy", size_px=SIZE, connector="", open_timeout_s=0.01))
    with pytest.raises(DeviceStalled, match="opening its window"):
        projector.open()
    assert projector.pid == 0


def test_what_the_process_refuses_harms_nothing(process):
    process.ready(30)
    with pytest.raises(UsageError, match=r"pattern 0 is \(7, 1, 1\)"):
        process.load(bytes(7), ((0, (7, 1, 1)),), 10)
    process.load(bytes(3), ((0, (1, 1, 3)),), 10)
    process.look()


def test_a_message_that_is_too_long_is_not_sent(process):
    process.ready(30)
    table = ((0, (1, 1, 1)),) * (LONGEST // 4)
    with pytest.raises(ProtocolError, match="load fewer patterns"):
        process.ask(lambda token: Load(token, 1, table), 10)


def test_a_process_that_dies_of_an_error_tells_it(process):
    process.ready(30)
    with pytest.raises(DeviceAbsent, match=r"ended with status 1; it said: .*IndexError"):
        process.ask(lambda token: Load(token, 1, ()), 10)  # no memory comes along
