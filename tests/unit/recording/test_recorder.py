"""The recorder works in order, reports every end, and finishes what is queued."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from fringed.errors import DataError, FringedError, StorageError
from fringed.recording import Recorder


@pytest.fixture
def recorder() -> Iterator[Recorder]:
    recorder = Recorder(length=4)
    recorder.start()
    yield recorder
    assert recorder.stop(5)


def fail(error: Exception) -> int:
    raise error


def test_work_is_done_in_order_on_one_other_thread(recorder: Recorder) -> None:
    done: list[int] = []
    threads: set[int] = set()
    finished = threading.Event()

    def note(value: int) -> None:
        done.append(value)
        threads.add(threading.get_ident())
        if value == 3:
            finished.set()

    for value in range(4):
        recorder.submit(lambda value=value: value, note, lambda error: pytest.fail(str(error)))
    assert finished.wait(5)
    assert done == [0, 1, 2, 3]
    assert threads != {threading.get_ident()} and len(threads) == 1


def test_stop_finishes_what_is_queued_and_takes_nothing_more() -> None:
    recorder, gate, done = Recorder(), threading.Event(), []
    recorder.start()
    recorder.submit(gate.wait, lambda _: done.append(0), lambda _: None)
    recorder.submit(lambda: 1, done.append, lambda _: None)
    assert not recorder.stop(0.05)  # still waiting at the gate
    with pytest.raises(StorageError, match="stopping"):
        recorder.submit(lambda: 2, done.append, lambda _: None)
    gate.set()
    assert recorder.stop(5)
    assert recorder.stop(5)
    assert done == [0, 1]


def test_errors_are_reported_and_do_not_end_the_thread(recorder: Recorder) -> None:
    errors: list[FringedError] = []
    done = threading.Event()
    recorder.submit(lambda: fail(DataError("no id")), lambda _: pytest.fail("done"), errors.append)
    recorder.submit(lambda: fail(ZeroDivisionError("bug")), lambda _: pytest.fail("done"), errors.append)
    recorder.submit(lambda: 1, lambda _: fail(RuntimeError("in the callback")), lambda _: None)
    recorder.submit(lambda: 1, lambda _: done.set(), lambda _: None)
    assert done.wait(5)
    assert [type(e) for e in errors] == [DataError, StorageError]
    assert "ZeroDivisionError: bug" in str(errors[1])


def test_full_queue_refuses_at_once_and_recovers(recorder: Recorder) -> None:
    gate, done, started = threading.Event(), threading.Semaphore(0), threading.Event()

    def hold() -> None:
        started.set()
        gate.wait(5)

    for _ in range(4):
        recorder.submit(hold, lambda _: done.release(), lambda _: None)
    with pytest.raises(StorageError, match="4 recordings wait"):
        recorder.submit(hold, lambda _: done.release(), lambda _: None)
    gate.set()
    assert all(done.acquire(timeout=5) for _ in range(4))
    again = threading.Event()
    for _ in range(50):  # the slot is free a moment after the callback
        try:
            recorder.submit(lambda: 1, lambda _: again.set(), lambda _: None)
            break
        except StorageError:
            threading.Event().wait(0.02)
    assert again.wait(5)


def test_a_recorder_that_was_never_started_stops() -> None:
    assert Recorder().stop(1)
