"""The worker's end of the work socket: its own thread, so that a busy worker still gives signs of life.

Owns the DEALER socket, heartbeat, cancellation flags and the queue of jobs; knows nothing of plug-ins. The main
thread takes jobs with `next_job` and hands over encoded messages with `send`; arrays are not copied.
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
from fringed.messages import ErrorInfo, Job, JobCancel, JobFailed, StageTaken, WorkerAlive, WorkerStop

HEARTBEAT_S = 1.0
SILENCE_S = 15.0

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
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
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

    def next_job(self, timeout_s: float | None = None) -> Job | None:
        """Wait for a job; None when the time is over or the station said stop."""
        self._current = ""
        try:
            job = self._jobs.get(timeout=timeout_s)
        except queue.Empty:
            return None
        self._taken.clear()
        self._current = job.id if job else ""
        return job

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
            self._jobs.put(message)
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
            self._jobs.put(None)
        elif isinstance(message, ErrorInfo):
            _log.error("the station answered: %s: %s", message.code, message.message)

    def _refuse(self, frames: list[Any], error: WireError) -> None:
        """Answer a job that was damaged on its way, as far as it can be told which one it was."""
        try:
            _, header = wire.peek([frame.buffer for frame in frames])
        except WireError:
            return
        if header.kind == "Job" and isinstance(header.body.get("id"), str):
            info = ErrorInfo(type(error).__name__, error.message)
            self._outbox.append(wire.encode(JobFailed(header.body["id"], "", info, retry=True)))
