"""Sequence numbers, last values for late joiners, and what a stopped subscriber may cost."""

import os

import numpy as np
import pytest
import zmq

from fringed import wire
from fringed.data import Artifact, RangeImage
from fringed.messages import Event
from fringed.serving.stream import Stream


def event(name):
    return Event(name, "2026-01-02T03:04:05+00:00")


def range_image(side_px=256):
    zeros = np.zeros((side_px, side_px), np.uint8)
    return RangeImage(np.zeros((side_px, side_px, 3), np.float32), zeros, zeros, id="x")


@pytest.fixture
def stream(reactor, context):
    socket = context.socket(zmq.XPUB)
    socket.setsockopt(zmq.XPUB_VERBOSE, 1)
    socket.setsockopt(zmq.SNDHWM, 2)
    socket.bind("inproc://stream")
    return Stream(reactor, socket, 2)


class Subscriber:
    """Receives in the test's thread; the reactor turns meanwhile."""

    def __init__(self, context, reactor, *topics, address="inproc://stream"):
        self.reactor = reactor
        self.socket = context.socket(zmq.SUB)
        self.socket.setsockopt(zmq.RCVHWM, 2)
        self.socket.connect(address)
        for topic in topics:
            self.socket.subscribe(topic)
        self.got = []
        for _ in range(5):
            reactor.turn(0.01)

    def drain(self):
        while self.socket.poll(0):
            envelope = wire.decode(self.socket.recv_multipart())
            self.got.append((envelope.topic, envelope.seq))

    def until(self, count, timeout_s=5.0):
        def enough():
            self.drain()
            return len(self.got) >= count

        self.reactor.run_until(enough, timeout_s)
        return self.got


def test_each_topic_is_numbered_for_itself(stream, reactor, context):
    subscriber = Subscriber(context, reactor, "")
    for name in ("a", "b"):
        stream.publish(event(name), wire.TOPIC_EVENT)
        stream.publish(Artifact("n", "t", np.zeros(3, np.uint8)))
    assert sorted(subscriber.until(4)) == [
        ("event", 1), ("event", 2), ("product/artifact", 1), ("product/artifact", 2)
    ]  # fmt: skip


def test_a_burst_reaches_a_subscriber_that_reads_whole(stream, reactor, context):
    subscriber = Subscriber(context, reactor, "event")
    for number in range(200):
        stream.publish(event(str(number)), wire.TOPIC_EVENT)
    assert [seq for _, seq in subscriber.until(200)] == list(range(1, 201))
    assert stream.outlet.dropped == 0


def test_a_late_joiner_gets_the_last_value_under_its_old_number(stream, reactor, context):
    for name in ("a", "b", "c"):
        stream.publish(event(name), wire.TOPIC_EVENT)
    assert Subscriber(context, reactor, "event").until(1) == [("event", 3)]
    stream.publish(event("d"), wire.TOPIC_EVENT)
    assert stream.counters["event"] == 4


def test_a_bulky_last_value_comes_again_at_most_once_a_second(stream, reactor, context):
    stream.publish(range_image())
    subscribers = [Subscriber(context, reactor, "product/range-image") for _ in range(5)]
    sent_before = stream.outlet.sent
    reactor.run_until(lambda: False, 0.3)
    assert stream.outlet.sent - sent_before <= 1
    assert subscribers[0].until(1) == [("product/range-image", 1)]


def test_nothing_is_encoded_while_nobody_listens(stream, monkeypatch):
    monkeypatch.setattr(wire, "prepare", lambda content: pytest.fail("encoded for nobody"))
    assert stream.publish(range_image()) == 1
    assert stream.outlet.sent == 0


def test_only_subscribed_topics_are_sent(stream, reactor, context):
    subscriber = Subscriber(context, reactor, "product/")
    stream.publish(event("a"), wire.TOPIC_EVENT)
    stream.publish(Artifact("n", "t", np.zeros(3, np.uint8)))
    assert subscriber.until(1) == [("product/artifact", 1)]
    assert stream.wanted("product/model")
    assert not stream.wanted("event")
    subscriber.socket.close()
    assert reactor.run_until(lambda: not stream.wanted("product/model"), 5.0)


def test_a_subscriber_that_does_not_read_holds_a_few_sets_and_delays_nobody(stream, reactor, context):
    asleep = Subscriber(context, reactor, "product/range-image")
    awake = Subscriber(context, reactor, "product/range-image")
    for number in range(1, 21):
        stream.publish(range_image())
        assert awake.until(number)[-1] == ("product/range-image", number)
    one = wire.prepare(range_image()).nbytes
    reactor.run_until(lambda: stream.outlet.held_bytes <= 6 * one, 5.0)
    assert stream.outlet.held_bytes <= 6 * one  # both ends' high-water marks, and one on its way
    asleep.drain()
    missed = 20 - len(asleep.got)
    assert missed > 0
    assert len(asleep.got) < 20


def test_random_bytes_on_the_socket_are_counted_and_harm_nobody(stream, reactor, context):
    noise = context.socket(zmq.XSUB)
    noise.connect("inproc://stream")
    for number in range(10_000):
        noise.send(os.urandom(number % 40), zmq.NOBLOCK if number % 2 else 0)
        if not number % 50:
            reactor.turn(0.0)
    subscriber = Subscriber(context, reactor, "event")
    reactor.run_until(lambda: False, 0.2)
    stream.publish(event("still here"), wire.TOPIC_EVENT)
    assert subscriber.until(1)[-1] == ("event", 1)
    assert stream.malformed > 5000
    assert reactor.failures == 0


def test_a_burst_of_bulky_messages_reaches_a_reading_process_whole(reactor, context, tmp_path):
    socket = context.socket(zmq.XPUB)
    socket.setsockopt(zmq.XPUB_VERBOSE, 1)
    socket.setsockopt(zmq.SNDHWM, 2)
    socket.bind(f"ipc://{tmp_path}/stream")
    stream = Stream(reactor, socket, 2)
    subscriber = Subscriber(context, reactor, "product/range-image", address=f"ipc://{tmp_path}/stream")
    assert reactor.run_until(lambda: stream.wanted("product/range-image"), 5.0)
    content = range_image()
    encoded = wire.prepare(content)
    for number in range(1, 301):
        reactor.run_until(lambda: stream.outlet.waiting == 0, 5.0)
        stream.publish(content, encoded=encoded)
        subscriber.drain()
        assert stream.outlet.dropped == 0
        assert number == stream.counters["product/range-image"]
    assert [seq for _, seq in subscriber.until(300)] == list(range(1, 301))
