"""The worker's end of the work socket, against a bare ROUTER."""

import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import zmq

from fringed import wire
from fringed.data import CameraSettings, PatternFrame, PatternSequence
from fringed.messages import (
    FeedBegin,
    FeedDrop,
    FeedFrame,
    FeedLost,
    Job,
    JobCancel,
    JobFailed,
    StageCall,
    WorkerAlive,
    WorkerReady,
    WorkerStop,
)
from fringed.workers.link import Link

JOB = Job("j", (StageCall("s", "processor", "p"),), {"text": "x"})

STEPS = tuple(PatternFrame("sinusoidal", period_px=4.0, step=k, steps=3) for k in range(3))
SEQUENCE = PatternSequence("toy", 4, 4, STEPS, (np.zeros((1, 4, 1), np.uint8),) * 3)
BEGIN = FeedBegin("f", "scan", "object", ("object",), JOB.stages, SEQUENCE, CameraSettings(), 1, 1)
FRAMES = [FeedFrame("f", index, np.zeros((1, 1), np.uint8)) for index in range(3)]


class Station:
    """A ROUTER that says what the test wants."""

    def __init__(self) -> None:
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.ROUTER)
        self.socket.bind("inproc://work")
        self.gone: list[str] = []

    def link(self, silence_s: float = 60.0) -> Link:
        dealer = self.context.socket(zmq.DEALER)
        dealer.setsockopt(zmq.IDENTITY, b"w")
        dealer.connect("inproc://work")
        link = Link(dealer, "w", self.gone.append, silence_s)
        link.start()
        return link

    def say(self, *frames: bytes) -> None:
        self.socket.send_multipart([b"w", *frames])

    def hear(self, kind: type) -> object:
        """Return the next message of that kind."""
        while self.socket.poll(5000):
            message = wire.decode(self.socket.recv_multipart()[1:]).content
            if isinstance(message, kind):
                return message
        pytest.fail(f"no {kind.__name__} came")


@pytest.fixture
def station() -> Iterator[Station]:
    station = Station()
    yield station
    station.socket.close(linger=0)
    station.context.term()


def test_signs_of_life_follow_ready_and_name_the_job(station):
    link = station.link()
    link.send(WorkerReady("w", 1))
    assert isinstance(wire.decode(station.socket.recv_multipart()[1:]).content, WorkerReady)
    assert station.hear(WorkerAlive) == WorkerAlive("w", "")
    station.say(*wire.encode(JOB))
    assert link.next_work(5.0) == JOB
    assert station.hear(WorkerAlive) == WorkerAlive("w", "j")
    link.close()


def test_cancellation_is_of_one_job(station):
    link = station.link()
    link.send(WorkerReady("w", 1))
    station.hear(WorkerReady)
    station.say(*wire.encode(JobCancel("j")))
    station.say(*wire.encode(JOB))
    assert link.next_work(5.0) == JOB
    assert link.cancelled("j")
    assert not link.cancelled("k")
    link.close()


def test_job_that_comes_again_is_not_stopped_by_what_stopped_it_before(station):
    link = station.link()
    link.send(WorkerReady("w", 1))
    station.hear(WorkerReady)
    station.say(*wire.encode(JobCancel("j")))
    again = replace(JOB, attempt=2)
    station.say(*wire.encode(again))
    assert link.next_work(5.0) == again and not link.cancelled("j")
    link.close()


def test_damaged_job_is_answered_so_that_another_attempt_is_made(station):
    link = station.link()
    link.send(WorkerReady("w", 1))
    station.hear(WorkerReady)
    topic, header = wire.encode(JOB)
    station.say(topic, header, b"a buffer that nobody described")
    failed = station.hear(JobFailed)
    assert (failed.job, failed.error.code, failed.retry) == ("j", "WireError", True)
    link.close()


def test_nonsense_is_survived(station):
    link = station.link()
    link.send(WorkerReady("w", 1))
    station.hear(WorkerReady)
    for nonsense in ([b""], [b"", b"{"], [b"x", b"y", b"z"]):
        station.say(*nonsense)
    station.say(*wire.encode(JOB))
    assert link.next_work(5.0) == JOB
    link.close()


def test_stop_ends_the_wait_for_jobs(station):
    link = station.link()
    link.send(WorkerReady("w", 1))
    station.hear(WorkerReady)
    station.say(*wire.encode(WorkerStop("good night")))
    assert link.next_work(5.0) is None
    assert link.stopping
    link.close()


def test_silent_station_is_noticed(station):
    link = station.link(silence_s=0.2)
    link.send(WorkerReady("w", 1))
    station.hear(WorkerReady)
    deadline = time.monotonic() + 5
    while not station.gone and time.monotonic() < deadline:
        time.sleep(0.01)
    link.close()
    assert station.gone == ["the station was silent for 0.2 s"]


def ready(station: Station) -> Link:
    link = station.link()
    link.send(WorkerReady("w", 1))
    station.hear(WorkerReady)
    return link


def waiting(link: Link, until: type = Job) -> "Taker":
    """Return what takes everything that comes, in a thread that waits for it."""
    taker = Taker(link, until)
    taker.start()
    deadline = time.monotonic() + 5
    while not link._idle and time.monotonic() < deadline:
        time.sleep(0.001)
    return taker


class Taker(threading.Thread):
    """A main thread that takes work and notes it, up to something of the type `until`."""

    def __init__(self, link: Link, until: type) -> None:
        super().__init__(daemon=True)
        self.link = link
        self.until = until
        self.taken: list[object] = []

    def run(self) -> None:
        while (work := self.link.next_work()) is not None:
            self.taken.append(work)
            if isinstance(work, self.until):
                return


def test_frames_of_a_feed_come_in_order_before_their_job(station):
    link = ready(station)
    taker = waiting(link)
    for message in (BEGIN, *FRAMES, JOB):
        station.say(*(bytes(part) for part in wire.encode(message)))
    taker.join(5.0)
    assert [getattr(one, "index", type(one)) for one in taker.taken] == [FeedBegin, 0, 1, 2, Job]
    link.close()


def test_worker_that_does_not_wait_for_work_refuses_a_feed_at_once(station):
    link = ready(station)
    station.say(*(bytes(part) for part in wire.encode(BEGIN)))
    station.say(*(bytes(part) for part in wire.encode(FRAMES[0])))
    assert station.hear(FeedLost) == FeedLost("f", "its worker is busy")
    assert link.next_work(timeout_s=0.05) is None
    link.close()


def test_frames_of_a_dropped_feed_are_forgotten_while_the_worker_hangs(station):
    link = ready(station)
    taker = waiting(link, until=FeedBegin)
    for message in (BEGIN, *FRAMES, FeedDrop("f", "retaken")):
        station.say(*(bytes(part) for part in wire.encode(message)))
    taker.join(5.0)  # the main thread is in `begin` from here on, and signs of life go on
    while station.socket.poll(0):
        station.socket.recv_multipart()
    assert station.hear(WorkerAlive) == WorkerAlive("w", "")
    deadline = time.monotonic() + 5
    while link._frames and time.monotonic() < deadline:
        time.sleep(0.01)
    assert link._frames == {}
    assert link.next_work() == FeedDrop("f", "retaken")
    link.close()
