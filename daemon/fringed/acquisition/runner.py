"""The acquisition thread: the only one that touches the devices.

Owns the queue of requests, reconnecting, retakes and what ends a scan. Everything it has to say goes to
its Listener, in this thread; requests come from any thread.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Literal

from fringed.acquisition.adjusting import SettingsRequest, answered
from fringed.acquisition.calibrating import LatencyCalibration
from fringed.acquisition.latency import LatencyResult
from fringed.acquisition.listener import (
    AcquisitionRequest,
    LatencyRequest,
    Listener,
    OpenSet,
    SetUnderWay,
    small_picture,
)
from fringed.acquisition.port import RigPort
from fringed.acquisition.rig import Rig, Station, culprit
from fringed.acquisition.sampling import full_scale
from fringed.acquisition.sequencer import Timing
from fringed.acquisition.shots import check_channels, checks_of
from fringed.acquisition.taking import Attempt, Taken, Wanted
from fringed.config import AcquisitionConfig, CheckConfig
from fringed.data import Array, CameraSettings
from fringed.errors import AcquisitionError, Cancelled, DeviceError, FringedError, QualityError
from fringed.messages import Event, Preview

log = logging.getLogger(__name__)
TICK_S = 0.1
CHECK_S = 0.4  # what was unplugged is shown within a second


Job = AcquisitionRequest | LatencyRequest | SettingsRequest


class AcquisitionRunner:
    """Take frame sets, one request after the other."""

    def __init__(
        self,
        rig: Rig,
        station: Station,
        listener: Listener,
        open_set: OpenSet,
        acquisition: AcquisitionConfig,
        checks: CheckConfig,
    ) -> None:
        self._rig, self._station, self._listener, self._open_set = rig, station, listener, open_set
        self._config, self._checks = acquisition, checks
        self._port = RigPort(rig, listener.device_state, self._check_cancelled)
        self._jobs: deque[Job] = deque()
        self._cancelled: set[str] = set()
        self._current: Job | None = None
        self._changed = threading.Condition()
        self._stopping = False
        self._next_attempt_s = self._next_check_s = 0.0
        self._next_preview_s = 0.0
        self._latency: LatencyResult | None = None
        self._thread = threading.Thread(target=self._run, name="acquisition", daemon=True)

    # What other threads may call.

    def start(self) -> None:
        """Start the thread; the devices are opened in it."""
        self._thread.start()

    def submit(self, request: AcquisitionRequest) -> None:
        """Queue a scan; its end is told to the listener."""
        self._queue(request)

    def calibrate_latency(self, scan: str, settings: CameraSettings) -> None:
        """Queue a measurement of the delay from flip to light; told as the event latency.measured."""
        self._queue(LatencyRequest(scan, settings))

    def settings(self, request: SettingsRequest) -> None:
        """Queue a question to a device; it is answered between two scans."""
        self._queue(request)

    def cancel(self, scan: str) -> None:
        """Stop a scan that is queued or running; harmless for any other."""
        with self._changed:
            if any(job.scan == scan for job in (*self._jobs, self._current) if job is not None):
                self._cancelled.add(scan)
            self._changed.notify_all()

    def reconfigure(self, acquisition: AcquisitionConfig, checks: CheckConfig, station: Station | None = None) -> None:
        """Use these from the next set on."""
        with self._changed:
            self._config, self._checks = acquisition, checks
            self._station = station or self._station

    def stop(self, timeout_s: float = 5.0) -> bool:
        """Give up what is running, close the devices, end the thread; return whether it ended in time."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    @property
    def latency(self) -> LatencyResult | None:
        """The delay that was measured last."""
        return self._latency

    # The thread.

    def _queue(self, job: Job) -> None:
        with self._changed:
            if self._stopping:
                raise AcquisitionError("the station is stopping; no more sets are taken")
            self._jobs.append(job)
            self._changed.notify_all()

    def _run(self) -> None:
        try:
            while (job := self._next_job()) is not None:
                self._do(job)
            self._refuse_all(Cancelled("the station is stopping"))
            self._port.close()
        except Exception as error:
            log.exception("the acquisition thread ended")
            self._refuse_all(AcquisitionError(f"the acquisition ended by a mistake ({error!r}); restart the station"))

    def _refuse_all(self, error: FringedError) -> None:
        """Fail what is under way or waits, and take nothing any more."""
        with self._changed:
            self._stopping = True
            jobs = [job for job in (self._current, *self._jobs) if job is not None]
            self._current = None
            self._jobs.clear()
        for job in jobs:
            if isinstance(job, SettingsRequest):
                job.failed(error)
            else:
                self._tell_failed(job.scan, error)

    def _next_job(self) -> Job | None:
        """Wait for work, opening devices meanwhile; None when it is time to stop."""
        while True:
            with self._changed:
                self._current = None
                if not self._jobs and not self._stopping:
                    self._changed.wait(TICK_S)
                if self._stopping:
                    return None
                if self._jobs:
                    self._current = self._jobs.popleft()
                    return self._current
            self._reconnect_when_due()

    def _reconnect_when_due(self) -> None:
        if time.monotonic() >= self._next_check_s:
            self._next_check_s = time.monotonic() + CHECK_S
            self._port.check()
        if self._port.is_open or time.monotonic() < self._next_attempt_s:
            return
        try:
            self._port.connect()
        except DeviceError as error:
            log.debug("not connected: %s", error)
        self._next_attempt_s = time.monotonic() + self._config.reconnect_s

    def _do(self, job: Job) -> None:
        if isinstance(job, SettingsRequest):
            self._ask(job)
            return
        doubt = ""
        try:
            if isinstance(job, LatencyRequest):
                self._retried(job.scan, "latency", lambda _: self._measure_latency(job.settings))
            else:
                self._acquire(job)
            self._port.rest()
            self._listener.finished(job.scan)
        except FringedError as error:
            doubt = error.message if isinstance(error, QualityError) else ""
            self._port.rest(doubt)
            self._tell_failed(job.scan, error)
        except Exception as error:
            log.exception("the acquisition of %s failed", job.scan)
            self._port.rest()
            self._tell_failed(job.scan, AcquisitionError(f"the acquisition failed: {type(error).__name__}: {error}"))

    def _ask(self, request: SettingsRequest) -> None:
        try:
            found = answered(self._port, request)
        except FringedError as error:
            if isinstance(error, DeviceError) and culprit(error) is not None:
                self._port.failed(error)
            request.failed(error)
        else:
            request.done(found)

    def _tell_failed(self, scan: str, error: FringedError) -> None:
        with self._changed:
            self._cancelled.discard(scan)
        self._listener.failed(scan, error)

    def _check_cancelled(self) -> None:
        if self._stopping:
            raise Cancelled("the station is stopping")
        if self._current is not None and self._current.scan in self._cancelled:
            raise Cancelled("cancelled on request")

    def _acquire(self, request: AcquisitionRequest) -> None:
        for role in request.roles if not self._rig.replayed else ():  # a replay has the settings of its recordings
            check_channels(request.sequence, request.settings_of(role))
        for index, role in enumerate(request.roles):
            taken = self._retried(request.scan, role, lambda n, i=index: self._take(request, i, n))
            self._listener.set_taken(taken.frame_set, taken.delivered_monotonic_s, taken.sink)
            if request.truth and self._rig.truth_provider is not None:
                truth = self._rig.truth_provider(role)
                if truth is not None:
                    self._listener.truth(replace(truth, frame_set=taken.frame_set.id))

    def _retried(self, scan: str, what: str, attempt: Any) -> Any:
        """Call `attempt(n)` until it succeeds, at most `retries` times again; tell of each retake and why."""
        retries = self._config.retries
        for number in range(retries + 1):
            self._check_cancelled()
            try:
                self._port.connect()
                return attempt(number)
            except (AcquisitionError, DeviceError) as error:
                if isinstance(error, DeviceError):
                    self._port.failed(error)
                if number == retries:
                    raise _given_up(error, what, number) from error
                self._tell(
                    "set.retaken",
                    f"the {what} set is taken again ({number + 1} of {retries}): {error.message}",
                    {"scan": scan, "role": what, "retake": number + 1, "reason": error.message},
                )
                if not self._port.is_open:
                    self._pause(self._config.reconnect_s)
        raise AcquisitionError(f"{retries} retries allow no attempt")

    def _take(self, request: AcquisitionRequest, index: int, retakes: int) -> Taken:
        role = request.roles[index]
        asked = request.settings_of(role)
        latency_s, settle_s = self._delay(asked)
        self._port.load(request.sequence, role)
        settings = self._port.arm(asked)
        check_channels(request.sequence, settings)
        self._port.idle()  # a pattern that is late then shows darkness, never one of the same group
        self._port.acquiring()
        timing = Timing(
            latency_s,
            settle_s,
            settings.exposure_us * 1e-6,
            self._rig.camera.period_s,
            self._config.frame_timeout_s,
            triggered=settings.trigger != "free-running",
        )
        wanted = Wanted(request.scan, role, request.sequence, settings, timing, retakes)

        def on_frame(number: int, image: Array) -> None:
            self._listener.frame(under_way, number, image)
            self._frame_kept(request, index, number, image, settings)

        checks = checks_of(role, {other: request.settings_of(other) for other in request.roles}, self._checks)
        attempt = Attempt(self._port, wanted, checks, self._open_set, on_frame)
        under_way = SetUnderWay(attempt.id, request.scan, role, request.sequence, settings)
        try:
            taken = attempt.take(self._station)
        finally:
            if attempt.discarded:
                self._listener.discarded(attempt.discarded)
        self._port.camera.go("ARMED")
        return taken

    def _frame_kept(
        self, request: AcquisitionRequest, index: int, number: int, image: Array, settings: CameraSettings
    ) -> None:
        count = len(request.sequence.frames)
        role = request.roles[index]
        done = (index + (number + 1) / count) / len(request.roles)
        self._listener.progress(request.scan, done, f"{role}: frame {number + 1} of {count}")
        now = time.monotonic()
        if self._config.preview_hz > 0 and now >= self._next_preview_s:
            self._next_preview_s = now + 1.0 / self._config.preview_hz
            picture = small_picture(image, full_scale(settings, image.dtype))
            self._listener.preview(Preview(picture, role, number, count, request.scan))

    def _delay(self, settings: CameraSettings) -> tuple[float, float]:
        """Return latency and settling: configured, replayed (none), or measured, now if need be."""
        if self._rig.replayed:
            return 0.0, 0.0
        if self._config.latency_s is not None:
            return self._config.latency_s, self._config.settle_s
        measured = self._latency or self._measure_latency(settings)
        return measured.latency_s + measured.uncertainty_s, max(self._config.settle_s, measured.settle_s)

    def _measure_latency(self, settings: CameraSettings) -> LatencyResult:
        self._latency = result = LatencyCalibration(self._port, settings, self._config.frame_timeout_s).run()
        self._tell(
            "latency.measured",
            f"from flip to light {result.latency_s * 1e3:.1f} ms (within {result.uncertainty_s * 1e3:.1f} ms), "
            f"settled {result.settle_s * 1e3:.1f} ms later",
            {
                "latency_s": result.latency_s,
                "uncertainty_s": result.uncertainty_s,
                "settle_s": result.settle_s,
                "samples": result.samples,
            },
            level="info",
        )
        return result

    def _pause(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self._check_cancelled()
            with self._changed:
                self._changed.wait(min(left, TICK_S))

    def _tell(
        self, name: str, text: str, detail: dict[str, Any], level: Literal["info", "warning"] = "warning"
    ) -> None:
        created = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._listener.event(Event(name, created, level, text, detail))


def _given_up(error: FringedError, what: str, retries: int) -> FringedError:
    """Return the same kind of error, saying how often it was tried."""
    if retries == 0:
        return error
    return type(error)(f"the {what} set failed {retries + 1} times; the last time: {error.message}")
