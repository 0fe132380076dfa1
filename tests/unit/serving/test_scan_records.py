"""Waiting for news of a scan, and how long scans are remembered."""

import pytest

from fringed.errors import NotFound
from fringed.messages import ErrorInfo, Request
from fringed.serving import records as module
from fringed.serving.records import Records
from fringed.serving.requests import LATER, Call


@pytest.fixture
def events():
    return []


@pytest.fixture
def records(reactor, events):
    return Records(reactor, events.append)


def waiting(records, record, timeout_s=5.0, seen=None):
    answers = []
    call = Call(Request("r", "wait"), lambda result, error: answers.append(result), 1e9)
    now = records.wait(record, call, timeout_s, seen)
    return answers if now is LATER else [now]


def test_a_waiter_hears_of_the_next_change(records):
    record = records.new("p")
    answers = waiting(records, record)
    assert answers == []
    records.change(record, "acquiring", 0.2, "frame 1")
    assert [(state.state, state.progress) for state in answers] == [("acquiring", 0.2)]


def test_a_waiter_that_saw_something_else_is_answered_at_once(records):
    record = records.new("p")
    records.change(record, "acquiring", 0.2)
    assert waiting(records, record, seen={"state": "queued", "progress": 0.0, "products": 0})[0].state == "acquiring"
    assert waiting(records, record, seen={"state": "acquiring", "progress": 0.2, "products": 0}) == []


def test_a_waiter_is_answered_when_its_time_is_over(records, reactor):
    record = records.new("p")
    answers = waiting(records, record, 0.01)
    assert reactor.run_until(lambda: bool(answers), 5.0)
    assert answers[0].state == "queued"


def test_a_new_product_is_news(records):
    record = records.new("p")
    answers = waiting(records, record)
    record.products.append({"id": "x", "kind": "PhaseMap", "stage": "s", "role": ""})
    records.touch(record)
    assert len(answers[0].products) == 1


def test_what_has_ended_does_not_change_and_answers_at_once(records):
    record = records.new("p")
    records.fail(record, ErrorInfo("QualityError", "too dark"))
    records.change(record, "done", 1.0)
    assert record.snapshot().state == "failed"
    assert waiting(records, record)[0].error.code == "QualityError"


def test_progress_never_goes_back(records):
    record = records.new("p")
    records.change(record, "acquiring", 0.5)
    records.change(record, progress=0.3)
    assert record.progress == 0.5


def test_each_state_is_an_event_and_progress_is_not_a_flood(records, events):
    record = records.new("p")
    for step in range(1000):
        records.change(record, "acquiring", step / 1000)
    records.change(record, "done", 1.0)
    names = [event.name for event in events]
    assert names[0] == "scan.queued"
    assert names[-1] == "scan.done"
    assert "scan.acquiring" in names
    assert len(names) < 50


def test_finished_ones_are_forgotten_in_bounds_and_running_ones_never(records, monkeypatch):
    monkeypatch.setattr(module, "KEPT", 10)
    running = records.new("p")
    ended = [records.new("p") for _ in range(30)]
    for record in ended:
        records.change(record, "done")
    records.new("p")
    assert records.get(running.id) is running
    with pytest.raises(NotFound, match="fringe list"):
        records.get(ended[0].id)
    assert records.get(ended[-1].id) is ended[-1]
