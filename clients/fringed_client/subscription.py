"""A blocking subscription to a station's stream.

Owns one SUB socket with its monitor; the counting is in `protocol.messages`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import zmq
from zmq.utils.monitor import recv_monitor_message

from fringed.errors import ConnectionLost, RequestTimeout
from fringed_client.address import Address
from fringed_client.link import LOST, prepare
from fringed_client.protocol.messages import Message, SubscriptionCore

SILENCE_MAX_S = 6.0  # the station's state comes each second
SLICE_S = 0.5
DRAIN_MAX = 1000
QUEUE = 2  # frame sets are large: few are kept, so that what is read is recent


class Subscription:
    """Iterate over typed messages; what was dropped in between is counted in `Message.missed`.

    With `latest`, everything but the newest message of each topic is skipped when the reader is slower than
    the station. Silence of more than six seconds, or a broken connection, raises ConnectionLost.
    """

    def __init__(
        self, context: zmq.Context[Any], address: Address, stream: str, topics: Sequence[str], latest: bool = False
    ) -> None:
        self.core = SubscriptionCore(topics)
        self._latest = latest
        self._where = str(address)
        self._pending: dict[str, list[Any]] = {}
        self._socket = context.socket(zmq.SUB)
        prepare(self._socket, address)
        self._socket.setsockopt(zmq.RCVHWM, QUEUE)
        self._monitor = self._socket.get_monitor_socket(LOST)
        for prefix in self.core.prefixes:
            self._socket.subscribe(prefix)
        self._poller = zmq.Poller()
        self._poller.register(self._socket, zmq.POLLIN)
        self._poller.register(self._monitor, zmq.POLLIN)
        self._socket.connect(stream)

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @property
    def closed(self) -> bool:
        """Tell whether it was stopped."""
        return bool(self._socket.closed)

    def close(self) -> None:
        """Stop; harmless when stopped."""
        if not self._socket.closed:
            self._socket.disable_monitor()
            self._monitor.close(0)
            self._socket.close(0)

    def __iter__(self) -> Iterator[Message]:
        while True:
            yield self.next()

    def next(self, timeout_s: float | None = None) -> Message:
        """Return the next message.

        Raises
        ------
        RequestTimeout
            none came within `timeout_s`.
        ConnectionLost
            the station is gone.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        silent_s = 0.0
        while True:
            slice_s = SLICE_S if deadline is None else min(SLICE_S, max(deadline - time.monotonic(), 0.0))
            frames = self._take(slice_s)
            if frames is not None:
                silent_s = 0.0
                message = self.core.receive(frames)
                if message is not None:
                    return message
            else:
                # Only slices that were waited through count: a reader that was stopped itself finds its queue full.
                silent_s += slice_s
            if silent_s >= SILENCE_MAX_S:
                raise ConnectionLost(f"the station at {self._where} has been silent for {silent_s:.0f} s")
            if deadline is not None and frames is None and time.monotonic() >= deadline:
                raise RequestTimeout(f"nothing came on {', '.join(self.core.wanted)} within {timeout_s:g} s")

    def _take(self, slice_s: float) -> list[Any] | None:
        if self._pending:
            return self._pending.pop(next(iter(self._pending)))
        ready = dict(self._poller.poll(int(slice_s * 1000)))
        if self._socket not in ready:
            if ready:
                recv_monitor_message(self._monitor)
                raise ConnectionLost(f"the connection to the station at {self._where} broke; open a new Station")
            return None
        frames: list[Any] = self._socket.recv_multipart(copy=False)
        if not self._latest:
            return frames
        self._drain(frames)
        return self._take(0)

    def _drain(self, frames: list[Any]) -> None:
        for _ in range(DRAIN_MAX):
            topic = bytes(frames[0]).decode(errors="replace")
            self._pending.pop(topic, None)
            self._pending[topic] = frames
            try:
                frames = self._socket.recv_multipart(flags=zmq.DONTWAIT, copy=False)
            except zmq.Again:
                return
