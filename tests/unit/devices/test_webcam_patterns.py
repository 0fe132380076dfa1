"""A free-running webcam before a screen that changes: every frame that is kept shows its own pattern, whole."""

import threading

import pytest
from fake_webcam import HEIGHT, WIDTH, Webcam, driver

from fringed.acquisition.actions import (
    Failed,
    Flipped,
    FrameArrived,
    Keep,
    Reached,
    ReadFrame,
    Show,
    WaitUntil,
)
from fringed.acquisition.sequencer import Sequencer, Timing
from fringed.data import CameraSettings

BLEND = 255
PATTERNS = 24


class Screen:
    """What is shown since when; a camera that sees two patterns in one exposure sees a blend."""

    def __init__(self):
        self.flips = [(0.0, 254)]
        self.lock = threading.Lock()

    def show(self, clock, pattern):
        with self.lock:
            self.flips.append((clock.now(), pattern))
            return self.flips[-1][0]

    def seen(self, start_s, end_s):
        with self.lock:
            before = [pattern for flip_s, pattern in self.flips if flip_s <= start_s]
            during = [pattern for flip_s, pattern in self.flips if start_s < flip_s < end_s]
        return BLEND if during else before[-1]


def take(camera, screen, exposure_s):
    """Take PATTERNS as the station does, and return what each kept frame shows."""
    timing = Timing(0.0, 0.0, exposure_s, camera.period_s, frame_timeout_s=20.0)
    sequencer, shown, last = Sequencer(PATTERNS, timing), {}, None
    actions = sequencer.start()
    while True:
        for action in actions[:-1]:
            if isinstance(action, Keep):
                shown[action.index] = int(last.image[HEIGHT // 2, WIDTH // 2])
        match actions[-1]:
            case Show(index):
                event = Flipped(screen.show(camera.clock, index))
            case WaitUntil(time_s):
                camera.clock.sleep(time_s - camera.clock.now())
                event = Reached(camera.clock.now())
            case ReadFrame(timeout_s):
                last = camera.read(timeout_s)
                event = FrameArrived(last.counter, last.exposure_start_s, last.exposure_end_s, camera.clock.now())
            case Failed(reason=reason):
                pytest.fail(reason)
            case _:
                return shown
        actions = sequencer.handle(event)


@pytest.mark.parametrize("means", ["frame-end", "readout-start", "exposure-start"])
@pytest.mark.parametrize("taken_for", ["what it means", "the default"])
def test_no_frame_of_another_pattern_is_kept_whatever_its_stamps_mean(tmp_path, means, taken_for):
    screen = Screen()
    path = tmp_path / "video0"
    path.touch()
    webcam = Webcam(str(path), scene=screen.seen, stamp_marks=means)
    camera = driver(webcam, **({"stamp_marks": means} if taken_for == "what it means" else {}))
    camera.open()
    camera.arm(CameraSettings(exposure_us=webcam.exposure_s * 1e6, channel="white"))
    try:
        assert take(camera, screen, webcam.exposure_s) == {index: index for index in range(PATTERNS)}
    finally:
        camera.close()
