"""A camera and its projector made of recordings: what was captured once is delivered again, as replayed.

Owns which recorded frame stands for which pattern, and the pace. The recordings are handed in; this file
knows neither the store nor files. A replay answers only the sequences that were recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import median

import numpy as np

from fringed.data import Array, CameraSettings, FrameSet, PatternSequence
from fringed.errors import DeviceError, DeviceStalled, UsageError
from fringed.hookspecs import Clock, RawFrame

BACKLOG = 2  # frames that the camera keeps for a reader that is late
SHORTEST_PERIOD_S = 1e-3
_CHANNELS = ("red", "green", "blue")


class SkippingClock:
    """A clock on which waiting costs nothing: time passes by itself, and by each sleep at once."""

    def __init__(self, base: Clock) -> None:
        self._base = base
        self._skipped_s = 0.0

    def now(self) -> float:
        """Seconds; never goes back."""
        return self._base.now() + self._skipped_s

    def sleep(self, seconds: float) -> None:
        """Let that much time have passed."""
        self._skipped_s += max(0.0, seconds)


class ReplayCamera:
    """Deliver recorded frames at the recorded pace, or at once where `real_time` is off.

    It runs free like the real one: a frame shows the pattern whose flip came last before its integration
    began, so acquisition and its checks work as ever. Nothing has to settle: use a latency of 0.
    """

    replayed = True

    def __init__(self, frame_sets: Sequence[FrameSet], clock: Clock, real_time: bool = True) -> None:
        sizes = {frame_set.frames.shape[1:] for frame_set in frame_sets}
        if len(sizes) != 1:
            raise UsageError(
                f"a replay needs frame sets of one size; {len(frame_sets)} were given, of sizes {sorted(sizes)}: "
                "name recordings of one camera"
            )
        self.clock: Clock = clock if real_time else SkippingClock(clock)
        self.simulated = any(frame_set.provenance.simulated for frame_set in frame_sets)
        self._sets = tuple(frame_sets)
        self._next = dict.fromkeys((frame_set.role for frame_set in frame_sets), 0)
        self._current = self._sets[0]
        self._flips: list[tuple[float, int]] = []
        self._armed_s: float | None = None
        self._trigger: str = "free-running"
        self._triggered_s: float | None = None
        self._counter = -1
        self._period_s = max(_recorded_period_s(frame_set) for frame_set in frame_sets)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its frames."""
        height, width = self._current.frames.shape[1:]
        return width, height

    @property
    def projector_size_px(self) -> tuple[int, int]:
        """Width and height of the projector's panel, as recorded."""
        return self._current.sequence.width_px, self._current.sequence.height_px

    @property
    def period_s(self) -> float:
        """Time from frame to frame, as recorded."""
        return self._period_s

    def open(self) -> str:
        """Return what is replayed."""
        return f"replay of {', '.join(frame_set.id or 'an unnamed set' for frame_set in self._sets)}"

    def close(self) -> None:
        """Release everything; harmless when closed."""
        self.disarm()

    def arm(self, settings: CameraSettings) -> CameraSettings:
        """Start; the settings in force are those of the recording, whatever is asked for."""
        self._armed_s, self._counter, self._triggered_s = self.clock.now(), -1, None
        self._trigger = settings.trigger
        recorded = self._current.settings
        shots = any(frame.shot >= 0 for frame in self._current.sequence.frames)
        return replace(recorded, trigger=settings.trigger, channel="rgb" if shots else recorded.channel)

    def disarm(self) -> None:
        """Stop; harmless when not armed."""
        self._armed_s = None

    def trigger(self) -> None:
        """Start one integration."""
        self._check_armed()
        self._triggered_s = self.clock.now()

    def read(self, timeout_s: float) -> RawFrame:
        """Return the next frame.

        Raises
        ------
        DeviceError
            not armed.
        DeviceStalled
            none was due within `timeout_s`.
        """
        armed_s = self._check_armed()
        start_s, counter = self._due(armed_s)
        delivered_s = start_s + self._period_s
        wait_s = delivered_s - self.clock.now()
        if wait_s > timeout_s:
            self.clock.sleep(timeout_s)
            raise DeviceStalled(
                f"no frame within {timeout_s:g} s: the replay's next one is due in {wait_s:.3g} s"
                if np.isfinite(wait_s)
                else f"no frame within {timeout_s:g} s: the replay waits for a trigger"
            )
        self.clock.sleep(max(0.0, wait_s))
        self._counter, self._triggered_s = counter, None
        index = max((flip for flip in self._flips if flip[0] <= start_s), default=(0.0, -1))[1]
        return RawFrame(self._image(index), counter, start_s, start_s + _exposure_s(self._current))

    def _image(self, index: int) -> Array:
        """Return what was recorded under pattern `index`, black for a negative one; all channels of a shot."""
        frames, described = self._current.frames, self._current.sequence.frames
        shot = described[max(index, 0)].shot
        if shot < 0:
            return frames[index] if index >= 0 else np.zeros(frames.shape[1:], frames.dtype)
        image = np.zeros((*frames.shape[1:], len(_CHANNELS)), frames.dtype)
        for place, frame in enumerate(described):
            if index >= 0 and frame.shot == shot:
                image[:, :, _CHANNELS.index(frame.channel)] = frames[place]
        return image

    def cue(self, sequence: PatternSequence, role: str) -> None:
        """Take the next recording of `role` that was made with `sequence`.

        Raises
        ------
        UsageError
            no recording has that role, or all differ; the message says in what.
        """
        of_role = [frame_set for frame_set in self._sets if frame_set.role == role]
        if not of_role:
            raise UsageError(f"nothing of role {role!r} is replayed; there are {', '.join(sorted(self._next))}")
        turn = self._next[role]
        for step in range(len(of_role)):
            candidate = of_role[(turn + step) % len(of_role)]
            if not differences(candidate.sequence, sequence):
                self._next[role] = (turn + step + 1) % len(of_role)
                self._current, self._flips = candidate, []
                return
        first = of_role[turn]
        raise UsageError(
            f"the recording {first.id or role} cannot answer this sequence: "
            f"{'; '.join(differences(first.sequence, sequence))}; scan with the pipeline it was recorded with"
        )

    def present(self, index: int) -> float:
        """Note that pattern `index` is shown from now on, a negative one for none; return the time.

        Raises
        ------
        UsageError
            the recording has no such frame.
        """
        if index >= len(self._current.frames):
            raise UsageError(f"pattern {index} of a recording of {len(self._current.frames)}; expected 0 and up")
        now = self.clock.now()
        self._flips = [*self._flips[-8:], (now, index)]
        return now

    def _due(self, armed_s: float) -> tuple[float, int]:
        """Return start and counter of the next frame."""
        counter = self._counter + 1
        if self._trigger != "free-running":
            return (self._triggered_s if self._triggered_s is not None else np.inf), counter
        late = int((self.clock.now() - armed_s) / self._period_s) - BACKLOG
        counter = max(counter, late)
        return armed_s + counter * self._period_s, counter

    def _check_armed(self) -> float:
        if self._armed_s is None:
            raise DeviceError("the replayed camera is not armed; arm it before frames are read")
        return self._armed_s


def _exposure_s(frame_set: FrameSet) -> float:
    stamps = frame_set.stamps
    recorded = median(s.exposure_end_s - s.exposure_start_s for s in stamps) if stamps else 0.0
    return recorded or frame_set.settings.exposure_us * 1e-6


def _recorded_period_s(frame_set: FrameSet) -> float:
    measured = [
        (b.exposure_start_s - a.exposure_start_s) / (b.counter - a.counter)
        for a, b in pairwise(frame_set.stamps)
        if b.counter > a.counter
    ]
    return max(median(measured) if measured else 0.0, _exposure_s(frame_set), SHORTEST_PERIOD_S)


def differences(recorded: PatternSequence, asked: PatternSequence) -> list[str]:
    """Say in what two sequences would give other frames; nothing where they would not."""
    found = [
        f"{name} is {getattr(recorded, name)!r} there and {getattr(asked, name)!r} here"
        for name in ("family", "width_px", "height_px", "grey_low", "grey_high", "precompensated")
        if getattr(recorded, name) != getattr(asked, name)
    ]
    if len(recorded.frames) != len(asked.frames):
        return [*found, f"it has {len(recorded.frames)} frames and {len(asked.frames)} are asked for"]
    for index, (one, other) in enumerate(zip(recorded.frames, asked.frames, strict=True)):
        if one != other:
            return [*found, f"frame {index} is {one} there and {other} here"]
    if not all(map(np.array_equal, recorded.patterns, asked.patterns)):
        found.append("the patterns' pixels differ")
    return found
