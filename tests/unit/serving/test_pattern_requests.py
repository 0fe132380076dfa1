"""The verb `patterns`: whose size, whose tone curve, and that nobody's request is forgotten."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from fringed import wire
from fringed.data import PatternFrame, PatternSequence
from fringed.errors import DeviceAbsent, NotFound, UsageError
from fringed.messages import ErrorInfo, JobDone, Request, StageDone
from fringed.serving.requests import LATER, Call
from fringed.serving.sequences import KEPT_BYTES, Sequences
from fringed.serving.verbs_patterns import PatternVerbs

SEQUENCE = PatternSequence("x", 8, 4, (PatternFrame("grey"),), (np.zeros((1, 1, 1), np.uint8),), parameters={"d": 1})
SCHEMAS = {"encoder": {"x": {"type": "object", "properties": {"steps": {"type": "integer"}}}}}


class Jobs:
    def __init__(self):
        self.jobs = []

    def submit(self, job, watcher, timeout_s=None):
        self.jobs.append((job, watcher))

    def answer(self, sequence):
        job, watcher = self.jobs.pop(0)
        watcher.on_stage(StageDone(job.id, "patterns", 0.1, sequence))
        watcher.on_done(JobDone(job.id))


class Panel:
    def __init__(self, size_px=(8, 4)):
        self._size_px = size_px

    def size_px(self):
        if 0 in self._size_px:
            raise DeviceAbsent("this station has no rig")
        return self._size_px


@pytest.fixture
def asked():
    """Return verbs, their jobs and a function that asks; answers are appended to a list."""
    jobs = Jobs()
    curve = np.linspace(0, 1, 256)
    house = SimpleNamespace(
        hosts=SimpleNamespace(schemas=lambda: SCHEMAS),
        present=SimpleNamespace(calibration=SimpleNamespace(tone_curve=curve)),
        loader=None,
        in_thread=lambda _, work, done, failed: done(work()),
    )
    verbs = PatternVerbs(house, Sequences(jobs), Panel())
    answers = []

    def ask(**params):
        call = Call(Request("r", "patterns", params), lambda result, error: answers.append((result, error)), 1e9)
        return verbs.table()["patterns"](call)

    return SimpleNamespace(verbs=verbs, jobs=jobs, ask=ask, answers=answers, curve=curve)


def test_patterns_are_for_the_projector_and_the_calibration_in_force(asked):
    assert asked.ask(encoder="x", params={"steps": 3}) is LATER
    job, _ = asked.jobs.jobs[0]
    assert job.stages[0].params == {"steps": 3} and job.stages[0].kind == "encoder"
    target = job.inputs["projector"]
    assert (target["width_px"], target["height_px"]) == (8, 4) and np.array_equal(target["tone_curve"], asked.curve)
    asked.jobs.answer(SEQUENCE)
    ((encoded, error),) = asked.answers
    assert error is None and asked.verbs.waiting == 0
    reply = wire.decode([bytes(part) for part in encoded.frames("")]).content
    assert reply.id == "r" and reply.result.frames == SEQUENCE.frames and reply.result.parameters == {"d": 1}


def test_another_size_may_be_given_but_whole(asked):
    asked.ask(encoder="x", width_px=1920, height_px=1080)
    assert asked.jobs.jobs[0][0].inputs["projector"]["width_px"] == 1920
    for wrong in ({"width_px": 100}, {"width_px": 0, "height_px": 10}, {"width_px": 99999, "height_px": 10}):
        with pytest.raises(UsageError, match="give both, 1 to 16384, or neither"):
            asked.ask(encoder="x", **wrong)


def test_without_a_projector_the_size_is_asked_for(asked):
    asked.verbs.panel = Panel((0, 0))
    with pytest.raises(UsageError, match="give width_px and height_px"):
        asked.ask(encoder="x")


def test_unknown_encoders_are_told_before_a_worker_is_asked(asked):
    with pytest.raises(NotFound, match="there are x"):
        asked.ask(encoder="y")
    assert not asked.jobs.jobs


def test_a_refusal_of_the_encoder_is_the_answer(asked):
    asked.ask(encoder="x")
    asked.jobs.jobs[0][1].on_failed(ErrorInfo("UsageError", "x: no fringes"), False)
    assert asked.answers == [(None, ErrorInfo("UsageError", "x: no fringes"))]
    assert asked.verbs.waiting == 0


def test_a_flood_of_requests_is_refused(asked):
    for _ in range(32):
        asked.ask(encoder="x")
    with pytest.raises(UsageError, match="wait already"):
        asked.ask(encoder="x")


def test_big_sequences_are_not_all_kept(asked):
    panel = np.zeros((4096, 8192, 1), np.uint8)
    big = PatternSequence("x", 8192, 4096, (PatternFrame("grey"),), (panel,))
    count = KEPT_BYTES // panel.nbytes + 2
    for steps in range(count):
        asked.ask(encoder="x", params={"steps": steps})
        asked.jobs.answer(big)
    assert len(asked.verbs.sequences._known) < count
    asked.ask(encoder="x", params={"steps": count - 1})  # the last one is known
    assert not asked.jobs.jobs
