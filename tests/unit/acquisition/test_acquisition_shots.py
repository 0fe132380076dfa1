"""One exposure, three channels: what may be taken, and what becomes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from acquisition_fakes import NOISY, sinusoids
from test_acquisition_runner import KNOWN, Bench

from fringed.acquisition import AcquisitionRequest
from fringed.acquisition.shots import check_channels, checks_of
from fringed.acquisition.times import timing_findings
from fringed.config import CheckConfig
from fringed.config.simulated import ProjectorOptics, SceneConfig, SensorConfig, SimulationConfig
from fringed.data import CameraSettings, FrameStamp, PatternFrame, PatternSequence
from fringed.devices.camera.replay import ReplayCamera
from fringed.devices.camera.sim import SimulatedCamera
from fringed.devices.projector.replay import ReplayProjector
from fringed.devices.projector.sim import SimulatedProjector
from fringed.errors import UsageError
from fringed.simulation.rig import SimulatedRig

COLOUR = CameraSettings(exposure_us=8333.333, channel="rgb")
CHANNELS = ("red", "green", "blue")
PANEL = (1024, 768)


def colour_steps(shots=4, period_px=32.0):
    """Each shot carries the same step of three frequencies, one in each colour."""
    frames, patterns = [], []
    for shot in range(shots):
        shift = 2 * np.pi * shot / shots
        column = np.arange(PANEL[0])
        waves = [127.5 + 127.5 * np.cos(2 * np.pi * column * (c + 1) / (4 * period_px) + shift) for c in range(3)]
        pattern = np.round(np.stack(waves, axis=-1)).astype(np.uint8)[None]
        for c, channel in enumerate(CHANNELS):
            frames.append(PatternFrame("sinusoidal", "columns", 4 * period_px / (c + 1), shift, 0.0, shot, shots, c,
                                       channel, shot=shot))  # fmt: skip
            patterns.append(pattern)
    return PatternSequence("colour", *PANEL, tuple(frames), tuple(patterns), encoder="colour")


def test_sequences_without_shots_have_an_exposure_for_each_frame():
    assert sinusoids((1,), 4).exposures() == ((0,), (1,), (2,), (3,))
    assert colour_steps(2).exposures() == ((0, 1, 2), (3, 4, 5))


def test_camera_and_patterns_have_to_agree_on_shots():
    check_channels(colour_steps(), COLOUR)
    check_channels(sinusoids(), CameraSettings(channel="green"))
    with pytest.raises(UsageError, match='channel = "rgb"'):
        check_channels(colour_steps(), CameraSettings(channel="green"))
    with pytest.raises(UsageError, match="channel green"):
        check_channels(sinusoids(), COLOUR)


@pytest.mark.parametrize("wrong", ["twice-red", "white", "two-pictures", "apart"])
def test_shot_that_is_none_is_refused(wrong):
    good = colour_steps(2)
    frames, patterns = list(good.frames), list(good.patterns)
    if wrong == "twice-red":
        frames[1] = replace(frames[1], channel="red")
    elif wrong == "white":
        frames[1] = replace(frames[1], channel="white")
    elif wrong == "two-pictures":
        patterns[1] = patterns[4]
    else:
        frames[1], frames[3] = frames[3], frames[1]
        patterns[1], patterns[3] = patterns[3], patterns[1]
    with pytest.raises(UsageError, match="frames of a shot"):
        check_channels(replace(good, frames=tuple(frames), patterns=tuple(patterns)), COLOUR)


def test_frames_of_a_shot_share_one_exposure_and_shots_follow_each_other():
    exposures = ((0, 1, 2), (3, 4, 5))
    first, second = FrameStamp(0.0, 0.05, 0.06, 7), FrameStamp(0.2, 0.25, 0.26, 8)
    assert timing_findings((first,) * 3 + (second,) * 3, exposures, 0.05) == []
    late = replace(second, exposure_start_s=0.24)
    assert [f.fault for f in timing_findings((first,) * 3 + (second, late, second), exposures, 0.05)] == ["order"]
    assert [f.fault for f in timing_findings((first,) * 6, exposures, 0.05)] == ["order", "exposure"]
    assert [f.fault for f in timing_findings((first,) * 3 + (late,) * 3, exposures, 0.05)] == ["exposure"]
    assert [f.fault for f in timing_findings((first,) * 3, exposures, 0.05)] == ["count"]


def test_only_the_shortest_exposure_is_judged_for_saturation_and_only_the_longest_for_light():
    limits = CheckConfig(saturated_max=0.25, lit_min=0.005)
    settings = {
        "object": CameraSettings(8000.0),
        "object-long": CameraSettings(32000.0),
        "object-short": CameraSettings(2000.0),
        "reference": CameraSettings(8000.0),
    }
    judged = {role: checks_of(role, settings, limits) for role in settings}
    assert {role: one.saturated_max for role, one in judged.items()} == {
        "object": 1.0, "object-long": 1.0, "object-short": 0.25, "reference": 0.25
    }  # fmt: skip
    assert {role: one.lit_min for role, one in judged.items()} == {
        "object": 0.0, "object-long": 0.005, "object-short": 0.0, "reference": 0.005
    }  # fmt: skip
    assert checks_of("a", {"a": NOISY, "b": NOISY}, limits) == limits


class ColourBench(Bench):
    def __init__(self, **scene):
        optics = ProjectorOptics(gamma=1.0, s_curve=0.0)
        sensor = SensorConfig(width_px=116, height_px=87)
        self.rig = SimulatedRig(
            SimulationConfig(real_time=False, projector=optics, sensor=sensor, scene=SceneConfig(**scene))
        )
        self.camera, self.projector = SimulatedCamera(self.rig), SimulatedProjector(self.rig)
        super().__init__(self, **KNOWN)

    def take(self, name, sequence, settings=COLOUR):
        self.runner.submit(AcquisitionRequest(name, sequence, settings=settings))
        return self.wait(name)


@pytest.fixture(scope="module")
def colour_bench():
    with ColourBench(object="plane") as bench:
        yield bench


def test_one_exposure_gives_three_frames_each_through_its_own_ccd(colour_bench):
    before = len(colour_bench.sets)
    assert colour_bench.take("colour", colour_steps()) is None
    frame_set, sink = colour_bench.sets[before]
    assert frame_set.frames.shape == (12, 87, 116)
    assert frame_set.settings.channel == "rgb"
    assert sorted(sink.written) == list(range(12))
    counters = [stamp.counter for stamp in frame_set.stamps]
    assert counters == [c for c in sorted(set(counters)) for _ in range(3)]
    assert len(set(counters)) == 4
    # On the plane, what the red CCD sees steps with the red fringes; crosstalk adds the others' in proportion.
    frames = frame_set.frames.astype(float).reshape(4, 3, 87, 116)
    phasor = np.tensordot(np.exp(-2j * np.pi * np.arange(4) / 4), frames, 1) / 2
    truth = colour_bench.rig.truth()
    column = truth.projector_px[..., 0].astype(float)
    crosstalk = np.array(colour_bench.rig.config.sensor.crosstalk)
    clear = np.isfinite(column) & (truth.lit > 0)
    waves = np.stack([np.exp(2j * np.pi * column[clear] * (c + 1) / 128) for c in range(3)])
    gain = np.linalg.lstsq(waves.T, phasor[:, clear].T, rcond=None)[0].T  # camera by projector channel
    assert np.abs(gain / gain.diagonal()[:, None] - crosstalk / crosstalk.diagonal()[:, None]).max() < 0.02


def test_channels_of_one_exposure_have_noise_of_their_own(colour_bench):
    flat = np.full((1, 1, 3), 128, np.uint8)
    frames = tuple(PatternFrame("grey", channel=channel, shot=0) for channel in CHANNELS)
    colour_bench.rig.load(PatternSequence("flat", *PANEL, frames, (flat,) * 3), "object")
    colour_bench.rig.show(0)
    colour_bench.rig.clock.sleep(1.0)
    settings = colour_bench.rig.sensor.in_force(COLOUR)
    now = colour_bench.rig.clock.now()
    images = [colour_bench.rig.image(now, now + 0.008, settings, counter).astype(float) for counter in (5, 6)]
    noise = (images[1] - images[0]).reshape(-1, 3)
    noise -= noise.mean(axis=0)
    assert np.abs(np.corrcoef(noise.T) - np.eye(3)).max() < 0.05
    fixed = (images[0] + images[1])[20:70, 30:90].reshape(-1, 3)
    assert abs(np.corrcoef((fixed[:, 0] / fixed[:, 1], fixed[:, 2] / fixed[:, 1]))[0, 1]) < 0.9  # gains differ
    again = colour_bench.rig.image(now, now + 0.008, settings, 5)
    np.testing.assert_array_equal(again, images[0])


@pytest.mark.parametrize("fault", ["late", "repeated", "blended", "dropped", "torn", "stall", "garbage"])
def test_fault_of_a_shot_is_found_and_the_set_retaken(colour_bench, fault):
    before = len(colour_bench.sets)
    colour_bench.rig.faults.order(fault, 1)
    assert colour_bench.take(f"colour-{fault}", colour_steps()) is None
    assert len(colour_bench.sets) == before + 1
    assert colour_bench.sets[-1][0].retakes == 1


def test_wrong_camera_is_refused_before_anything_is_projected(colour_bench):
    shown = []
    show = colour_bench.projector.show
    colour_bench.projector.show = lambda index: shown.append(index) or show(index)
    try:
        error = colour_bench.take("plain", colour_steps(), CameraSettings(channel="green"))
        assert isinstance(error, UsageError) and 'channel = "rgb"' in str(error)
        plain = PatternSequence("plain", *PANEL, (PatternFrame("white"),), (np.full((1, 1, 1), 255, np.uint8),))
        assert isinstance(colour_bench.take("colour-camera", plain), UsageError)
    finally:
        colour_bench.projector.show = show
    assert shown == []


def test_delay_is_measured_with_three_channels():
    with ColourBench(object="plane") as bench:
        bench.runner.reconfigure(bench.runner._config.__class__(latency_s=None), CheckConfig())
        assert bench.take("first", colour_steps()) is None
        assert abs(bench.runner.latency.latency_s - 2 / 60) <= bench.runner.latency.uncertainty_s + 0.001


def test_replay_delivers_the_recorded_channels_together(colour_bench):
    sequence = colour_steps()
    assert colour_bench.take("to-replay", sequence) is None
    recorded = colour_bench.sets[-1][0]
    camera = ReplayCamera([recorded], colour_bench.rig.clock, real_time=False)
    projector = ReplayProjector(camera)
    camera.open()
    projector.load(sequence, "object")
    assert camera.arm(CameraSettings(channel="green", trigger="software")).channel == "rgb"
    camera.trigger()
    assert not camera.read(1.0).image.any()
    for first in (0, 3, 6, 9):
        projector.show(first)
        camera.trigger()
        image = camera.read(1.0).image
        np.testing.assert_array_equal(image, np.moveaxis(recorded.frames[first : first + 3], 0, -1))
    camera.close()
