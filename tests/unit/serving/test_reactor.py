"""The loop: posted calls, timers, sockets, and handlers that fail."""

import threading

import zmq


def test_calls_posted_by_another_thread_run_in_order(reactor):
    seen = []

    def post():
        for number in range(1000):
            reactor.post(lambda n=number: seen.append(n))
        reactor.post(reactor.stop)

    thread = threading.Thread(target=post)
    thread.start()
    reactor.run()
    thread.join()
    assert seen == list(range(1000))


def test_a_failing_handler_is_counted_and_harms_nobody(reactor, caplog):
    seen = []
    reactor.post(lambda: 1 / 0)
    reactor.post(lambda: seen.append("later"))
    reactor.post(reactor.stop)
    reactor.run()
    assert seen == ["later"]
    assert reactor.failures == 1
    assert "ZeroDivisionError" in caplog.text


def test_timers_run_in_the_order_they_are_due_and_not_when_cancelled(reactor):
    seen = []
    reactor.call_later(0.02, lambda: seen.append("second"))
    reactor.call_later(0.001, lambda: seen.append("first"))
    reactor.call_later(0.01, lambda: seen.append("never")).cancel()
    assert reactor.run_until(lambda: "second" in seen, 5.0)
    assert seen == ["first", "second"]


def test_a_repeated_call_survives_its_own_failure(reactor):
    calls = []

    def fails():
        calls.append(1)
        raise ValueError("always")

    reactor.every(0.001, fails)
    assert reactor.run_until(lambda: len(calls) >= 3, 5.0)
    assert reactor.failures >= 3


def test_a_socket_is_served_until_it_is_removed(reactor, context):
    a, b = context.socket(zmq.PAIR), context.socket(zmq.PAIR)
    a.bind("inproc://pair")
    b.connect("inproc://pair")
    seen = []
    reactor.add_socket(a, lambda: seen.append(a.recv()))
    b.send(b"one")
    assert reactor.run_until(lambda: seen == [b"one"], 5.0)
    reactor.remove_socket(a)
    b.send(b"two")
    assert not reactor.run_until(lambda: len(seen) > 1, 0.05)


def test_run_until_tells_when_time_is_over(reactor):
    assert not reactor.run_until(lambda: False, 0.01)
