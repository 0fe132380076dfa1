"""Whatever happens, in any order: every job is answered exactly once and no worker is overrun."""

from collections import Counter

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from fringed.data import CameraSettings, FrameSet, Mesh, PatternFrame, PatternSequence
from fringed.errors import Quarantined
from fringed.messages import (
    ErrorInfo,
    FedSet,
    FeedBegin,
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

ATTEMPTS = 3
WORKERS = st.sampled_from(["a", "b", "c"])
PRODUCT = Mesh(np.zeros((3, 3)), np.zeros((1, 3), np.int32), id="product")

STAGES = (StageCall("s", "processor", "s"),)
FRAMES = 3
SEQUENCE = PatternSequence(
    "toy", 4, 4, (PatternFrame("gray", period_px=4.0),) * FRAMES, (np.zeros((1, 4, 1), np.uint8),) * FRAMES
)
IMAGE = np.zeros((1, 1), np.uint8)


class Dispatching(RuleBasedStateMachine):
    """Workers come, answer, fail, fall silent and vanish while jobs are submitted and cancelled."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.limits = Limits(ATTEMPTS, job_timeout_s=20.0, cancel_grace_s=2.0, silence_s=5.0)
        self.it = Dispatcher(self.limits)
        self.submitted: list[str] = []
        self.ends: Counter[str] = Counter()
        self.stages: Counter[str] = Counter()
        self.tries: Counter[str] = Counter()
        self.sets = 0
        self.sent: dict[str, int] = {}  # frames of each set that anybody was fed
        self.fed_to: dict[str, str] = {}

    def collect(self) -> None:
        for worker, message in self.it.take_outbox():
            if isinstance(message, Job):
                self.tries[message.id] += 1
                for value in message.inputs.values():
                    if isinstance(value, FedSet):
                        assert (self.fed_to[value.id], self.sent[value.id]) == (worker, FRAMES)
            elif isinstance(message, FeedBegin):
                self.fed_to[message.feed], self.sent[message.feed] = worker, 0
            elif isinstance(message, FeedFrame):
                assert (worker, message.index) == (self.fed_to[message.feed], self.sent[message.feed])
                self.sent[message.feed] += 1

    def held(self, worker: str) -> str | None:
        peer = self.it.peers.get(worker)
        return peer.jobs[0] if peer and peer.jobs else None

    @rule(subject=st.integers(0, 3), pipeline=st.sampled_from("pq"))
    def submit(self, subject: int, pipeline: str) -> None:
        name = f"job-{len(self.submitted)}"
        inputs = {"object": Mesh(PRODUCT.vertices_mm, PRODUCT.faces, id=f"set-{subject}")}
        self._submit(name, Job(name, STAGES, inputs, pipeline))

    def _submit(self, name: str, job: Job) -> None:
        def count(counter: Counter[str]) -> None:
            counter[name] += 1

        watcher = Watcher(lambda _: count(self.stages), lambda _: count(self.ends), lambda *_: count(self.ends))
        try:
            self.it.submit(job, watcher, self.now)
        except Quarantined:
            assert self.it.quarantine.entries
            return
        self.submitted.append(name)

    @rule(worker=WORKERS, credits=st.integers(0, 3))
    def ready(self, worker: str, credits: int) -> None:
        self.it.received(
            worker, WorkerReady(worker, 1, credits, schemas={"processor": {"s": {}}}, feeds=True), self.now
        )

    @rule()
    def begin_feed(self) -> None:
        self.sets += 1
        begin = FeedBegin(f"fed-{self.sets}", "x", "object", ("object",), STAGES, SEQUENCE, CameraSettings(), 1, 1)
        self.it.feeding.begin(begin, self.now)

    @rule(back=st.integers(0, 2), index=st.integers(0, FRAMES))
    def frame(self, back: int, index: int) -> None:
        self.it.feeding.frame(f"fed-{self.sets - back}", index, IMAGE, self.now)

    @rule()
    def all_frames(self) -> None:
        for index in range(FRAMES):
            self.collect()
            self.it.feeding.frame(f"fed-{self.sets}", index, IMAGE, self.now)

    @rule(back=st.integers(0, 2))
    def drop_feed(self, back: int) -> None:
        self.it.feeding.drop(f"fed-{self.sets - back}", "retaken", self.now)

    @rule(worker=WORKERS, back=st.integers(0, 2), frames=st.integers(0, FRAMES + 1))
    def frames_taken(self, worker: str, back: int, frames: int) -> None:
        self.it.received(worker, FeedTaken(f"fed-{self.sets - back}", frames), self.now)

    @rule(worker=WORKERS, back=st.integers(0, 2), with_job=st.booleans())
    def feed_lost(self, worker: str, back: int, with_job: bool) -> None:
        job = self.held(worker) or "" if with_job else ""
        self.it.received(worker, FeedLost(f"fed-{self.sets - back}", "x", job), self.now)

    @rule()
    def submit_fed(self) -> None:
        name = f"job-{len(self.submitted)}"
        frames = FrameSet(np.zeros((FRAMES, 1, 1), np.uint8), SEQUENCE, id=f"fed-{self.sets}")
        self._submit(name, Job(name, STAGES, {"object": frames}, "p"))

    @rule(worker=WORKERS, stage=st.booleans())
    def done(self, worker: str, stage: bool) -> None:
        job = self.held(worker)
        if job:
            if stage:
                self.it.received(worker, StageDone(job, "s", 0.1, PRODUCT), self.now)
            self.it.received(worker, JobDone(job), self.now)

    @rule(worker=WORKERS, retry=st.booleans())
    def fail(self, worker: str, retry: bool) -> None:
        job = self.held(worker)
        if job:
            self.it.received(worker, JobFailed(job, "s", ErrorInfo("PluginError", "x"), retry), self.now)

    @rule(worker=WORKERS, number=st.integers(0, 20))
    def stray(self, worker: str, number: int) -> None:
        peer = self.it.peers.get(worker)
        if peer is None or f"job-{number}" not in peer.jobs:
            self.it.received(worker, JobDone(f"job-{number}"), self.now)

    @rule(worker=WORKERS)
    def lose(self, worker: str) -> None:
        self.it.lost(worker, "died", self.now)

    @rule(number=st.integers(0, 20))
    def cancel(self, number: int) -> None:
        self.it.cancel(f"job-{number}", self.now)

    @rule(seconds=st.floats(0.1, 8.0), alive=st.sets(WORKERS))
    def pass_time(self, seconds: float, alive: set[str]) -> None:
        self.now += seconds
        for worker in alive & set(self.it.peers):
            self.it.received(worker, WorkerAlive(worker), self.now)
        self.it.tick(self.now)

    @rule()
    def clear(self) -> None:
        self.it.quarantine.clear()

    @invariant()
    def no_worker_is_overrun_and_no_job_is_twice(self) -> None:
        self.collect()
        assigned = [job for peer in self.it.peers.values() for job in peer.jobs]
        assert len(assigned) == len(set(assigned))
        assert all(peer.credits >= 0 for peer in self.it.peers.values())
        assert set(assigned) <= set(self.it.active)
        assert len(assigned) + self.it.waiting == len(self.it.active)

    @invariant()
    def answered_at_most_once(self) -> None:
        assert max(self.ends.values(), default=0) <= 1
        assert max(self.stages.values(), default=0) <= 1
        assert set(self.ends) | set(self.it.active) == set(self.submitted)

    def teardown(self) -> None:
        for worker in list(self.it.peers):
            self.it.lost(worker, "died", self.now)
        for _ in range(len(self.submitted) * ATTEMPTS + 1):
            self.it.received("good", WorkerReady("good", 1, 1, schemas={}), self.now)
            self.done("good", stage=True)
        assert set(self.ends) == set(self.submitted)
        assert self.it.active == ()


Dispatching.TestCase.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
TestDispatching = Dispatching.TestCase
