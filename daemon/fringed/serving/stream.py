"""The stream socket: everything worth watching, lossy by design, countable by every subscriber.

Owns topics' sequence numbers, the last value of each topic and who wants what; never blocks. A late joiner gets
the last value of its topics by their being sent again with the same number (decision 4), the bulky ones at most
once a second.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import Any

import zmq

from fringed import wire
from fringed.serving.outlet import BULK_BYTES, Outlet, Patience
from fringed.serving.reactor import Reactor, Timer

_log = logging.getLogger(__name__)
_SMALL_WAITING = 1000
_AGAIN_S = 1.0
_BURST = 64  # subscriptions taken before others have their turn


@dataclass
class _Topic:
    """What is known of one topic: its number, and its last value until somebody needs it encoded."""

    seq: int = 0
    content: Any = None
    encoded: wire.Encoded | None = None
    sent_s: float = float("-inf")
    again: Timer | None = None

    def prepared(self) -> wire.Encoded:
        """Encode the last value, once."""
        if self.encoded is None:
            self.encoded = wire.prepare(self.content)
        return self.encoded


class Stream:
    """Publish to whoever subscribed. `socket` is an XPUB, bound by its owner."""

    def __init__(self, reactor: Reactor, socket: zmq.Socket[bytes], high_water_mark: int) -> None:
        self.counters: Counter[str] = Counter()
        self.malformed = 0
        self._reactor = reactor
        self._socket = socket
        self._topics: dict[str, _Topic] = {topic: _Topic() for topic in wire.TOPICS}
        self._prefixes: set[str] = set()
        self._wanted: set[str] = set()
        self._bulk_waiting = max(2, high_water_mark)
        self.outlet = Outlet(reactor, socket, max(1, high_water_mark), Patience())
        reactor.add_socket(socket, self._receive)

    def wanted(self, topic: str) -> bool:
        """Tell whether anybody subscribed to it."""
        return topic in self._wanted

    def publish(self, content: Any, topic: str = "", encoded: wire.Encoded | None = None) -> int:
        """Announce a value under its topic; return its sequence number.

        Nothing is encoded while nobody listens, nor where `encoded` (of `wire.prepare`) is at hand.
        """
        topic = topic or wire.topic_of(content)
        known = self._topics[topic]
        known.seq += 1
        known.content, known.encoded = content, encoded
        self.counters[topic] += 1
        if known.again is not None:
            known.again.cancel()
            known.again = None
        if self.wanted(topic):
            self._send(topic, known)
        return known.seq

    def _send(self, topic: str, known: _Topic) -> None:
        encoded = known.prepared()
        bulk = encoded.nbytes >= BULK_BYTES
        known.sent_s = self._reactor.now()
        self.outlet.send(
            partial(encoded.frames, topic, known.seq), encoded.nbytes, self._bulk_waiting if bulk else _SMALL_WAITING
        )

    def _receive(self) -> None:
        for _ in range(_BURST):
            try:
                parts = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            self._subscription(parts)

    def _subscription(self, parts: list[bytes]) -> None:
        raw = parts[0]
        if len(parts) != 1 or raw[:1] not in (b"\0", b"\1"):
            self.malformed += 1
            return
        prefix = raw[1:].decode(errors="replace")
        matching = [topic for topic in self._topics if topic.startswith(prefix)]
        if not matching:
            return
        if raw[:1] == b"\1":
            self._joined(prefix, matching)
        else:
            self._prefixes.discard(prefix)
            self._wanted = {t for t in self._topics if any(t.startswith(p) for p in self._prefixes)}

    def _joined(self, prefix: str, matching: list[str]) -> None:
        self._prefixes.add(prefix)
        self._wanted.update(matching)
        for topic in matching:
            known = self._topics[topic]
            if known.seq and known.again is None:
                since = self._reactor.now() - known.sent_s
                bulk = known.prepared().nbytes >= BULK_BYTES
                wait_s = max(0.0, _AGAIN_S - since) if bulk else 0.0
                known.again = self._reactor.call_later(wait_s, partial(self._again, topic))

    def _again(self, topic: str) -> None:
        known = self._topics[topic]
        known.again = None
        if self.wanted(topic):
            self._send(topic, known)
