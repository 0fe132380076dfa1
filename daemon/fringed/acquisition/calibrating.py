"""Measure the delay from flip to light with black and white patterns.

Owns which flips to make and which frames to read; the estimate is in `latency`.
"""

from __future__ import annotations

import numpy as np

from fringed.acquisition.cadence import Cadence
from fringed.acquisition.latency import LatencyEstimator, LatencyResult
from fringed.acquisition.port import RigPort
from fringed.acquisition.sampling import full_scale, grid_step, sample
from fringed.acquisition.shots import channel_of
from fringed.data import CameraSettings, Float32Array, PatternFrame, PatternSequence
from fringed.errors import AcquisitionError, QualityError
from fringed.hookspecs import RawFrame

ROLE = "latency"
LONGEST_S = 0.5  # the longest delay that is looked for
TRANSITIONS = 16
ENOUGH = 8  # transitions once the span that is not known is as short as it gets
FLIP_LEAD_S = 0.008  # half a refresh: a flip happens at the next one after it is asked for
MARGIN_S = 0.03
CONTRAST = 0.04  # of full scale, between black and white, for a pixel to count
MIN_PIXELS = 20
MAX_FRAMES = 400


def black_white(width_px: int, height_px: int) -> PatternSequence:
    """Return the two patterns: black, white."""
    frames = (PatternFrame("black", group=0), PatternFrame("white", group=1))
    patterns = tuple(np.full((1, 1, 1), level, np.uint8) for level in (0, 255))
    return PatternSequence("latency", width_px, height_px, frames, patterns)


class LatencyCalibration:
    """One measurement; `run` it once, with both devices open."""

    def __init__(self, port: RigPort, settings: CameraSettings, frame_timeout_s: float) -> None:
        self._port, self._wanted, self._timeout_s = port, settings, frame_timeout_s
        self._settings = settings
        self._triggered = settings.trigger != "free-running"
        self._cadence = Cadence(port.rig.camera.period_s, settings.exposure_us * 1e-6)
        self._read = 0

    def run(self) -> LatencyResult:
        """Measure.

        Raises
        ------
        QualityError
            the camera does not see the projector, or the frames fit no single delay.
        DeviceError
            as the devices say.
        """
        self._port.load(black_white(*self._port.rig.projector.size_px), ROLE)
        self._settings = self._port.arm(self._wanted)
        self._port.acquiring()
        self._cadence = Cadence(self._port.rig.camera.period_s, self._settings.exposure_us * 1e-6)
        estimator = LatencyEstimator(self._cadence.exposure_s, LONGEST_S)
        flip_s = self._port.show(0)
        black = self._image(self._frames_until(flip_s, LONGEST_S)[-1])
        flip_s = self._port.show(1)
        rising = self._frames_until(flip_s, LONGEST_S)
        white = self._image(rising[-1])
        levels = _Levels(black, white, full_scale(self._settings, rising[-1].image.dtype))
        self._add(estimator, levels, rising, flip_s, rising=True)
        for turn in range(TRANSITIONS):
            if turn >= ENOUGH and estimator.transition_s < 3 * self._cadence.exposure_s + MARGIN_S:
                break
            self._transition(estimator, levels, turn)
        return estimator.result()

    def _transition(self, estimator: LatencyEstimator, levels: _Levels, turn: int) -> None:
        offset_s = max(estimator.next_offset_s(), 0.0)
        after_s = estimator.latest_s + MARGIN_S
        if self._triggered:
            begin_s = self._cadence.earliest_trigger_s
        else:
            end_s = self._cadence.end_of_first_after(self._port.now() + offset_s + 2 * FLIP_LEAD_S)
            begin_s = (end_s or 0.0) - self._cadence.exposure_s
        self._port.wait_until(begin_s - offset_s - FLIP_LEAD_S)
        flip_s = self._port.show(turn % 2)
        frames = self._frames_until(flip_s, after_s, offset_s)
        self._add(estimator, levels, frames, flip_s, rising=turn % 2 == 1)

    def _add(
        self, estimator: LatencyEstimator, levels: _Levels, frames: list[RawFrame], flip_s: float, rising: bool
    ) -> None:
        for frame in frames:
            fraction = levels.fraction(self._image(frame))
            estimator.add(
                frame.exposure_start_s - flip_s, frame.exposure_end_s - flip_s, fraction if rising else 1.0 - fraction
            )

    def _frames_until(self, flip_s: float, after_s: float, offset_s: float = 0.0) -> list[RawFrame]:
        """Return the frames exposed from `flip_s` on, up to one that began `after_s` later.

        A triggered camera is triggered `offset_s` after the flip, and then at `after_s`.
        """
        frames: list[RawFrame] = []
        for wanted_s in (offset_s, after_s) if self._triggered else (after_s,):
            if self._triggered:
                self._port.wait_until(max(flip_s + wanted_s, self._cadence.earliest_trigger_s))
                self._port.trigger()
            while self._read < MAX_FRAMES:
                frame = self._port.read(self._timeout_s)
                self._read += 1
                self._cadence.note(frame.counter, frame.exposure_start_s, frame.exposure_end_s, self._port.now())
                if frame.exposure_end_s > flip_s:
                    frames.append(frame)
                if self._triggered or frame.exposure_start_s >= flip_s + wanted_s:
                    break
        if not frames:
            raise AcquisitionError(f"{self._read} frames were read and none was exposed after the flip")
        return frames

    def _image(self, frame: RawFrame) -> Float32Array:
        image = frame.image if frame.image.ndim == 2 else channel_of(frame.image, "green")
        return sample(image, grid_step(image.shape, 8))


class _Levels:
    """What black and white look like, and how far between them a frame is."""

    def __init__(self, black: Float32Array, white: Float32Array, top: float) -> None:
        self._seen = (white - black > CONTRAST * top) & (white < top)
        if self._seen.sum() < MIN_PIXELS:
            raise QualityError(
                f"the camera sees no difference between black and white on {self._seen.size - self._seen.sum()} of "
                f"{self._seen.size} pixels; is the projector on, its lens cap off, and the exposure right?"
            )
        self._black = float(black[self._seen].mean())
        self._white = float(white[self._seen].mean())

    def fraction(self, image: Float32Array) -> float:
        return (float(image[self._seen].mean()) - self._black) / (self._white - self._black)
