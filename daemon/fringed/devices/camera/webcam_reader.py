"""The thread that takes a webcam's frames as they come, and keeps the newest few with their times.

Owns the capture while it runs, the frames' counters, and when each was exposed; knows no settings.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import cv2

from fringed.data import Array
from fringed.devices.camera.webcam_capture import Capture
from fringed.errors import DeviceError, ProtocolError
from fringed.hookspecs import Clock, RawFrame

GRAB_PAUSE_S = 0.01  # after a grab that failed at once
JOIN_S = 10.0
BAD_FRAMES_MAX = 10  # in a row; one that cannot be decoded is dropped
STAMP_AGE_MAX_S = 2.0  # an older stamp is of another clock, or of no use
_GAPS = 9

Convert = Callable[[Any], Array]


@dataclass(frozen=True)
class Exposing:
    """When a frame was exposed, told from its stamp: seconds.

    `before_stamp_s` lies between the start of the first row's exposure and the driver's stamp, `before_arrival_s`
    between that start and the frame's arrival. `lasts_s` from the first row's start to the last row's end is None where
    nobody knows; the frame's arrival is then all that is certain to be later.
    """

    before_stamp_s: float
    before_arrival_s: float
    lasts_s: float | None = None
    use_stamps: bool = True

    def window_s(self, stamp_s: float, arrival_s: float) -> tuple[float, float]:
        """Return when the exposure began and ended, or a window around it; a stamp of another clock is not used."""
        if not self.is_stamp(stamp_s, arrival_s):
            return arrival_s - self.before_arrival_s, arrival_s
        start_s = stamp_s - self.before_stamp_s
        return start_s, arrival_s if self.lasts_s is None else start_s + self.lasts_s

    def is_stamp(self, stamp_s: float, arrival_s: float) -> bool:
        """Whether the driver's stamp is one."""
        return self.use_stamps and stamp_s > 0.0 and 0.0 <= arrival_s - stamp_s <= STAMP_AGE_MAX_S


class Counting:
    """Count frames, and those that the stamps show to be missing."""

    def __init__(self, counter: int = -1) -> None:
        self.counter = counter
        self._last_s: float | None = None
        self._gaps: deque[float] = deque(maxlen=_GAPS)

    def next(self, stamp_s: float | None) -> int:
        """Return the counter of a frame with that stamp; None for one without: then it is the next one."""
        steps = 1
        if stamp_s is not None and self._last_s is not None and stamp_s > self._last_s:
            gap_s = stamp_s - self._last_s
            if len(self._gaps) == _GAPS:
                steps = max(1, round(gap_s / median(self._gaps)))
            if steps == 1:
                self._gaps.append(gap_s)
        self._last_s = stamp_s
        self.counter += steps
        return self.counter


class Reader:
    """Read frames until stopped; `skip` are thrown away first: they may be from before it began."""

    def __init__(self, capture: Capture, clock: Clock, exposing: Exposing, convert: Convert, keep: int) -> None:
        self._capture, self._clock = capture, clock
        self._exposing, self._convert = exposing, convert
        self._frames: deque[RawFrame] = deque(maxlen=keep)
        self._news = threading.Condition()
        self._stop = threading.Event()
        self._fault: DeviceError | None = None
        self._thread: threading.Thread | None = None
        self._counting = Counting()
        self._bad = 0
        self.overtaken = 0

    def start(self, skip: int, counter: int) -> None:
        """Begin; the first frame counts as the one after `counter`."""
        self._counting = Counting(counter)
        self._thread = threading.Thread(target=self._run, args=(skip,), name="webcam-reader", daemon=True)
        self._thread.start()

    def stop(self) -> int:
        """End the thread and return the last counter; harmless when it never began."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(JOIN_S)
            if self._thread.is_alive():
                raise DeviceError(f"the webcam's driver does not come back within {JOIN_S:g} s: unplug the camera")
            self._thread = None
        return self._counting.counter

    def take(self, timeout_s: float) -> RawFrame | None:
        """Return the oldest frame that is kept, None where none comes in time; raises what the thread met."""
        with self._news:
            self._news.wait_for(lambda: bool(self._frames) or self._fault is not None, timeout_s)
            if self._frames:
                return self._frames.popleft()
            if self._fault is not None:
                raise self._fault
            return None

    def _run(self, skip: int) -> None:
        try:
            while not self._stop.is_set():
                if not self._capture.grab():
                    self._stop.wait(GRAB_PAUSE_S)
                    continue
                arrival_s = self._clock.now()
                stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
                if skip > 0:
                    skip -= 1
                    continue
                self._take(stamp_s, arrival_s)
        except DeviceError as error:
            self._give_up(error)
        except Exception as error:  # noqa: BLE001 (the thread's top: whoever reads is told)
            self._give_up(DeviceError(f"reading the webcam failed: {error!r}; open it again"))

    def _take(self, stamp_s: float, arrival_s: float) -> None:
        is_stamp = self._exposing.is_stamp(stamp_s, arrival_s)
        counter = self._counting.next(stamp_s if is_stamp else None)
        good, picture = self._capture.retrieve()
        if not good or picture is None:
            self._bad += 1
            if self._bad >= BAD_FRAMES_MAX:
                raise ProtocolError(
                    f"{self._bad} frames in a row could not be decoded: check the cable, or try another fourcc"
                )
            return
        self._bad = 0
        frame = RawFrame(self._convert(picture), counter, *self._exposing.window_s(stamp_s, arrival_s))
        with self._news:
            self.overtaken += len(self._frames) == self._frames.maxlen
            self._frames.append(frame)
            self._news.notify_all()

    def _give_up(self, error: DeviceError) -> None:
        with self._news:
            self._fault = error
            self._news.notify_all()
