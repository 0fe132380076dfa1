"""Between the acquisition thread and the reactor: requests go there, what it tells comes back as posted calls.

Owns that hand-over. Every method of the listener returns at once, in the acquisition thread; the work is done in
the reactor's.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol

from fringed import wire
from fringed.config import CameraConfig
from fringed.data import Array, CameraSettings, FrameSet, PatternSequence, Truth
from fringed.errors import DeviceAbsent, FringedError
from fringed.messages import DeviceState, Event, Preview
from fringed.serving.cameras import camera_settings
from fringed.serving.house import House
from fringed.serving.ports import AcquiredSet, SetUnderWay
from fringed.serving.scans import Scans
from fringed.serving.status import Status

_log = logging.getLogger(__name__)
_LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
NO_RIG = (
    "this station has no rig: camera.driver or projector.driver is 'none'; configure both (see `fringed show "
    "--reference`), or run `fringed run` without a configuration for the simulated rig"
)


class Runner(Protocol):
    """What this needs of the acquisition's runner."""

    def submit(self, request: Any, /) -> None:
        """Queue a scan's sets."""

    def cancel(self, scan: str, /) -> Any:
        """Stop a scan."""

    def calibrate_latency(self, scan: str, settings: CameraSettings, /) -> None:
        """Queue a measurement."""

    def settings(self, request: Any, /) -> None:
        """Queue a question to a device."""


class RigLink:
    """The rig's end in serving; `runner` is set once it is built."""

    def __init__(
        self,
        make_request: Callable[..., Any],
        size_px: Callable[[], tuple[int, int]],
        camera: Callable[[], CameraConfig],
    ) -> None:
        self.runner: Runner | None = None
        self._make_request = make_request
        self._size_px = size_px
        self._camera = camera

    def take(
        self,
        scan: str,
        roles: tuple[str, ...],
        sequence: PatternSequence,
        settings: Mapping[str, CameraSettings],
        truth: bool,
    ) -> None:
        """Queue the sets of one scan; raises DeviceAbsent where there is no rig."""
        self._there().submit(
            self._make_request(scan=scan, sequence=sequence, roles=roles, by_role=settings, truth=truth)
        )

    def cancel(self, scan: str) -> None:
        """Stop taking sets of a scan."""
        if self.runner is not None:
            self.runner.cancel(scan)

    def calibrate_latency(self, scan: str) -> None:
        """Queue a measurement; raises DeviceAbsent where there is no rig."""
        self._there().calibrate_latency(scan, camera_settings(self._camera(), {}))

    def settings(self, request: Any) -> None:
        """Queue a question to a device; raises DeviceAbsent where there is no rig."""
        self._there().settings(request)

    def size_px(self) -> tuple[int, int]:
        """Return the projector's size; raises DeviceAbsent where there is no rig."""
        size_px = self._size_px()
        if 0 in size_px:
            raise DeviceAbsent(NO_RIG)
        return size_px

    def _there(self) -> Runner:
        if self.runner is None or 0 in self._size_px():
            raise DeviceAbsent(NO_RIG)
        return self.runner


class RigListener:
    """What the acquisition thread calls."""

    def __init__(self, house: House, scans: Scans, status: Status) -> None:
        self._house = house
        self._scans = scans
        self._status = status

    def device_state(self, which: str, state: DeviceState) -> None:
        """Hear how "camera" or "projector" is now."""
        self._post(self._status.device_changed, which, state)

    def progress(self, scan: str, fraction: float, text: str) -> None:
        """Hear how far a scan's acquisition is, 0 to 1."""
        self._post(self._scans.acquiring, scan, fraction, text)

    def preview(self, preview: Preview) -> None:
        """See a small picture."""
        self._post(self._house.stream.publish, preview, wire.TOPIC_PREVIEW)

    def frame(self, of: SetUnderWay, index: int, image: Array) -> None:
        """See a frame of a set that is being taken."""
        self._post(self._scans.frame_kept, of, index, image)

    def set_taken(self, frame_set: FrameSet, last_frame_delivered_monotonic_s: float, sink: Any) -> None:
        """Take over a checked set with its sink (a `SetWriter`)."""
        acquired = AcquiredSet(
            frame_set,
            partial(sink.commit, frame_set),
            partial(self._discard, sink),
            last_frame_delivered_monotonic_s,
            time.monotonic(),
        )
        self._post(self._scans.set_acquired, acquired)

    def discarded(self, count: int) -> None:
        """Count frames that came and were of no use."""
        self._post(self._scans.frames_discarded, count)

    def truth(self, truth: Truth) -> None:
        """Take what the simulated rig knows of a set."""
        self._post(self._scans.truth_known, truth)

    def event(self, event: Event) -> None:
        """Hear what happened."""
        self._post(self._event, event)

    def finished(self, scan: str) -> None:
        """Hear that everything of a scan was taken."""
        self._post(self._scans.acquired_all, scan)

    def failed(self, scan: str, error: FringedError) -> None:
        """Hear that a scan was given up."""
        self._post(self._scans.acquisition_failed, scan, error)

    def _post(self, callback: Callable[..., Any], *arguments: Any) -> None:
        self._house.reactor.post(partial(callback, *arguments))

    def _event(self, event: Event) -> None:
        if event.name == "set.retaken":
            self._scans.set_retaken(str(event.detail.get("scan", "")))
        elif event.name == "latency.measured":
            self._scans.latency_measured(float(event.detail["latency_s"]), event.text)
        _log.log(_LEVELS[event.level], "%s: %s", event.name, event.text)
        self._house.stream.publish(event, wire.TOPIC_EVENT)
        self._scans.told(event)

    def _discard(self, sink: Any) -> None:
        """Drop a set in the recorder's thread: it touches the disk."""
        self._house.in_thread(self._house.recorder, sink.abort, _ignore, _ignore)


def _ignore(_: Any) -> None:
    return
