"""Take one frame set: drive the devices as the sequencer says, write and check each frame as it comes.

Owns one attempt at one set. Whether to try again is the runner's decision.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from fringed.acquisition.actions import (
    Action,
    Discard,
    Event,
    Failed,
    Finished,
    Flipped,
    FrameArrived,
    Keep,
    Reached,
    ReadFrame,
    Show,
    TimedOut,
    Trigger,
    Triggered,
    WaitUntil,
)
from fringed.acquisition.checks import SetCheck
from fringed.acquisition.listener import OpenSet, SetSink
from fringed.acquisition.port import RigPort
from fringed.acquisition.rig import Station, blame
from fringed.acquisition.sequencer import Sequencer, Timing
from fringed.acquisition.shots import channel_of
from fringed.config import CheckConfig
from fringed.data import Array, CameraSettings, FrameSet, FrameStamp, PatternSequence, Provenance, new_id
from fringed.errors import AcquisitionError, DeviceError, DeviceStalled, ProtocolError, QualityError
from fringed.hookspecs import RawFrame


@dataclass(frozen=True)
class Wanted:
    """What one attempt is to take."""

    scan: str
    role: str
    sequence: PatternSequence
    settings: CameraSettings
    timing: Timing
    retakes: int = 0


@dataclass(frozen=True)
class Taken:
    """A set that passed its check, and its sink, not committed."""

    frame_set: FrameSet
    sink: SetSink
    delivered_monotonic_s: float


class Attempt:
    """One attempt at one set; `on_frame(index, image)` hears of each frame that is kept.

    `id` is what the set is called if it is good. `discarded` counts the frames that came and were of no use.
    """

    def __init__(
        self,
        port: RigPort,
        wanted: Wanted,
        checks: CheckConfig,
        open_set: OpenSet,
        on_frame: Callable[[int, Array], None],
    ) -> None:
        self._port, self._wanted, self._open_set, self._on_frame = port, wanted, open_set, on_frame
        self._exposures = wanted.sequence.exposures()
        self._check = SetCheck(wanted.sequence, wanted.settings, checks)
        self._sequencer = Sequencer(len(self._exposures), wanted.timing)
        self.discarded = 0
        self.id = new_id()
        self._stamps: list[FrameStamp] = []
        self._frames: Array | None = None
        self._sink: SetSink | None = None
        self._last: RawFrame | None = None
        self._delivered_s = 0.0

    def take(self, station: Station) -> Taken:
        """Take the set; whatever goes wrong, nothing of it stays behind.

        Raises
        ------
        QualityError
            the set did not pass its check.
        AcquisitionError
            its times cannot be right.
        DeviceError, StorageError, Cancelled
            as the devices, the sink and the caller say.
        """
        try:
            self._drive()
            frame_set = self._judged(station)
        except BaseException:
            if self._sink is not None:
                self._sink.abort()
            raise
        if self._sink is None:
            raise AcquisitionError("a set ended without a single frame")
        return Taken(frame_set, self._sink, self._delivered_s)

    def _drive(self) -> None:
        actions = self._sequencer.start()
        while not self._sequencer.done:
            *before, action = actions
            self.discarded += sum(isinstance(a, Discard) for a in before)
            keep = next((a for a in before if isinstance(a, Keep)), None)
            kept = self._last
            if keep is not None and not isinstance(action, Show):
                self._keep(keep, kept)
            event = self._perform(action)
            if keep is not None and isinstance(action, Show):  # the next pattern need not wait for the disk
                self._keep(keep, kept)
            actions = self._sequencer.handle(event)
        self._end(actions)

    def _end(self, actions: tuple[Action, ...]) -> None:
        for action in actions:
            self.discarded += isinstance(action, Discard)
            if isinstance(action, Keep):
                self._keep(action, self._last)
            elif isinstance(action, Failed):
                raise self._error(action)

    def _error(self, failed: Failed) -> AcquisitionError | DeviceError:
        if failed.fault == "times":
            return AcquisitionError(failed.reason)
        error = DeviceStalled(failed.reason) if failed.fault == "stalled" else DeviceError(failed.reason)
        blame(error, self._port.camera)
        return error

    def _perform(self, action: Action) -> Event:
        match action:
            case Show(index):
                return Flipped(self._port.show(self._exposures[index][0]))
            case WaitUntil(time_s):
                return Reached(self._port.wait_until(time_s))
            case Trigger():
                return Triggered(self._port.trigger())
            case ReadFrame(timeout_s):
                return self._read(timeout_s)
            case Keep() | Discard() | Finished() | Failed():
                raise AcquisitionError(f"{type(action).__name__} wants no answer")

    def _read(self, timeout_s: float) -> Event:
        try:
            frame = self._port.read(timeout_s)
        except DeviceStalled:
            return TimedOut(timeout_s)
        self._delivered_s = time.monotonic()
        self._last = frame
        return FrameArrived(frame.counter, frame.exposure_start_s, frame.exposure_end_s, self._port.now())

    def _keep(self, keep: Keep, frame: RawFrame | None) -> None:
        if frame is None:
            raise AcquisitionError("a frame was kept before one arrived")
        indices, sequence = self._exposures[keep.index], self._wanted.sequence
        for index in indices:
            whole = frame.image.ndim == 2
            image = frame.image if whole else channel_of(frame.image, sequence.frames[index].channel)
            self._stamps.append(FrameStamp(keep.flip_s, frame.exposure_start_s, frame.exposure_end_s, frame.counter))
            self._keep_image(index, image)

    def _keep_image(self, index: int, image: Array) -> None:
        if self._frames is None:
            shape = (len(self._wanted.sequence.frames), *image.shape)
            self._frames = np.empty(shape, image.dtype)
            self._sink = self._open_set(self.id, self._wanted.sequence, shape, image.dtype)
        if image.dtype != self._frames.dtype or self._sink is None:
            raise ProtocolError(f"a frame of {image.dtype} came in a set of {self._frames.dtype}")
        kept = self._frames[index]
        kept[...] = image
        self._on_frame(index, kept)  # first: others can work on it meanwhile
        self._sink.write(index, kept)
        self._check.add(index, kept)

    def _judged(self, station: Station) -> FrameSet:
        wanted, rig = self._wanted, self._port.rig
        stamps = tuple(self._stamps)
        skipped = {self._exposures[i][0]: count for i, count in self._sequencer.counters_skipped.items()}
        report = self._check.finish(stamps, skipped, wanted.timing.delay_s)
        if not report.passed:
            raise QualityError("; ".join(f"{finding.fault}: {finding.detail}" for finding in report.findings))
        if self._frames is None:
            raise AcquisitionError("a set ended without a single frame")
        provenance = Provenance(
            plugin=rig.camera_driver,
            calibration=station.calibration,
            rig=station.rig,
            software=station.software,
            created=datetime.now(UTC).isoformat(timespec="milliseconds"),
            simulated=rig.simulated,
            replayed=rig.replayed,
        )
        return FrameSet(
            self._frames,
            wanted.sequence,
            role=wanted.role,
            id=self.id,
            scan=wanted.scan,
            stamps=stamps,
            settings=wanted.settings,
            check=report,
            retakes=wanted.retakes,
            provenance=provenance,
        )
