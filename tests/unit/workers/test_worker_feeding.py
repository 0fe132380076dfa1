"""Who is fed a set while it is taken, and what becomes of it; event by event, time is a number."""

from dataclasses import replace

import numpy as np
import pytest

from fringed.data import CameraSettings, FrameSet, PatternFrame, PatternSequence
from fringed.messages import (
    ErrorInfo,
    FedSet,
    FeedBegin,
    FeedDrop,
    FeedFrame,
    FeedLost,
    FeedTaken,
    Job,
    JobDone,
    JobFailed,
    StageCall,
    StageDone,
    WorkerAlive,
    WorkerReady,
)
from fringed.workers.dispatch import Dispatcher
from fringed.workers.jobs import Limits, Watcher

N = 6
SCHEMAS = {"processor": {"decode": {}}}
STAGES = (StageCall("phase", "processor", "decode", keep=False),)
SEQUENCE = PatternSequence(
    "phase-shift", 8, 8,
    tuple(PatternFrame("sinusoidal", period_px=8.0, shift_rad=float(k), step=k, steps=N) for k in range(N)),
    (np.zeros((1, 8, 1), np.uint8),) * N,
)  # fmt: skip
IMAGE = np.zeros((2, 3), np.uint8)


def frame_set(name: str = "set-1", role: str = "object") -> FrameSet:
    return FrameSet(np.zeros((N, 2, 3), np.uint8), SEQUENCE, role=role, id=name, scan="scan-1")


def job(name: str = "job-1", *sets: FrameSet) -> Job:
    sets = sets or (frame_set(),)
    return Job(name, STAGES, {one.role: one for one in sets}, "p", "scan-1")


class Bench:
    """A dispatcher with its clock; `feed` plays acquisition, `keep_up` a worker that deals with what it gets."""

    def __init__(self, *workers: str, feeds: bool = True) -> None:
        self.now = 0.0
        self.it = Dispatcher(Limits(job_timeout_s=20.0, silence_s=1000.0))
        self.sent: list[tuple[str, object]] = []
        self.ends: list[str] = []
        for worker in workers:
            self.ready(worker, feeds)

    def ready(self, worker: str, feeds: bool = True) -> None:
        self.say(worker, WorkerReady(worker, 1, 1, schemas=SCHEMAS, feeds=feeds))

    def say(self, worker: str, message: object) -> None:
        self.it.received(worker, message, self.now)
        self.sent += self.it.take_outbox()

    def begin(self, name: str = "set-1", role: str = "object", roles: tuple[str, ...] = ("object",)) -> str:
        """Begin a feed; return who gets it."""
        begin = FeedBegin(name, "scan-1", role, roles, STAGES, SEQUENCE, CameraSettings(), 2, 3)
        self.it.feeding.begin(begin, self.now)
        out = self.it.take_outbox()
        self.sent += out
        return next((worker for worker, message in out if isinstance(message, FeedBegin)), "")

    def frames(self, name: str = "set-1", *, first: int = 0, last: int = N, keep_up: str = "") -> None:
        """Bring frames; the worker `keep_up` answers each of them."""
        if keep_up and not first:
            self.say(keep_up, FeedTaken(name, 0))
        for index in range(first, last):
            self.it.feeding.frame(name, index, IMAGE, self.now)
            self.sent += self.it.take_outbox()
            if keep_up:
                self.say(keep_up, FeedTaken(name, index + 1))

    def submit(self, what: Job) -> None:
        watcher = Watcher(
            lambda _: None, lambda _: self.ends.append("done"), lambda error, _: self.ends.append(error.code)
        )
        self.it.submit(what, watcher, self.now)
        self.sent += self.it.take_outbox()

    def of(self, kind: type) -> list[tuple[str, object]]:
        return [(worker, message) for worker, message in self.sent if isinstance(message, kind)]

    def whole(self) -> list[tuple[str, bool]]:
        """Return to whom jobs went, and whether their sets went along."""
        fed = [(worker, [isinstance(v, FedSet) for v in sent.inputs.values()]) for worker, sent in self.of(Job)]
        return [(worker, not any(some)) for worker, some in fed]


def test_fed_worker_gets_the_job_without_the_frames():
    bench = Bench("a", "b")
    worker = bench.begin()
    bench.frames(keep_up=worker)
    assert [message.index for _, message in bench.of(FeedFrame)] == list(range(N))
    whole = replace(frame_set(), retakes=1)
    bench.submit(job("job-1", whole))
    assert bench.whole() == [(worker, False)]
    [(_, sent)] = bench.of(Job)
    assert sent.inputs["object"] == FedSet("set-1", "object", "scan-1", retakes=1)
    bench.say(worker, StageDone("job-1", "phase", 0.1))
    bench.say(worker, JobDone("job-1"))
    assert bench.ends == ["done"]
    assert bench.it.counters["sets_fed"] == 1
    assert bench.of(FeedDrop) == []


@pytest.mark.parametrize("why", ["old", "busy", "without the plug-in", "none"])
def test_worker_that_cannot_be_fed_gets_everything_with_the_job(why):
    bench = Bench(*([] if why in {"none", "without the plug-in"} else ["a"]), feeds=why != "old")
    if why == "busy":
        bench.submit(job("other", frame_set("set-0")))
    elif why == "without the plug-in":
        bench.say("a", WorkerReady("a", 1, 1, schemas={"processor": {"else": {}}}, feeds=True))
    assert bench.begin() == ""
    bench.frames()
    assert bench.of(FeedFrame) == []
    bench.submit(job())
    if why == "busy":
        bench.say("a", StageDone("other", "phase", 0.1))
        bench.say("a", JobDone("other"))
    elif why == "none":
        bench.ready("a")
    assert bench.whole()[-1] == ("a", True)


@pytest.mark.parametrize("answered", [False, True])
def test_retaken_set_is_another_feed_of_the_same_worker(answered):
    bench = Bench("a")
    bench.begin("set-1")
    bench.frames("set-1", keep_up="a")
    bench.it.feeding.drop("set-1", "its set is taken again", bench.now)
    if answered:
        bench.say("a", FeedLost("set-1", "its set is taken again"))
    assert bench.begin("set-2") == "a"
    bench.say("a", FeedLost("set-1", "its set is taken again"))
    bench.frames("set-2", keep_up="a")
    bench.submit(job("job-1", frame_set("set-2")))
    assert bench.whole() == [("a", False)]


def test_all_sets_of_a_scan_go_to_one_worker():
    bench = Bench("a", "b")
    roles = ("reference", "object")
    worker = bench.begin("set-1", "reference", roles)
    bench.frames("set-1", keep_up=worker)
    assert bench.begin("set-2", "object", roles) == worker
    bench.frames("set-2", keep_up=worker)
    bench.submit(job("job-1", frame_set("set-1", "reference"), frame_set("set-2")))
    assert bench.whole() == [(worker, False)]
    assert bench.it.counters["sets_fed"] == 2


def test_two_scans_at_once_feed_two_workers():
    bench = Bench("a", "b")
    assert bench.begin("set-1") != ""
    begin = FeedBegin("set-9", "scan-9", "object", ("object",), STAGES, SEQUENCE, CameraSettings(), 2, 3)
    assert bench.it.feeding.begin(begin, 0.0)
    assert {worker for worker, _ in bench.it.take_outbox()} | {w for w, _ in bench.of(FeedBegin)} == {"a", "b"}


def test_set_that_was_not_fed_travels_beside_one_that_was():
    bench = Bench("a")
    bench.begin("set-2", "object", ("reference", "object"))
    bench.frames("set-2", keep_up="a")
    bench.submit(job("job-1", frame_set("set-1", "reference"), frame_set("set-2")))
    [(_, sent)] = bench.of(Job)
    assert isinstance(sent.inputs["reference"], FrameSet)
    assert isinstance(sent.inputs["object"], FedSet)


def test_any_job_comes_before_a_feed():
    bench = Bench("a")
    bench.begin()
    bench.frames(last=2, keep_up="a")
    bench.submit(job("other", frame_set("set-0")))
    assert [type(message) for _, message in bench.sent[-2:]] == [FeedDrop, Job]
    bench.frames(first=2)
    assert len(bench.of(FeedFrame)) == 2
    bench.say("a", FeedLost("set-1", ""))
    bench.say("a", StageDone("other", "phase", 0.1))
    bench.say("a", JobDone("other"))
    bench.submit(job())
    assert bench.whole() == [("a", True)] * 2


def test_other_jobs_go_rather_to_a_worker_that_is_not_fed():
    bench = Bench("a", "b")
    fed = bench.begin()
    bench.frames(keep_up=fed)
    bench.submit(job("other", frame_set("set-0")))
    bench.submit(job())
    assert bench.whole() == [("b" if fed == "a" else "a", True), (fed, False)]


@pytest.mark.parametrize("taken", [0, 2])
def test_worker_that_falls_behind_is_fed_no_more_and_the_job_goes_elsewhere(taken):
    bench = Bench("a", "b")
    fed = bench.begin()
    bench.say(fed, FeedTaken("set-1", 0))
    bench.frames()
    bench.say(fed, FeedTaken("set-1", taken))
    bench.submit(job())
    [(worker, whole)] = bench.whole()
    assert worker != fed
    assert whole
    bench.submit(job("job-2", frame_set("set-2")))
    assert len(bench.of(Job)) == 1, "it may hang: nothing is given to it until it answers"
    bench.say(fed, FeedLost("set-1", ""))
    assert bench.whole()[-1] == (fed, True)


def test_frames_wait_for_a_worker_only_up_to_a_limit():
    bench = Bench("a")
    begin = replace(FeedBegin("s", "x", "object", ("object",), STAGES, SEQUENCE, CameraSettings(), 2, 3))
    frames = tuple(replace(SEQUENCE.frames[0], step=k) for k in range(40))
    long = PatternSequence("phase-shift", 8, 8, frames, SEQUENCE.patterns[:1] * 40)
    bench.it.feeding.begin(replace(begin, sequence=long), 0.0)
    for index in range(40):
        bench.it.feeding.frame("s", index, IMAGE, 0.0)
    sent = [type(message) for _, message in bench.it.take_outbox()]
    assert sent == [FeedBegin] + [FeedFrame] * 8 + [FeedDrop]


def test_worker_that_hangs_in_a_plug_in_is_passed_over_then_ended():
    bench = Bench("a", "b")
    fed = bench.begin()
    bench.say(fed, FeedTaken("set-1", 0))
    bench.frames(last=1)
    for _ in range(3):
        bench.now += 1.0
        bench.it.tick(bench.now)
    bench.submit(job("other", frame_set("set-0")))
    bench.submit(job("another", frame_set("set-9")))
    assert [worker for worker, _ in bench.whole()] == ["b" if fed == "a" else "a"]
    bench.now += 20.0
    bench.it.tick(bench.now)
    [reason] = [why for worker, why in bench.it.take_condemned() if worker == fed]
    assert "over frame 0 of 'object'" in reason


def test_lost_frames_are_no_fault_of_the_job():
    bench = Bench("a", "b")
    fed = bench.begin()
    bench.frames(keep_up=fed)
    bench.submit(job())
    bench.say(fed, FeedLost("set-1", "5 of 6 frames of the set set-1 came before its job", "job-1"))
    assert len(bench.whole()) == 2
    assert bench.whole()[-1][1]
    assert bench.it.counters["attempts_failed"] == 0
    assert bench.it.quarantine.entries == ()


def test_job_cancelled_while_its_frames_were_lost_is_cancelled():
    bench = Bench("a")
    bench.begin()
    bench.frames(keep_up="a")
    bench.submit(job())
    bench.it.cancel("job-1", bench.now)
    bench.say("a", FeedLost("set-1", "gone", "job-1"))
    assert bench.ends == ["Cancelled"]
    assert len(bench.whole()) == 1


def test_fed_worker_that_dies_with_the_job_is_one_failure_and_the_set_goes_whole():
    bench = Bench("a", "b")
    fed = bench.begin()
    bench.frames(keep_up=fed)
    bench.submit(job())
    bench.it.lost(fed, "was killed by SIGSEGV", bench.now)
    bench.sent += bench.it.take_outbox()
    other = "b" if fed == "a" else "a"
    assert bench.whole() == [(fed, False), (other, True)]
    assert bench.it.counters["attempts_failed"] == 1


def test_worker_that_dies_while_it_is_fed_is_nobody_s_failure():
    bench = Bench("a", "b")
    fed = bench.begin()
    bench.frames(last=3, keep_up=fed)
    bench.it.lost(fed, "was killed", bench.now)
    bench.frames(first=3)
    bench.submit(job())
    assert bench.whole() == [("b" if fed == "a" else "a", True)]
    assert bench.it.counters["attempts_failed"] == 0


def test_pipeline_that_takes_workers_down_while_they_are_fed_is_fed_no_more_until_plug_ins_change():
    bench = Bench("a")
    for name in ("set-1", "set-2"):
        assert bench.begin(name) == "a"
        bench.say("a", FeedTaken(name, 0))
        bench.frames(name, last=1)
        bench.it.lost("a", "was killed by SIGSEGV", bench.now)
        bench.ready("a")
    assert bench.begin("set-3") == ""
    bench.it.set_limits(Limits())
    assert bench.begin("set-4") == "a"


def test_idle_worker_that_is_ended_does_not_count_against_a_pipeline():
    bench = Bench("a")
    for name in ("set-1", "set-2", "set-3"):
        assert bench.begin(name) == "a"
        bench.frames(name, last=1, keep_up="a")
        bench.it.lost("a", "was ended", bench.now)
        bench.ready("a")


@pytest.mark.parametrize("worker", ["a", "b"])
@pytest.mark.parametrize(
    "message", [FeedTaken("set-1", 99), FeedTaken("none", 1), FeedLost("none", ""), FeedLost("set-1", "", "x")]
)
def test_nonsense_of_workers_is_survived(worker, message):
    bench = Bench("a", "b")
    bench.begin()
    bench.say(worker, message)
    bench.frames()
    bench.submit(job())
    assert [whole for _, whole in bench.whole()] == [True], "nobody has said that it has the frames"


def test_frames_out_of_order_end_the_feed():
    bench = Bench("a")
    bench.begin()
    bench.frames(last=2, keep_up="a")
    bench.it.feeding.frame("set-1", 3, IMAGE, 0.0)
    [(_, drop)] = bench.it.take_outbox()
    assert drop == FeedDrop("set-1", "frame 3 came where frame 2 of 6 was due")


def test_unknown_worker_s_feed_messages_are_strays():
    bench = Bench()
    bench.say("stranger", FeedTaken("set-1", 1))
    assert bench.it.counters["stray"] == 1


def test_retry_after_a_failure_takes_the_whole_set_along():
    bench = Bench("a")
    bench.begin()
    bench.frames(keep_up="a")
    bench.submit(job())
    bench.say("a", JobFailed("job-1", "phase", ErrorInfo("PluginError", "x"), retry=True))
    assert bench.whole() == [("a", False), ("a", True)]


def test_signs_of_life_do_not_hide_a_hanging_plug_in():
    bench = Bench("a")
    bench.begin()
    bench.say("a", FeedTaken("set-1", 0))
    bench.frames(last=1)
    for _ in range(21):
        bench.now += 1.0
        bench.say("a", WorkerAlive("a"))
        bench.it.tick(bench.now)
    assert [name for name, _ in bench.it.take_condemned()] == ["a"]
