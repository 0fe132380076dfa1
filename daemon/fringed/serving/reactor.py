"""One thread that polls sockets, runs timers and what other threads post.

Owns the loop; knows nothing of what its callbacks do. A callback that raises is logged and counted and harms
nobody else. Only `post` and `stop` may be called from other threads (and from signal handlers).
"""

from __future__ import annotations

import heapq
import itertools
import logging
import os
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress

import zmq

_log = logging.getLogger(__name__)
_LONGEST_WAIT_S = 1.0
_POSTED_AT_ONCE = 256


class Timer:
    """One callback that is due; `cancel` makes it harmless."""

    __slots__ = ("callback",)

    def __init__(self, callback: Callable[[], None]) -> None:
        self.callback: Callable[[], None] | None = callback

    def cancel(self) -> None:
        """Never call it."""
        self.callback = None


class Reactor:
    """Poll, run timers, run what was posted, until `stop`."""

    def __init__(self) -> None:
        self.failures = 0
        self._poller = zmq.Poller()
        self._handlers: dict[object, Callable[[], None]] = {}
        self._timers: list[tuple[float, int, Timer]] = []
        self._order = itertools.count()
        self._posted: deque[Callable[[], None]] = deque()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._poller.register(self._wake, zmq.POLLIN)
        self._running = True
        self._closed = False

    @staticmethod
    def now() -> float:
        """Return the reactor's clock, in seconds."""
        return time.monotonic()

    def add_socket(self, socket: zmq.Socket[bytes], handler: Callable[[], None]) -> None:
        """Call `handler` whenever something can be received; it has to take at least one message."""
        self._poller.register(socket, zmq.POLLIN)
        self._handlers[socket] = handler

    def remove_socket(self, socket: zmq.Socket[bytes]) -> None:
        """Forget a socket; harmless when unknown."""
        if self._handlers.pop(socket, None) is not None:
            self._poller.unregister(socket)

    def call_later(self, delay_s: float, callback: Callable[[], None]) -> Timer:
        """Call once, that much later."""
        timer = Timer(callback)
        heapq.heappush(self._timers, (self.now() + delay_s, next(self._order), timer))
        return timer

    def every(self, interval_s: float, callback: Callable[[], None]) -> None:
        """Call at once and again after each interval."""

        def again() -> None:
            self.call_later(interval_s, again)
            callback()

        self.call_later(0.0, again)

    def post(self, callback: Callable[[], None]) -> None:
        """Have the reactor's thread call that soon; from any thread. Late ones are dropped after `close`."""
        self._posted.append(callback)
        if not self._closed:
            os.eventfd_write(self._wake, 1)

    def stop(self) -> None:
        """Leave `run` after the present round; from any thread."""
        self._running = False
        if not self._closed:
            os.eventfd_write(self._wake, 1)

    def run(self) -> None:
        """Serve until `stop`; may be called again afterwards, to finish what is left."""
        while self._running:
            self.turn(_LONGEST_WAIT_S)
        self._running = True

    def run_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Serve until `done()` or the time is over; return which."""
        deadline = self.now() + timeout_s
        while not done():
            if self.now() >= deadline:
                return False
            self.turn(0.02)
        return True

    def turn(self, wait_s: float) -> None:
        """Serve one round: what is ready now, after waiting for at most `wait_s`."""
        ready = self._poller.poll(self._wait_ms(wait_s))
        for socket, _ in ready:
            if socket == self._wake:
                self._drain_wake()
            elif socket in self._handlers:
                self._call(self._handlers[socket])
        for _ in range(min(len(self._posted), _POSTED_AT_ONCE)):
            self._call(self._posted.popleft())
        self._run_timers()

    def close(self) -> None:
        """Release the wake-up; sockets belong to those who made them."""
        if not self._closed:
            self._closed = True
            os.close(self._wake)

    def _wait_ms(self, wait_s: float) -> int:
        if self._posted:
            return 0
        if self._timers:
            wait_s = min(wait_s, max(0.0, self._timers[0][0] - self.now()))
        return -int(-wait_s * 1000 // 1)  # rounded up: a timer that is nearly due must not spin

    def _drain_wake(self) -> None:
        with suppress(BlockingIOError):
            os.eventfd_read(self._wake)

    def _run_timers(self) -> None:
        now = self.now()
        while self._timers and self._timers[0][0] <= now:
            timer = heapq.heappop(self._timers)[2]
            if timer.callback is not None:
                self._call(timer.callback)

    def _call(self, callback: Callable[[], None]) -> None:
        try:
            callback()
        except Exception:  # noqa: BLE001  the thread's top: whatever a handler raises, the others go on
            self.failures += 1
            _log.exception("a handler of the reactor failed")
