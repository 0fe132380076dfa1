"""The work socket: a ROUTER between the dispatcher, which decides, and the workers, who work.

Owns the socket, and nothing that could be decided: frames in, messages to the dispatcher, its outbox out. A
message that cannot be read is counted, logged and answered; a worker that cannot be reached is lost.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import zmq

from fringed import wire
from fringed.data import Array
from fringed.errors import DataError, WireError
from fringed.messages import ErrorInfo, FeedBegin, FeedLost, Job, JobFailed

_log = logging.getLogger(__name__)

_TICK_S = 0.1
_BURST = 16  # messages taken before others have their turn
_HIGH_WATER_MARK = 64


class FeedLogic(Protocol):
    """What this socket needs of who decides which worker is fed."""

    def begin(self, begin: FeedBegin, now: float) -> bool:
        """Feed a set to an idle worker."""

    def frame(self, feed_id: str, index: int, image: Array, now: float) -> None:
        """Send its next frame."""

    def drop(self, feed_id: str, reason: str, now: float) -> None:
        """Have its frames forgotten."""


class WorkLogic(Protocol):
    """What this socket needs of the dispatcher."""

    @property
    def feeding(self) -> FeedLogic:
        """Who is fed."""

    def submit(self, job: Job, watcher: Any, now: float, timeout_s: float | None = None) -> None:
        """Queue a job."""

    def cancel(self, job: str, now: float) -> bool:
        """Stop a job."""

    def taken(self, job: str, stage: str) -> None:
        """Tell a job's worker that a product of it is announced."""

    def received(self, worker: str, message: Any, now: float) -> None:
        """Take one message."""

    def malformed(self, worker: str, problem: str, answer: bool = True) -> None:
        """Count what was no message."""

    def lost(self, worker: str, reason: str, now: float) -> None:
        """Forget a worker."""

    def tick(self, now: float) -> None:
        """Let time pass."""

    def take_outbox(self) -> list[tuple[str, Any]]:
        """Return what is to be sent."""


class Reactor(Protocol):
    """What this socket needs of the reactor."""

    def add_socket(self, socket: zmq.Socket[bytes], handler: Callable[[], None]) -> None:
        """Call `handler` whenever `socket` can be read."""

    def remove_socket(self, socket: zmq.Socket[bytes]) -> None:
        """Forget `socket`."""

    def every(self, interval_s: float, callback: Callable[[], None]) -> None:
        """Call at once and again after each interval."""


class WorkSocket:
    """Thin glue; lives in the reactor's thread. `each_tick` are called with the time every 0.1 s."""

    def __init__(
        self,
        context: zmq.Context[zmq.Socket[bytes]],
        logic: WorkLogic,
        each_tick: Sequence[Callable[[float], None]] = (),
    ) -> None:
        self._logic = logic
        self._each_tick = tuple(each_tick)
        self._reactor: Reactor | None = None
        self._unlogged, self._next_log_s = 0, 0.0
        self.socket = context.socket(zmq.ROUTER)
        self.socket.setsockopt(zmq.ROUTER_MANDATORY, 1)
        self.socket.setsockopt(zmq.ROUTER_HANDOVER, 1)
        self.socket.setsockopt(zmq.SNDHWM, _HIGH_WATER_MARK)
        self.socket.setsockopt(zmq.LINGER, 0)

    def bind(self, endpoint: str) -> None:
        """Listen there too; set CURVE on `socket` before a tcp address."""
        self.socket.bind(endpoint)

    def attach(self, reactor: Reactor) -> None:
        """Let `reactor` drive this socket and its ticks."""
        self._reactor = reactor
        reactor.add_socket(self.socket, self.serve)
        reactor.every(_TICK_S, self._tick)

    def submit(self, job: Job, watcher: Any, timeout_s: float | None = None) -> None:
        """Queue a job and send it if somebody is free; raises as `Dispatcher.submit` does."""
        self._logic.submit(job, watcher, time.monotonic(), timeout_s)
        self.flush()

    def cancel(self, job: str) -> bool:
        """Stop a job; return whether it was on its way."""
        known = self._logic.cancel(job, time.monotonic())
        self.flush()
        return known

    def taken(self, job: str, stage: str) -> None:
        """Tell a job's worker that a product of it is announced."""
        self._logic.taken(job, stage)
        self.flush()

    def feed_begin(self, begin: FeedBegin) -> None:
        """Feed a set to an idle worker, if there is one."""
        self._logic.feeding.begin(begin, time.monotonic())
        self.flush()

    def feed_frame(self, feed: str, index: int, image: Array) -> None:
        """Send its next frame; harmless where nobody is fed."""
        self._logic.feeding.frame(feed, index, image, time.monotonic())
        self.flush()

    def feed_drop(self, feed: str, reason: str) -> None:
        """Have its frames forgotten; harmless where nobody is fed, or a job has them."""
        self._logic.feeding.drop(feed, reason, time.monotonic())
        self.flush()

    def serve(self) -> None:
        """Take what has come, at most a burst of it, and send what follows from it."""
        for _ in range(_BURST):
            try:
                frames = self.socket.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                break
            self._take(frames)
        self.flush()

    def tick(self, now: float) -> None:
        """Let time pass for the dispatcher and whoever else ticks."""
        for callback in self._each_tick:
            callback(now)
        self._logic.tick(now)
        self.flush()

    def flush(self) -> None:
        """Send the outbox."""
        while outbox := self._logic.take_outbox():
            for worker, message in outbox:
                self._send(worker, message)

    def close(self) -> None:
        """Send what is left and close."""
        self.flush()
        if self._reactor is not None:
            self._reactor.remove_socket(self.socket)
        self.socket.close(linger=200)

    def _tick(self) -> None:
        if not self.socket.closed:
            self.tick(time.monotonic())

    def _take(self, frames: list[zmq.Frame]) -> None:
        worker = frames[0].bytes.decode("latin-1")
        try:
            message = wire.decode([frame.buffer for frame in frames[1:]]).content
        except WireError as error:
            self._logic.malformed(worker, error.message)
            self._tell_malformed(worker, error)
            return
        self._logic.received(worker, message, time.monotonic())

    def _tell_malformed(self, worker: str, error: WireError) -> None:
        """Log the first one and then one a second: a flood must not fill the log."""
        self._unlogged += 1
        now = time.monotonic()
        if now >= self._next_log_s:
            _log.warning("work: %d malformed messages, the last one from %r: %s", self._unlogged, worker, error)
            self._unlogged, self._next_log_s = 0, now + 1.0

    def _send(self, worker: str, message: Any) -> None:
        try:
            frames = [_identity(worker), *wire.encode(message)]
        except DataError as error:  # only a job, and what announces one, hold what came from outside
            answer: JobFailed | FeedLost = FeedLost(getattr(message, "feed", ""), error.message)
            if isinstance(message, Job):
                answer = JobFailed(message.id, "", ErrorInfo("DataError", error.message), retry=False)
            self._logic.received(worker, answer, time.monotonic())
            return
        try:
            self.socket.send_multipart(frames, zmq.NOBLOCK, copy=False)
        except zmq.Again:
            self._logic.lost(worker, "does not take its messages", time.monotonic())
        except zmq.ZMQError as error:
            if error.errno != zmq.EHOSTUNREACH:
                raise
            self._logic.lost(worker, "is not connected any more", time.monotonic())


def _identity(worker: str) -> bytes:
    return worker.encode("latin-1")  # as it was decoded: any byte has a character
