from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.acquisition.actions import (
    DeviceFailed,
    Discard,
    Failed,
    Finished,
    Flipped,
    FrameArrived,
    Keep,
    Reached,
    ReadFrame,
    Show,
    TimedOut,
    Trigger,
    Triggered,
    WaitUntil,
)
from fringed.acquisition.sequencer import Sequencer, Timing
from fringed.errors import AcquisitionError

FREE = Timing(latency_s=0.034, settle_s=0.012, exposure_s=0.008, period_s=0.1335)


def frame(counter, start_s, delivered_s=None, exposure_s=0.008):
    return FrameArrived(counter, start_s, start_s + exposure_s, delivered_s or start_s + exposure_s)


def test_frame_that_began_before_the_pattern_settled_is_discarded_and_the_next_is_kept():
    machine = Sequencer(2, FREE)
    assert machine.start() == (Show(0),)
    assert machine.handle(Flipped(1.0)) == (ReadFrame(2.0),)
    discard, again = machine.handle(frame(7, 1.045))
    assert isinstance(discard, Discard) and "1.00 ms before" in discard.reason
    assert again == ReadFrame(2.0)
    assert machine.handle(frame(8, 1.1785)) == (Keep(0, 1.0), Show(1))
    machine.handle(Flipped(1.2))
    assert machine.handle(frame(9, 1.312)) == (Keep(1, 1.2), Finished())
    assert machine.done


def test_triggered_camera_is_triggered_when_the_pattern_has_settled():
    machine = Sequencer(1, Timing(0.034, 0.012, 0.008, 0.02, triggered=True))
    machine.start()
    (wait,) = machine.handle(Flipped(1.0))
    assert isinstance(wait, WaitUntil) and wait.time_s == pytest.approx(1.046)
    assert machine.handle(Reached(1.046)) == (Trigger(),)
    assert machine.handle(Triggered(1.046)) == (ReadFrame(2.0),)
    assert machine.handle(frame(0, 1.046)) == (Keep(0, 1.0), Finished())


def test_next_pattern_is_shown_while_a_slow_frame_is_read_out():
    machine = Sequencer(2, FREE)
    machine.start()
    machine.handle(Flipped(1.0))
    machine.handle(frame(0, 1.0, delivered_s=1.13))  # delivered just before the next exposure
    assert isinstance(machine._pending, ReadFrame)
    machine.handle(frame(1, 1.1335, delivered_s=1.265))
    (wait,) = machine.handle(Flipped(1.28))
    assert isinstance(wait, ReadFrame)  # the last pattern has no next


def test_wrong_prediction_costs_a_flip_and_no_frame():
    machine = Sequencer(3, FREE)
    machine.start()
    machine.handle(Flipped(1.0))
    machine.handle(frame(0, 1.0, delivered_s=1.13))
    *_, show = machine.handle(frame(1, 1.1335, delivered_s=1.263))
    assert show == Show(1)
    (wait,) = machine.handle(Flipped(1.27))
    assert isinstance(wait, WaitUntil) and wait.time_s == pytest.approx(1.4005 + 0.009, abs=1e-6)
    assert machine.handle(Reached(1.41)) == (Show(2),)
    assert machine.handle(Flipped(1.42)) == (ReadFrame(2.0),)
    discard, again = machine.handle(frame(2, 1.415))  # its window is closed
    assert isinstance(discard, Discard) and again == Show(1)


def test_counter_gap_is_counted_for_the_pattern_that_was_awaited():
    machine = Sequencer(1, FREE)
    machine.start()
    machine.handle(Flipped(1.0))
    machine.handle(frame(3, 1.0))
    machine.handle(frame(5, 1.267))
    assert machine.counters_skipped == {0: 1}


def test_what_a_driver_lost_before_the_set_is_not_counted():
    machine = Sequencer(1, FREE)
    machine.start()
    machine.handle(Flipped(10.0))
    machine.handle(frame(3, 1.0))
    assert machine.handle(frame(70, 10.05)) == (Keep(0, 10.0), Finished())
    assert machine.counters_skipped == {}


@pytest.mark.parametrize(
    ("event", "fault"), [(TimedOut(2.0), "stalled"), (DeviceFailed("gone"), "device")], ids=["silence", "device"]
)
def test_silence_and_failure_end_the_set(event, fault):
    machine = Sequencer(2, FREE)
    machine.start()
    machine.handle(Flipped(1.0))
    (failed,) = machine.handle(event)
    assert isinstance(failed, Failed) and failed.fault == fault
    assert machine.done


def test_camera_whose_times_stand_still_ends_the_set():
    machine = Sequencer(1, FREE)
    machine.start()
    machine.handle(Flipped(1.0))
    for counter in range(200):
        *_, last = machine.handle(frame(counter, 0.5))
        if machine.done:
            break
    assert isinstance(last, Failed) and last.fault == "times"


def test_event_that_answers_nothing_is_an_error():
    machine = Sequencer(1, FREE)
    with pytest.raises(AcquisitionError, match="no set is being taken"):
        machine.handle(Flipped(1.0))
    machine.start()
    with pytest.raises(AcquisitionError, match="no answer to Show"):
        machine.handle(TimedOut(1.0))


TIMES = st.floats(0, 20) | st.sampled_from([math.nan, math.inf, -math.inf, 0.0])
EVENTS = st.one_of(
    st.builds(Flipped, TIMES),
    st.builds(Reached, TIMES),
    st.builds(Triggered, TIMES),
    st.builds(FrameArrived, st.integers(-2, 40), TIMES, TIMES, TIMES),
    st.builds(TimedOut, TIMES),
    st.builds(DeviceFailed, st.just("x")),
)


@settings(max_examples=300, deadline=None)
@given(st.integers(1, 4), st.booleans(), st.lists(EVENTS, max_size=60))
def test_no_order_of_events_raises_anything_but_its_own_error_or_keeps_an_early_frame(count, triggered, events):
    machine = Sequencer(count, Timing(0.034, 0.012, 0.008, 0.1335, triggered=triggered))
    machine.start()
    flips, shown = {}, 0
    for event in events:
        try:
            actions = machine.handle(event)
        except AcquisitionError:
            continue
        if isinstance(event, Flipped):
            flips[shown] = event.time_s
        for action in actions:
            if isinstance(action, Show):
                shown = action.index
            if isinstance(action, Keep):
                assert isinstance(event, FrameArrived)
                assert event.exposure_start_s >= flips[action.index] + 0.046 - 1e-6


@settings(max_examples=120, deadline=None)
@given(
    count=st.integers(1, 6),
    period_s=st.floats(0.01, 0.2),
    claimed=st.floats(0.5, 2.0),
    readout=st.floats(0.0, 1.5),
    delay_s=st.floats(0.0, 0.3),
    triggered=st.booleans(),
    lost=st.sets(st.integers(0, 30), max_size=6),
)
def test_set_on_a_ticking_rig_always_ends_with_frames_of_the_right_pattern(
    count, period_s, claimed, readout, delay_s, triggered, lost
):
    exposure_s = period_s / 4
    machine = Sequencer(count, Timing(delay_s, 0.0, exposure_s, period_s * claimed, triggered=triggered))
    now, counter, zero, trigger_s = 5.0, 0, 4.9, 0.0
    timeline, kept = [], []
    actions = machine.start()
    for _ in range(3000):
        if machine.done:
            break
        match actions[-1]:
            case Show(index):
                now = (math.floor(now * 60) + 1) / 60
                timeline.append((now, index))
                event = Flipped(now)
            case WaitUntil(time_s):
                now = max(now, time_s)
                event = Reached(now)
            case Trigger():
                trigger_s = now
                event = Triggered(now)
            case ReadFrame():
                while counter in lost:
                    counter += 1
                start_s = trigger_s if triggered else zero + counter * period_s
                end_s = start_s + exposure_s
                now = max(now, end_s + readout * period_s)
                event = FrameArrived(counter, start_s, end_s, now)
                counter += 1
        actions = machine.handle(event)
        for action in actions:
            if isinstance(action, Keep):
                # what the panel shows from settling until the exposure ends
                seen = {index for flip_s, index in timeline if flip_s + delay_s <= start_s + 1e-6}
                assert action.index in seen
                last = [i for flip_s, i in timeline if flip_s < end_s - 1e-6][-1]
                assert last == action.index
                kept.append(action.index)
    assert machine.done
    assert isinstance(actions[-1], Finished)
    assert kept == list(range(count))


def periods_needed(readout_s, triggered=False, count=12):
    """Take a set on an ideal rig (60 Hz, 133.5 ms) and return its length in camera periods."""
    machine = Sequencer(count, Timing(0.034, 0.012, 0.00833, 0.1335, triggered=triggered))
    now, counter, starts, trigger_s = 5.0, 0, [], 0.0
    actions = machine.start()
    while not machine.done:
        match actions[-1]:
            case Show():
                now = (math.floor(now * 60) + 1) / 60
                event = Flipped(now)
            case WaitUntil(time_s):
                now = max(now, time_s)
                event = Reached(now)
            case Trigger():
                trigger_s = now
                event = Triggered(now)
            case ReadFrame():
                start_s = trigger_s if triggered else 5.0 + counter * 0.1335
                now = max(now, start_s + 0.00833 + readout_s)
                event = FrameArrived(counter, start_s, start_s + 0.00833, now)
                counter += 1
        actions = machine.handle(event)
        starts += [start_s for action in actions if isinstance(action, Keep)]
    return (starts[-1] - 5.0) / 0.1335


@pytest.mark.parametrize("readout_s", [0.0, 0.03, 0.1, 0.125])
def test_free_running_camera_yields_a_pattern_each_period_whatever_its_readout_takes(readout_s):
    assert periods_needed(readout_s) <= 13.01
