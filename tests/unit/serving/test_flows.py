"""The lives of jobs in the reactor: how they end, what they stop, and that none holds the loop."""

from types import SimpleNamespace

import numpy as np
import pytest
import zmq

from fringed import wire
from fringed.config import simulated_station
from fringed.data import Mesh
from fringed.errors import Cancelled, StorageError
from fringed.messages import ErrorInfo, JobDone, Reply, Request, StageCall, StageDone
from fringed.serving.house import House, Present
from fringed.serving.jobs import JobRun
from fringed.serving.other_flows import LatencyFlow, ProcessFlow, RepublishFlow
from fringed.serving.plans import Plan
from fringed.serving.records import Records
from fringed.serving.requests import LATER, Call
from fringed.serving.stream import Stream
from fringed.serving.verbs_records import RecordVerbs

STAGES = (StageCall("decode", "processor", "decode"),)


def mesh(name=""):
    return Mesh(np.zeros((3, 3)), np.zeros((1, 3), np.int32), id=name)


class Inline:
    """A thread that does its work at once, or when it is told to."""

    def __init__(self):
        self.held = None

    def submit(self, work, on_done, on_error):
        if self.held is not None:
            self.held.append((work, on_done, on_error))
            return
        try:
            result = work()
        except (StorageError, Cancelled) as error:
            on_error(error)
        else:
            on_done(result)

    def release(self):
        held, self.held = self.held, None
        for task in held:
            self.submit(*task)


class Store:
    def __init__(self):
        self.full = False
        self.saved = []

    def save(self, product, record_id="", encoded=None):
        if self.full:
            raise StorageError("the disk is full")
        self.saved.append(product)

    def load(self, record_id, verify=True):
        return mesh(record_id)

    def list(self, *_):
        return [{"id": "a"}]

    def free_bytes(self):
        return 0


class Jobs:
    """Remembers jobs; `waiting` ones are told at once that they are cancelled, as the dispatcher does."""

    def __init__(self):
        self.watchers, self.cancelled = {}, []
        self.waiting = False

    def submit(self, job, watcher, timeout_s=None):
        self.watchers[job.id] = watcher

    def cancel(self, job):
        self.cancelled.append(job)
        if self.waiting:
            self.watchers[job].on_failed(ErrorInfo("Cancelled", "cancelled before it began"), False)
        return True

    def taken(self, job, stage):
        pass


@pytest.fixture
def house(reactor, context):
    socket = context.socket(zmq.XPUB)
    socket.bind("inproc://stream")
    stream = Stream(reactor, socket, 2)
    records = Records(reactor, lambda event: None)
    return House(reactor, stream, records, Present(simulated_station()), Store(), Inline(), Inline(), Jobs(), None)


def settle(house):
    for _ in range(5):
        house.reactor.turn(0.0)


def test_an_announcement_repeated_a_million_times_leaves_the_loop_to_others(house):
    flow = RepublishFlow(house, house.records.new("republish"), "x", (1_000_000, 0.0))
    turns = []
    flow.start()
    house.reactor.post(lambda: turns.append(flow._done))
    settle(house)
    assert turns and turns[0] < 1000
    flow.cancel()


def test_a_measurement_cancelled_before_it_began_never_reaches_the_rig(house):
    asked = []
    flow = LatencyFlow(house, house.records.new("latency"), SimpleNamespace(
        calibrate_latency=asked.append, cancel=lambda scan: None))  # fmt: skip
    flow.cancel()
    flow.start()
    assert asked == []
    assert flow.record.state == "cancelled"


def test_a_job_whose_input_cannot_be_recorded_is_stopped(house):
    house.store.full = True
    flow = ProcessFlow(house, house.records.new("p"), Plan("p", STAGES), {"object": mesh()}, "fringed")
    flow.start()
    settle(house)
    assert flow.record.state == "failed" and flow.record.error.code == "StorageError"
    assert house.jobs.cancelled == [flow.job.job]


@pytest.mark.parametrize("waiting", [False, True])
def test_a_product_that_cannot_be_recorded_fails_its_job_with_the_disk_s_reason(house, waiting):
    house.store.full = True
    house.jobs.waiting = waiting
    ends = []
    run = JobRun(house, house.records.new("p"), ends.append)
    run.start(STAGES, {}, "p")
    house.jobs.watchers[run.job].on_stage(StageDone(run.job, "decode", 0.1, mesh("m")))
    settle(house)
    assert [error.code for error in ends] == ["StorageError"]
    assert house.counters["storage_errors"] == 1


def test_what_a_cancelled_job_leaves_is_not_written_and_is_no_error_of_the_disk(house):
    house.recorder.held = []
    run = JobRun(house, house.records.new("p"), lambda error: None)
    run.start(STAGES, {}, "p")
    house.jobs.watchers[run.job].on_stage(StageDone(run.job, "decode", 0.1, mesh("m")))
    run.cancel()
    house.recorder.release()
    settle(house)
    assert house.store.saved == []
    assert house.counters["storage_errors"] == 0


def test_a_job_ends_when_its_last_product_is_recorded_and_not_before(house):
    house.recorder.held = []
    ends = []
    run = JobRun(house, house.records.new("p"), ends.append)
    run.start(STAGES, {}, "p")
    house.jobs.watchers[run.job].on_stage(StageDone(run.job, "decode", 0.1, mesh("m")))
    house.jobs.watchers[run.job].on_done(JobDone(run.job))
    settle(house)
    assert ends == []
    house.recorder.release()
    settle(house)
    assert ends == [None]


@pytest.mark.parametrize(("verb", "params"), [("list", {}), ("get", {"id": "20260102T030405.678901Z-1f0c"})])
def test_large_replies_are_encoded_by_the_loader(house, verb, params):
    house.loader.held = []
    answers = []
    call = Call(Request("r1", verb, params), lambda result, error: answers.append(result), house.reactor.now() + 5)
    assert RecordVerbs(house, "fringed").table()[verb](call) is LATER
    house.loader.release()
    settle(house)
    (answer,) = answers
    assert isinstance(answer, wire.Encoded)
    reply = wire.decode([bytes(frame) if not isinstance(frame, np.ndarray) else frame for frame in answer.frames("")])
    assert isinstance(reply.content, Reply) and reply.content.id == "r1" and reply.content.result
