from __future__ import annotations

import numpy as np
import pytest
from acquisition_fakes import FakeRig, Scene

from fringed.acquisition.calibrating import LatencyCalibration
from fringed.acquisition.latency import LatencyEstimator, light
from fringed.acquisition.port import RigPort
from fringed.acquisition.rig import Rig
from fringed.data import CameraSettings
from fringed.errors import QualityError


def port_of(fake):
    port = RigPort(Rig(fake.camera, fake.projector, "fake", "fake"), lambda *_: None, lambda: None)
    port.connect()
    return port


@pytest.mark.parametrize("trigger", ["free-running", "software"])
@pytest.mark.parametrize("latency_s", [0.0, 0.0167, 0.05, 0.13])
def test_latency_is_measured_within_its_stated_uncertainty(latency_s, trigger):
    fake = FakeRig(latency_s=latency_s)
    result = LatencyCalibration(port_of(fake), CameraSettings(8000.0, trigger=trigger), 2.0).run()
    # with an exposure of 8 ms, delay and settling of a few ms are hardly told apart: their sum counts
    assert abs(result.latency_s - latency_s) <= result.uncertainty_s + 0.001
    assert result.uncertainty_s < 0.006
    enough_s = result.latency_s + result.uncertainty_s + result.settle_s
    assert enough_s >= latency_s + fake.decay_s * np.log(100)  # the light is within 1 %


def test_camera_that_does_not_see_the_projector_is_told():
    fake = FakeRig(scene=Scene(albedo=0.0))
    fake.scene.albedo[:] = 0
    with pytest.raises(QualityError, match="no difference between black and white"):
        LatencyCalibration(port_of(fake), CameraSettings(8000.0), 2.0).run()


def test_frames_that_fit_no_delay_are_refused():
    estimator = LatencyEstimator(0.008)
    rng = np.random.default_rng(0)
    for start in np.linspace(0, 0.3, 40):
        estimator.add(start, start + 0.008, rng.random())
    estimator.add(-0.01, 0.001, 0.0)
    with pytest.raises(QualityError):
        estimator.result()


def test_light_is_the_mean_over_the_exposure():
    time_s = np.linspace(0.030, 0.038, 20001)
    exact = np.where(time_s > 0.033, 1 - np.exp(-(time_s - 0.033) / 0.002), 0.0).mean()
    model = light(np.array(0.030), np.array(0.038), np.array(0.033), np.array(0.002))
    assert float(model) == pytest.approx(exact, abs=1e-4)
