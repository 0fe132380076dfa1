"""Requests, typed errors, answers that come later, and messages that are none."""

import json
import os
import random

import pytest
import zmq

from fringed import wire
from fringed.errors import ConfigurationError, DeviceAbsent, Problem
from fringed.messages import Event, Request
from fringed.serving.control import Control
from fringed.serving.requests import LATER


class Talk:
    """A control socket with a few verbs, and a client in the same thread."""

    def __init__(self, reactor, context):
        self.reactor = reactor
        self.calls = []
        socket = context.socket(zmq.ROUTER)
        socket.bind("inproc://control")
        verbs = {"echo": self.echo, "later": self.later, "absent": self.absent, "wrong": self.wrong, "bug": self.bug}
        self.control = Control(reactor, socket, verbs)
        self.client = context.socket(zmq.DEALER)
        self.client.connect("inproc://control")

    def echo(self, call):
        return dict(call.request.params)

    def later(self, call):
        self.calls.append(call)
        return LATER

    def absent(self, call):
        raise DeviceAbsent("no camera; plug it in")

    def wrong(self, call):
        raise ConfigurationError("2 problems:", (Problem("a.b", "1", "2"), Problem("c", "3", "4")))

    def bug(self, call):
        raise ZeroDivisionError("oops")

    def ask(self, verb, deadline_s=5.0, **params):
        self.client.send_multipart(wire.encode(Request("r1", verb, params, deadline_s)))
        return self.reply()

    def reply(self, timeout_s=5.0):
        assert self.reactor.run_until(lambda: bool(self.client.poll(0)), timeout_s)
        return wire.decode(self.client.recv_multipart()).content


@pytest.fixture
def talk(reactor, context):
    return Talk(reactor, context)


def test_a_request_is_answered_with_its_result(talk):
    reply = talk.ask("echo", a=1, b=[1.5, "x"])
    assert (reply.id, reply.result, reply.error) == ("r1", {"a": 1, "b": [1.5, "x"]}, None)


def test_errors_travel_with_their_class_and_problems(talk):
    assert talk.ask("absent").error.code == "DeviceAbsent"
    wrong = talk.ask("wrong").error
    assert wrong.code == "ConfigurationError"
    assert wrong.detail == ("a.b: 1 is not allowed; expected 2", "c: 3 is not allowed; expected 4")


def test_an_unknown_verb_lists_those_that_exist(talk):
    error = talk.ask("nonsense").error
    assert error.code == "NotFound"
    assert "absent, bug, echo, later, wrong" in error.message


def test_a_verb_that_fails_by_mistake_is_answered_and_counted(talk, reactor):
    assert "ZeroDivisionError: oops" in talk.ask("bug").error.message
    assert reactor.failures == 1
    assert talk.ask("echo").error is None


def test_an_answer_may_come_later_and_comes_once(talk, reactor):
    talk.client.send_multipart(wire.encode(Request("r1", "later")))
    reactor.run_until(lambda: bool(talk.calls), 5.0)
    assert talk.ask("echo").result == {}
    talk.calls[0].reply("first")
    talk.calls[0].reply("second")
    assert talk.reply().result == "first"
    assert not talk.client.poll(50)


def test_a_deadline_that_is_over_is_told(talk):
    assert talk.ask("echo", deadline_s=0.0).error.code == "RequestTimeout"


def test_another_protocol_version_is_answered_with_its_own_id(talk):
    head = {"v": 99, "kind": "Request", "seq": 0, "body": {"id": "mine", "verb": "echo"}, "buffers": []}
    talk.client.send_multipart([b"", json.dumps(head).encode()])
    reply = talk.reply()
    assert (reply.id, reply.error.code) == ("mine", "VersionMismatch")
    assert "install the same release" in reply.error.message


def test_a_message_that_is_no_request_is_refused(talk):
    talk.client.send_multipart(wire.encode(Event("x", "now")))
    assert "takes a Request" in talk.reply().error.message


def noise(rng, number):
    """Return random parts: pure noise, and requests with something wrong in them."""
    if number % 2:
        return [rng.randbytes(rng.randrange(60)) for _ in range(rng.randrange(1, 6))]
    parts = [bytearray(bytes(part)) for part in wire.encode(Request("r", "echo", {"a": [1, {"b": "c"}]}))]
    for _ in range(rng.randrange(1, 4)):
        part = rng.choice(parts)
        if part:
            part[rng.randrange(len(part))] = rng.randrange(256)
    return [bytes(part) for part in parts]


def test_ten_thousand_random_messages_are_counted_and_leave_it_serving(talk, reactor):
    rng = random.Random(7)
    for number in range(10_000):
        talk.client.send_multipart(noise(rng, number))
        reactor.turn(0.0)
        while talk.client.poll(0):
            wire.decode(talk.client.recv_multipart())
    while reactor.run_until(lambda: bool(talk.client.poll(0)), 0.3):
        talk.client.recv_multipart()
    assert talk.control.counters["malformed"] > 5000
    assert reactor.failures == 0
    assert talk.ask("echo", fine=True).result == {"fine": True}


def test_a_flood_of_malformed_messages_does_not_fill_the_log(talk, reactor, caplog):
    for _ in range(300):
        talk.client.send_multipart([os.urandom(8)])
    reactor.run_until(lambda: talk.control.counters["malformed"] == 300, 5.0)
    assert 1 <= caplog.text.count("malformed") <= 3
