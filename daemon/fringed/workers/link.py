"""The worker's end of the work socket: its own thread, so that a busy worker still gives signs of life.

Owns the DEALER socket, heartbeat, cancellation flags and the queue of work; knows nothing of plug-ins. The main
thread takes work with `next_work` and hands over encoded messages with `send`; arrays are not copied. Of a set that
is fed, at most its frames wait here; those of a set that is dropped are forgotten at once.
"""

from __future__ import annotations

import logging
import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import zmq

from fringed import wire
from fringed.errors import WireError
from fringed.messages import (
    ErrorInfo,
    FeedBegin,
    FeedDrop,
    FeedFrame,
    FeedLost,
    Job,
    JobCancel,
    JobFailed,
    StageTaken,
    WorkerAlive,
    WorkerStop,
)

HEARTBEAT_S = 1.0
SILENCE_S = 15.0

FeedMessage = FeedBegin | FeedFrame | FeedDrop

_log = logging.getLogger(__name__)


class Link:
    """Talk to the station. `on_gone(reason)` is called in the link's thread when nobody is there any more."""

    def __init__(
        self, socket: zmq.Socket[bytes], name: str, on_gone: Callable[[str], None], silence_s: float = SILENCE_S
    ) -> None:
        self.name = name
        self._silence_s = silence_s
        self._socket = socket
        self._on_gone = on_gone
        self._work: queue.SimpleQueue[Job | FeedBegin | FeedDrop | str | None] = queue.SimpleQueue()
        self._frames: dict[str, deque[FeedFrame]] = {}  # of each feed; its id is queued once for each
        self._idle = False
        self._outbox: deque[list[Any]] = deque()
        self._cancelled: set[str] = set()
        self._current = ""
        self._taken = threading.Event()
        self._stopping = threading.Event()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._serve, name="link", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def send(self, message: Any) -> None:
        """Encode a message and send it soon; any thread may call this."""
        self._outbox.append(wire.encode(message))
        os.eventfd_write(self._wake, 1)

    def next_work(self, timeout_s: float | None = None) -> Job | FeedMessage | None:
        """Wait for a job or something of a feed; None when the time is over or the station said stop.

        Feeds begin only while this waits without a time: whoever warms up or works would fall behind.
        """
        self._current = ""
        self._idle = timeout_s is None
        try:
            work = self._get(timeout_s)
        except queue.Empty:
            return None
        if isinstance(work, Job):
            self._idle = False
            self._taken.clear()
            self._current = work.id
        return work

    def _get(self, timeout_s: float | None) -> Job | FeedMessage | None:
        while isinstance(work := self._work.get(timeout=timeout_s), str):
            frames = self._frames.get(work)
            if frames:
                return frames.popleft()
        return work

    def wait_taken(self, timeout_s: float) -> None:
        """Wait until a product of the current job is recorded and announced, or the time is over."""
        self._taken.wait(timeout_s)

    @property
    def stopping(self) -> bool:
        """Whether the station sent this worker home."""
        return self._stopping.is_set()

    def cancelled(self, job: str) -> bool:
        """Tell whether somebody asked to stop that job."""
        return job in self._cancelled or self.stopping

    def close(self) -> None:
        """Send what is left and end the thread."""
        self._stopping.set()
        os.eventfd_write(self._wake, 1)
        self._thread.join(timeout=5.0)
        os.close(self._wake)

    def _serve(self) -> None:
        try:
            self._loop()
        except Exception as error:  # noqa: BLE001  a thread's top: without its link a worker is of no use
            _log.exception("the link to the station failed")
            self._on_gone(f"its link failed: {error}")
        finally:
            self._socket.close(linger=2000)

    def _loop(self) -> None:
        poller = zmq.Poller()
        poller.register(self._socket, zmq.POLLIN)
        poller.register(self._wake, zmq.POLLIN)
        heard_s = next_beat_s = float("inf")  # signs of life begin with READY, the first message
        while not self._stopping.is_set() or self._outbox:
            if self._outbox and heard_s == float("inf"):
                heard_s = next_beat_s = time.monotonic()
            while self._outbox:
                self._socket.send_multipart(self._outbox.popleft(), copy=False)
            if time.monotonic() >= next_beat_s:
                self._socket.send_multipart(wire.encode(WorkerAlive(self.name, self._current)))
                next_beat_s = time.monotonic() + HEARTBEAT_S
            wait_s = min(max(0.0, next_beat_s - time.monotonic()), HEARTBEAT_S)
            ready = dict(poller.poll(round(wait_s * 1000)))
            if self._wake in ready:
                os.eventfd_read(self._wake)
            if self._socket in ready:
                heard_s = time.monotonic()
                self._receive()
            elif time.monotonic() - heard_s > self._silence_s:
                self._on_gone(f"the station was silent for {self._silence_s:g} s")
                return

    def _receive(self) -> None:
        frames = self._socket.recv_multipart(copy=False)
        try:
            message = wire.decode([frame.buffer for frame in frames]).content
        except WireError as error:
            _log.error("a message of the station cannot be read: %s", error)
            self._refuse(frames, error)
            return
        if isinstance(message, Job):
            if message.attempt > 1:  # wanted again: what stopped an earlier attempt is over
                self._cancelled.discard(message.id)
            self._work.put(message)
            self._frames = {feed: frames for feed, frames in self._frames.items() if frames}
        elif isinstance(message, (FeedBegin, FeedFrame, FeedDrop)):
            self._feed(message)
        elif isinstance(message, JobCancel):
            self._cancelled.add(message.job)
            self._taken.set()
        elif isinstance(message, StageTaken):
            if message.job == self._current:
                self._taken.set()
        elif isinstance(message, WorkerStop):
            _log.info("sent home: %s", message.reason)
            self._stopping.set()
            self._taken.set()
            self._work.put(None)
        elif isinstance(message, ErrorInfo):
            _log.error("the station answered: %s: %s", message.code, message.message)

    def _feed(self, message: FeedMessage) -> None:
        if isinstance(message, FeedFrame):
            if message.feed in self._frames:
                self._frames[message.feed].append(message)
                self._work.put(message.feed)
        elif isinstance(message, FeedDrop):
            self._frames.pop(message.feed, None)
            self._work.put(message)
        elif self._idle:
            self._frames[message.feed] = deque()
            self._work.put(message)
        else:
            self._outbox.append(wire.encode(FeedLost(message.feed, "its worker is busy")))

    def _refuse(self, frames: list[Any], error: WireError) -> None:
        """Answer a job that was damaged on its way, as far as it can be told which one it was."""
        try:
            _, header = wire.peek([frame.buffer for frame in frames])
        except WireError:
            return
        if header.kind == "Job" and isinstance(header.body.get("id"), str):
            info = ErrorInfo(type(error).__name__, error.message)
            self._outbox.append(wire.encode(JobFailed(header.body["id"], "", info, retry=True)))
