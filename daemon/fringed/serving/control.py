"""The control socket: requests in, typed replies out, in any order.

Owns decoding, the table of verbs, deadlines and what becomes of messages that cannot be meant; knows nothing of
what a verb does. Never blocks: a verb answers now, or says `LATER` and answers by its `Call`.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import msgspec
import zmq

from fringed import wire
from fringed.errors import FringedError, NotFound, RequestTimeout, StationBusy, WireError
from fringed.messages import ErrorInfo, Reply, Request
from fringed.serving.outlet import BULK_BYTES, send_tracked
from fringed.serving.reactor import Reactor
from fringed.serving.requests import Call, Later, Verb, error_info

_log = logging.getLogger(__name__)
_BURST = 64  # messages taken before others have their turn
_DEADLINE_MAX_S = 86400.0
_HELD_MAX_BYTES = 512 * 1024 * 1024
_HELD_CLIENT_MAX_BYTES = 256 * 1024 * 1024
_LOG_INTERVAL_S = 1.0


@dataclass(eq=False)
class _Held:
    """A big reply that zmq still holds, because its client has not read it."""

    identity: bytes
    nbytes: int
    trackers: list[zmq.MessageTracker] = field(default_factory=list)


class Control:
    """Answer requests. `socket` is a ROUTER, bound by its owner."""

    def __init__(self, reactor: Reactor, socket: zmq.Socket[bytes], verbs: Mapping[str, Verb]) -> None:
        self.counters: Counter[str] = Counter()
        self._reactor = reactor
        self._socket = socket
        self._verbs = dict(verbs)
        self._held: deque[_Held] = deque()
        self._complaints = 0
        self._complained_s = float("-inf")
        reactor.add_socket(socket, self._receive)

    def _receive(self) -> None:
        for _ in range(_BURST):
            try:
                frames = self._socket.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                return
            self._take(frames[0].bytes, [frame.buffer for frame in frames[1:]], _is_remote(frames[-1]))

    def _take(self, identity: bytes, parts: list[Any], remote: bool) -> None:
        try:
            content = wire.decode(parts).content
            if not isinstance(content, Request):
                raise WireError(f"a {type(content).__name__} came to the control socket; it takes a Request")
        except WireError as error:
            self._malformed(identity, parts, error)
            return
        self.counters["requests"] += 1
        deadline_s = min(max(content.deadline_s, 0.0), _DEADLINE_MAX_S)
        call = Call(content, partial(self._answer, identity, content.id), self._reactor.now() + deadline_s, remote)
        self._dispatch(call)

    def _dispatch(self, call: Call) -> None:
        request = call.request
        try:
            if call.deadline_s <= self._reactor.now():
                raise RequestTimeout(
                    f"{request.verb} came with a deadline of {request.deadline_s:g} s; give it more than 0"
                )
            verb = self._verbs.get(request.verb)
            if verb is None:
                known = ", ".join(sorted(self._verbs))
                raise NotFound(f"no request is called {request.verb[:80]!r}; there are {known}")
            result = verb(call)
        except FringedError as error:
            call.fail(error)
        except Exception as error:  # noqa: BLE001  a verb's mistake is answered and logged; the station goes on
            self._reactor.failures += 1
            _log.exception("the request %s failed", request.verb)
            call.fail(error)
        else:
            if not isinstance(result, Later):
                call.reply(result)

    def _answer(self, identity: bytes, request_id: str, result: Any, error: ErrorInfo | None) -> None:
        try:
            encoded = result if isinstance(result, wire.Encoded) else wire.prepare(Reply(request_id, result, error))
        except WireError as problem:
            encoded = wire.prepare(Reply(request_id, None, error_info(problem)))
        if error is not None:
            self.counters["errors"] += 1
        self.send(identity, request_id, encoded)

    def send(self, identity: bytes, request_id: str, encoded: wire.Encoded) -> None:
        """Send an encoded reply, unless its client already has too much to read."""
        self._let_go()
        if encoded.nbytes < BULK_BYTES:
            self._deliver(identity, encoded)
            return
        mine = sum(held.nbytes for held in self._held if held.identity == identity)
        everybody = sum(held.nbytes for held in self._held)
        if mine + encoded.nbytes > max(_HELD_CLIENT_MAX_BYTES, encoded.nbytes) or (
            everybody and everybody + encoded.nbytes > _HELD_MAX_BYTES
        ):
            busy = StationBusy(
                f"replies of {everybody / 1e6:.0f} MB wait to be read, {mine / 1e6:.0f} MB of them by this client; "
                f"read them before asking for more"
            )
            self._deliver(identity, wire.prepare(Reply(request_id, None, error_info(busy))))
            return
        self._held.append(_Held(identity, encoded.nbytes, self._deliver(identity, encoded)))

    def _deliver(self, identity: bytes, encoded: wire.Encoded) -> list[zmq.MessageTracker]:
        """Send; a client that is gone or whose queue is full loses it, as zmq's ROUTER does."""
        frames = [identity, *encoded.frames("")]
        if encoded.nbytes < BULK_BYTES:
            self._socket.send_multipart(frames, zmq.NOBLOCK)
            return []
        return send_tracked(self._socket, frames)

    def _let_go(self) -> None:
        self._held = deque(held for held in self._held if not all(tracker.done for tracker in held.trackers))

    def _malformed(self, identity: bytes, parts: list[Any], error: WireError) -> None:
        self.counters["malformed"] += 1
        self._complaints += 1
        if self._reactor.now() - self._complained_s >= _LOG_INTERVAL_S:
            _log.warning("control: %d malformed message(s), the last: %s", self._complaints, error.message[:300])
            self._complaints, self._complained_s = 0, self._reactor.now()
        self._answer(identity, _request_id(parts), None, error_info(error))


def _is_remote(frame: zmq.Frame) -> bool:
    try:
        return not str(frame.get("Peer-Address")).startswith("localhost:")  # ipc: "localhost:uid:gid:pid"
    except zmq.ZMQError:  # a local socket has no such property
        return False


class _IdOnly(msgspec.Struct, frozen=True):
    id: str = ""


class _BodyOnly(msgspec.Struct):
    body: _IdOnly = _IdOnly()


def _request_id(parts: list[Any]) -> str:
    """Return the id of a message that is otherwise no request of this version, empty where it has none."""
    if len(parts) < 2 or len(parts[1]) > BULK_BYTES:
        return ""
    try:
        return msgspec.json.decode(bytes(parts[1]), type=_BodyOnly).body.id[:200]
    except (msgspec.DecodeError, ValueError, RecursionError):
        return ""
