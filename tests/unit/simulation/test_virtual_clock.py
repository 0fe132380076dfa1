"""The one clock of a simulated rig."""

import threading
import time

import pytest

from fringed.simulation.clock import VirtualClock


def test_virtual_time_stands_still_until_somebody_sleeps():
    clock = VirtualClock(real_time=False)
    assert clock.now() == 0.0
    time.sleep(0.01)
    assert clock.now() == 0.0
    clock.sleep(3.5)
    assert clock.now() == 3.5


def test_virtual_time_costs_nothing_and_never_goes_back():
    clock = VirtualClock(real_time=False)
    before = time.monotonic()
    clock.sleep(3600)
    clock.sleep(-5)
    clock.sleep_until(10)
    assert clock.now() == 3600
    assert time.monotonic() - before < 60


def test_sleeping_until_a_moment_stops_exactly_there():
    clock = VirtualClock(real_time=False)
    for k in range(1, 100):
        clock.sleep_until(k / 60)
        assert clock.now() == k / 60


def test_real_time_is_the_machines_and_sleeping_takes_as_long_as_it_says():
    clock = VirtualClock(real_time=True)
    before = time.monotonic()
    assert before <= clock.now()
    clock.sleep(0.02)
    clock.sleep_until(clock.now() + 0.02)
    assert time.monotonic() - before >= 0.04


def test_sleeps_of_several_threads_add_up():
    clock = VirtualClock(real_time=False)
    threads = [threading.Thread(target=lambda: [clock.sleep(0.25) for _ in range(200)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert clock.now() == pytest.approx(200.0, abs=1e-9)
