"""The clients' logic without sockets."""

from __future__ import annotations

import numpy as np
import pytest

from fringed import wire
from fringed.errors import Cancelled, LeaseError, QualityError, RequestTimeout, UsageError, VersionMismatch, WireError
from fringed.messages import ErrorInfo, Event, Preview, Reply, ScanState
from fringed_client.protocol import flows
from fringed_client.protocol.messages import SubscriptionCore
from fringed_client.protocol.requests import Call, RequestCore, revive


def as_bytes(frames: list) -> list[bytes]:
    return [bytes(part) if isinstance(part, bytes) else part.tobytes() for part in frames]


def event(seq: int, topic: str = "event") -> list[bytes]:
    return as_bytes(wire.encode(Event("x", "now"), topic, seq))


def running(progress: float = 0.0) -> ScanState:
    return ScanState("id", "acquiring", "hierarchical", progress)


def test_every_request_has_an_id_of_its_own_and_carries_lease_and_deadline() -> None:
    core = RequestCore("me")
    first, _ = core.request(Call("status"))
    second, frames = core.request(Call("scan", {"pipeline": "x"}, 7.0), "token")
    sent = wire.decode(as_bytes(frames)).content
    assert first != second
    assert (sent.id, sent.verb, sent.deadline_s, sent.lease, sent.client) == (second, "scan", 7.0, "token", "me")


def test_reply_to_a_forgotten_request_is_a_stray() -> None:
    core = RequestCore("me")
    request_id, _ = core.request(Call("status"))
    core.forget(request_id)
    assert core.receive(as_bytes(wire.encode(Reply(request_id, 1)))) is None
    assert core.strays == 1


def test_reply_is_taken_once() -> None:
    core = RequestCore("me")
    request_id, _ = core.request(Call("status"))
    frames = as_bytes(wire.encode(Reply(request_id, {"a": 1})))
    assert core.result(core.receive(frames)) == {"a": 1}
    assert core.receive(frames) is None


def test_anything_but_a_reply_is_refused() -> None:
    with pytest.raises(WireError, match="Event"):
        RequestCore("me").receive(event(1))


def test_complaint_about_an_unreadable_request_is_raised() -> None:
    with pytest.raises(VersionMismatch, match="version"):
        RequestCore("me").receive(as_bytes(wire.encode(Reply("", None, ErrorInfo("VersionMismatch", "version 2")))))


def test_errors_come_back_as_what_they_were() -> None:
    error = revive(ErrorInfo("LeaseError", "held by ann", ("a note",)))
    assert isinstance(error, LeaseError) and isinstance(error, PermissionError)
    assert str(error) == "held by ann" and error.__notes__ == ["a note"]
    assert str(revive(ErrorInfo("Unheard", "of"))) == "Unheard: of"


def test_missed_messages_are_counted_per_topic() -> None:
    core = SubscriptionCore(["event", "preview"])
    picture = Preview(np.zeros((2, 3), np.uint8), "object", 0, 1)
    got = [core.receive(event(n)) for n in (5, 6, 9)]
    got.append(core.receive(as_bytes(wire.encode(picture, "preview", 40))))
    assert [m.missed for m in got if m] == [0, 0, 2, 0]
    assert core.missed == 2


def test_last_value_sent_again_to_late_joiners_is_dropped() -> None:
    core = SubscriptionCore(["event"])
    assert core.receive(event(7)) is not None
    assert core.receive(event(7)) is None
    assert core.receive(event(8)).missed == 0


def test_heartbeat_is_followed_but_not_shown_to_who_did_not_ask() -> None:
    core = SubscriptionCore(["frameset"])
    assert core.prefixes == ("frameset", "state")
    assert core.receive(event(1, "state")) is None
    assert SubscriptionCore([]).prefixes == ("",)


def test_malformed_message_is_counted_and_harmless() -> None:
    core = SubscriptionCore([])
    assert core.receive([b"event", b"{not json"]) is None
    assert core.receive([b"event"]) is None
    assert core.malformed == 2
    assert core.receive(event(1)) is not None


def test_message_of_another_version_is_an_error() -> None:
    with pytest.raises(VersionMismatch, match="install the same release"):
        SubscriptionCore([]).receive([b"event", b'{"v":999,"kind":"Event"}'])


def test_unknown_topic_names_those_that_exist() -> None:
    with pytest.raises(UsageError, match="frameset"):
        SubscriptionCore(["pictures"])


def test_following_a_scan_waits_with_what_it_has_seen() -> None:
    flow = flows.submit("scan", {"pipeline": "p", "preset": None}, 10)
    call = next(flow)
    assert (call.verb, call.params) == ("scan", {"pipeline": "p"})
    call = flow.send(running(0.25))
    assert call.verb == "wait"
    assert call.params["seen"] == {"state": "acquiring", "progress": 0.25, "products": 0}
    with pytest.raises(StopIteration) as end:
        flow.send(ScanState("id", "done", "p", 1.0))
    assert end.value.value.state == "done"


def test_failed_scan_raises_its_error() -> None:
    flow = flows.submit("scan", {}, 10)
    next(flow)
    with pytest.raises(QualityError, match="too dark"):
        flow.send(ScanState("id", "failed", "p", error=ErrorInfo("QualityError", "too dark")))


@pytest.mark.parametrize("stop", [KeyboardInterrupt, Cancelled])
def test_interrupted_scan_is_cancelled_on_the_station(stop: type[BaseException]) -> None:
    flow = flows.submit("scan", {}, 10)
    next(flow)
    flow.send(running())
    if stop is Cancelled:  # an answer of the station is no interruption: nothing is left to cancel
        with pytest.raises(Cancelled):
            flow.throw(Cancelled("by somebody"))
        return
    call = flow.throw(stop())
    assert (call.verb, call.params) == ("cancel", {"id": "id"})
    with pytest.raises(stop):
        flow.send(None)


def test_scan_that_takes_too_long_is_cancelled() -> None:
    times = iter([0.0, 5.0, 11.0])
    flow = flows.submit("scan", {}, 10, clock=lambda: next(times))
    next(flow)
    assert flow.send(running()).verb == "wait"
    assert flow.send(running(0.5)).verb == "cancel"
    with pytest.raises(RequestTimeout, match="50%"):
        flow.send(None)


def test_waiting_for_somebody_elses_scan_leaves_it_running() -> None:
    times = iter([0.0, 11.0])
    flow = flows.watch("id", 10, clock=lambda: next(times))
    next(flow)
    with pytest.raises(RequestTimeout, match="still acquiring"):
        flow.send(running())


def test_hello_of_another_protocol_is_refused() -> None:
    flow = flows.hello("here")
    next(flow)
    with pytest.raises(VersionMismatch, match="protocol 99"):
        flow.send({"protocol": 99, "version": "9.9"})


def test_registering_needs_two_views() -> None:
    with pytest.raises(UsageError, match="two or more"):
        flows.register_params(["a"], None, None, True)
    with pytest.raises(UsageError, match="exactly two"):
        flows.register_params(["a", "b", "c"], None, None, False)
