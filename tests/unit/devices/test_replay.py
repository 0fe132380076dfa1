"""A recording replayed as a camera: same frames, same pace, marked as replayed, and nothing else answered."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fringed.data import CameraSettings, FrameSet, FrameStamp, PatternFrame, PatternSequence, Provenance
from fringed.devices.camera.replay import ReplayCamera, SkippingClock
from fringed.devices.projector.replay import ReplayProjector
from fringed.errors import DeviceError, DeviceStalled, UsageError
from fringed.hookspecs import Camera, Projector

PERIOD_S = 0.1


class ManualClock:
    def __init__(self) -> None:
        self.time_s = 100.0
        self.slept_s = 0.0

    def now(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds
        self.slept_s += seconds


def sequence(steps: int = 4, family: str = "phase-shift") -> PatternSequence:
    frames = tuple(PatternFrame("sine", period_px=8.0, step=k, steps=steps) for k in range(steps))
    patterns = tuple(np.full((1, 16, 1), 10 * k, np.uint8) for k in range(steps))
    return PatternSequence(family, 16, 12, frames, patterns)


def recording(role: str = "object", first: int = 0, steps: int = 4, simulated: bool = False) -> FrameSet:
    frames = np.stack([np.full((6, 8), first + k, np.uint8) for k in range(steps)])
    stamps = tuple(FrameStamp(k * 0.3, k * 0.3 + 0.05, k * 0.3 + 0.06, 3 * k) for k in range(steps))
    provenance = Provenance(simulated=simulated)
    return FrameSet(frames, sequence(steps), role, f"set-{role}-{first}", stamps=stamps, provenance=provenance)


def rig(*sets: FrameSet, real_time: bool = True) -> tuple[ReplayCamera, ReplayProjector, ManualClock]:
    clock = ManualClock()
    camera = ReplayCamera(sets, clock, real_time)
    return camera, ReplayProjector(camera), clock


def take(camera: ReplayCamera, projector: ReplayProjector, steps: int = 4) -> list[int]:
    """Show each pattern and read the first frame whose integration began after its flip."""
    values = []
    for index in range(steps):
        flip_s = projector.show(index)
        frame = camera.read(1.0)
        while frame.exposure_start_s < flip_s:
            frame = camera.read(1.0)
        values.append(int(frame.image[0, 0]))
    return values


def test_each_pattern_gets_its_recorded_frame() -> None:
    camera, projector, _ = rig(recording(first=40))
    projector.load(sequence(), "object")
    camera.arm(CameraSettings())
    assert take(camera, projector) == [40, 41, 42, 43]


def test_replayed_devices_satisfy_the_device_contract_and_are_marked() -> None:
    camera, projector, _ = rig(recording(simulated=True))
    as_camera: Camera = camera
    as_projector: Projector = projector
    assert as_camera.replayed
    assert as_camera.simulated and as_projector.simulated  # a replay of simulated frames stays simulated
    assert not rig(recording())[0].simulated
    assert (camera.size_px, projector.size_px) == ((8, 6), (16, 12))
    assert "set-object-0" in camera.open()


def test_frames_come_at_the_recorded_pace() -> None:
    camera, projector, clock = rig(recording())  # counters advance by 3 in 0.3 s: one frame each 0.1 s
    assert camera.period_s == pytest.approx(PERIOD_S)
    projector.load(sequence(), "object")
    camera.arm(CameraSettings())
    projector.show(0)
    frames = [camera.read(1.0) for _ in range(5)]
    assert np.diff([f.exposure_start_s for f in frames]) == pytest.approx(PERIOD_S)
    assert [f.counter for f in frames] == [0, 1, 2, 3, 4]
    assert frames[0].exposure_end_s - frames[0].exposure_start_s == pytest.approx(0.01)
    assert clock.slept_s == pytest.approx(5 * PERIOD_S)


def test_without_real_time_nothing_waits_and_time_still_passes() -> None:
    camera, projector, clock = rig(recording(), real_time=False)
    projector.load(sequence(), "object")
    camera.arm(CameraSettings())
    before_s = camera.clock.now()
    assert take(camera, projector) == [0, 1, 2, 3]
    assert clock.slept_s == 0
    assert camera.clock.now() >= before_s + 3.9 * PERIOD_S
    assert isinstance(camera.clock, SkippingClock)


def test_frame_integrated_before_the_flip_shows_the_pattern_before_it() -> None:
    camera, projector, clock = rig(recording())
    projector.load(sequence(), "object")
    camera.arm(CameraSettings())
    projector.show(0)
    clock.sleep(0.05)  # the first integration is under way
    projector.show(1)
    assert camera.read(1.0).image[0, 0] == 0
    assert camera.read(1.0).image[0, 0] == 1


def test_late_reader_sees_the_counter_skip() -> None:
    camera, projector, clock = rig(recording())
    projector.load(sequence(), "object")
    camera.arm(CameraSettings())
    camera.read(1.0)
    clock.sleep(20 * PERIOD_S)
    assert camera.read(1.0).counter > 10


def test_triggered_camera_waits_for_its_trigger() -> None:
    camera, projector, _ = rig(recording())
    projector.load(sequence(), "object")
    assert camera.arm(CameraSettings(trigger="software")).trigger == "software"
    with pytest.raises(DeviceStalled, match="trigger"):
        camera.read(0.5)
    flip_s = projector.show(2)
    camera.trigger()
    frame = camera.read(0.5)
    assert frame.image[0, 0] == 2
    assert frame.exposure_start_s >= flip_s
    with pytest.raises(DeviceStalled):
        camera.read(0.5)


def test_sets_of_a_role_take_turns() -> None:
    camera, projector, _ = rig(recording(first=0), recording("reference", 50), recording(first=90))
    camera.arm(CameraSettings())
    firsts = []
    for role in ("object", "reference", "object", "object"):
        projector.load(sequence(), role)
        firsts.append(take(camera, projector)[0])
    assert firsts == [0, 50, 90, 0]


def test_settings_in_force_are_the_recorded_ones() -> None:
    recorded = dataclasses.replace(recording(), settings=CameraSettings(exposure_us=123.0, channel="red"))
    camera, _, _ = rig(recorded)
    in_force = camera.arm(CameraSettings(exposure_us=9.0, channel="green"))
    assert (in_force.exposure_us, in_force.channel) == (123.0, "red")


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        (sequence(6), "4 frames and 6"),
        (sequence(family="grey-code"), "family is 'phase-shift' there and 'grey-code' here"),
        (dataclasses.replace(sequence(), patterns=(np.zeros((1, 16, 1), np.uint8),) * 4), "pixels differ"),
        (
            dataclasses.replace(
                sequence(), frames=tuple(dataclasses.replace(f, period_px=9.0) for f in sequence().frames)
            ),
            "frame 0",
        ),
    ],
)
def test_other_sequences_are_refused_with_the_difference(asked: PatternSequence, why: str) -> None:
    _, projector, _ = rig(recording())
    with pytest.raises(UsageError, match=why) as caught:
        projector.load(asked, "object")
    assert "set-object-0" in str(caught.value)


def test_unknown_role_is_refused_with_those_that_exist() -> None:
    _, projector, _ = rig(recording(), recording("reference"))
    with pytest.raises(UsageError, match="object, reference"):
        projector.load(sequence(), "pose 3")


def test_frame_sets_of_different_cameras_are_refused() -> None:
    other = FrameSet(np.zeros((4, 7, 9), np.uint8), sequence())
    with pytest.raises(UsageError, match="one size"):
        ReplayCamera([recording(), other], ManualClock())
    with pytest.raises(UsageError, match="0 were given"):
        ReplayCamera([], ManualClock())


def test_use_out_of_order_is_refused() -> None:
    camera, projector, _ = rig(recording())
    with pytest.raises(DeviceError, match="not armed"):
        camera.read(0.1)
    with pytest.raises(DeviceError, match="no patterns"):
        projector.show(0)
    projector.load(sequence(), "object")
    with pytest.raises(UsageError, match="expected 0"):
        projector.show(4)
    camera.close()
    camera.close()
    projector.close()


def test_before_any_pattern_and_when_idle_the_frame_is_dark() -> None:
    camera, projector, _ = rig(recording(first=7))
    projector.load(sequence(), "object")
    camera.arm(CameraSettings())
    assert not camera.read(1.0).image.any()
    projector.show(0)
    assert camera.read(1.0).image.all()
    projector.idle()
    assert not camera.read(1.0).image.any()
