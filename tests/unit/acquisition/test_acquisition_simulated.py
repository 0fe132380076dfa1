"""The acquisition on the real simulated rig, small and as fast as it computes."""

from __future__ import annotations

import pytest
from test_acquisition_runner import Bench

from fringed.acquisition import AcquisitionRequest
from fringed.config.simulated import SensorConfig, SimulationConfig
from fringed.data import CameraSettings
from fringed.devices.camera.sim import SimulatedCamera
from fringed.devices.projector.sim import SimulatedProjector
from fringed.hookspecs import ProjectorTarget
from fringed.simulation.rig import SimulatedRig
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder

SETTINGS = CameraSettings(exposure_us=8333.333, channel="green")


class SimulatedBench(Bench):
    def __init__(self, **config):
        simulation = SimulationConfig(real_time=False, sensor=SensorConfig(width_px=232, height_px=174))
        self.rig = SimulatedRig(simulation)
        self.camera, self.projector = SimulatedCamera(self.rig), SimulatedProjector(self.rig)
        super().__init__(self, **config)  # stands for the fake: it has a camera and a projector

    def take(self, name, **request):
        target = ProjectorTarget(1024, 768, self.rig.calibration().tone_curve)
        sequence = MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), target)
        self.runner.submit(AcquisitionRequest(name, sequence, settings=SETTINGS, **request))
        return self.wait(name)


@pytest.fixture(scope="module")
def station_bench():
    bench = SimulatedBench(latency_s=None)
    with bench:
        assert bench.take("first") is None
        yield bench


def test_latency_of_the_simulated_display_is_measured(station_bench):
    measured = station_bench.runner.latency
    assert abs(measured.latency_s - 2 / 60) <= measured.uncertainty_s + 0.001
    enough_s = measured.latency_s + measured.uncertainty_s + max(measured.settle_s, 0.012)
    assert enough_s >= 2 / 60 + 0.010


@pytest.mark.parametrize("fault", ["late", "repeated", "blended", "dropped", "torn", "vanish", "stall", "garbage"])
def test_simulated_fault_is_found_and_the_set_retaken(station_bench, fault):
    before = len(station_bench.sets)
    station_bench.rig.faults.order(fault, 1)
    assert station_bench.take(fault) is None
    assert len(station_bench.sets) == before + 1
    frame_set = station_bench.sets[-1][0]
    assert frame_set.retakes == 1
    assert frame_set.check.passed
    assert frame_set.provenance.simulated


def test_set_on_the_simulated_rig_needs_a_period_for_each_pattern(station_bench):
    assert station_bench.take("timed") is None
    stamps = station_bench.sets[-1][0].stamps
    assert (stamps[-1].exposure_start_s - stamps[0].exposure_start_s) / 0.1335 == pytest.approx(11, abs=0.01)
