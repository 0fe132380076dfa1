"""A ROUTER and an XPUB that answer as a test tells them: enough of a station for the clients' own tests."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zmq

from fringed import wire
from fringed.errors import FringedError
from fringed.messages import DeviceState, ErrorInfo, Reply, Request, ScanState, StationState

SILENT = object()


def state(uptime_s: float = 1.0) -> StationState:
    device = DeviceState("IDLE", "sim")
    return StationState("fake", "0", 1, uptime_s, True, False, "rig", "", device, device)


@dataclass
class FakeStation:
    """Serve `verbs` until stopped; records every request."""

    runtime: Path
    verbs: dict[str, Callable[[Request], Any]] = field(default_factory=dict)
    requests: list[Request] = field(default_factory=list)
    protocol: int = wire.VERSION
    beats: bool = True

    def __post_init__(self) -> None:
        self.runtime.mkdir(parents=True, exist_ok=True)
        self.verbs.setdefault("hello", lambda _: {"protocol": self.protocol, "name": "fake", "simulated": True,
                                                  "stream": "ipc", "version": "0"})  # fmt: skip
        self.verbs.setdefault("status", lambda _: state())
        self._outbox: list[list[Any]] = []
        self._stop = threading.Event()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="fake-station")
        self._thread.start()
        assert self._ready.wait(5)

    def publish(self, content: Any, topic: str, seq: int) -> None:
        self._outbox.append(wire.encode(content, topic, seq))

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(5)

    def names(self) -> list[str]:
        return [request.verb for request in self.requests]

    def _serve(self) -> None:
        context = zmq.Context()
        control, stream = context.socket(zmq.ROUTER), context.socket(zmq.XPUB)
        stream.setsockopt(zmq.XPUB_VERBOSE, 1)
        control.bind(f"ipc://{self.runtime / 'control'}")
        stream.bind(f"ipc://{self.runtime / 'stream'}")
        self._ready.set()
        beat = 0.0
        while not self._stop.is_set():
            if control.poll(5):
                self._answer(control, control.recv_multipart())
            if self.beats and time.monotonic() - beat > 0.2:
                beat = time.monotonic()
                stream.send_multipart(wire.encode(state(), "state", int(beat * 1000)))
            while self._outbox:
                stream.send_multipart(self._outbox.pop(0))
        context.destroy(linger=0)

    def _answer(self, control: Any, parts: list[bytes]) -> None:
        request = wire.decode(parts[1:]).content
        self.requests.append(request)
        error, result = None, None
        try:
            result = self.verbs[request.verb](request)
        except FringedError as raised:
            error = ErrorInfo(type(raised).__name__, str(raised), ("a detail",))
        if result is not SILENT:
            control.send_multipart([parts[0], *wire.encode(Reply(request.id, result, error))])


def scan_state(name: str, progress: float = 0.0, **more: Any) -> ScanState:
    return ScanState("20260102T030405.678901Z-1f0c", name, "hierarchical", progress, **more)  # type: ignore[arg-type]
