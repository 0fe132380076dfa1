"""Dark and shiny parts of one object: three exposures through the station, and what fusing them brings."""

from __future__ import annotations

import numpy as np
import pytest

from fringed.config.simulated import SceneConfig, SensorConfig, SimulationConfig
from fringed.data import CameraSettings, FrameSet, Mesh, PhaseMap
from fringed.devices.camera.sim import SimulatedCamera
from fringed.devices.projector.sim import SimulatedProjector
from fringed.hookspecs import ProjectorTarget
from fringed.simulation.rig import SimulatedRig
from fringed.testing import RecordingContext
from fringed_client import Station
from fringed_plugins.decoders.fusion import FuseExposures
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder

FACTORS = {"object-short": 0.125, "object": 1.0, "object-long": 8.0}


def test_station_takes_a_set_for_each_exposure_and_fuses_them(station_runtime):
    with Station(station_runtime) as station:
        result = station.scan("hdr", camera={"exposure_us": 2000.0})
        assert result.state.state == "done"
        sets = {role: station.get(set_id) for role, set_id in result.state.frame_sets.items()}
        assert {role: one.settings.exposure_us / 2000 for role, one in sets.items()} == pytest.approx(FACTORS)
        products = {product["stage"]: station.get(product["id"]) for product in result.state.products}
        assert set(products) == {"phase", "range"}
        fused = products["phase"]
        assert isinstance(fused, PhaseMap) and len(fused.provenance.inputs) == 3
        single = station.scan("hierarchical", camera={"exposure_us": 2000.0})
        alone = next(station.get(made["id"]) for made in single.state.products if made["stage"] == "phase")
        both = (fused.rejected == 0) & (alone.rejected == 0)
        assert both.sum() > 0.99 * (alone.rejected == 0).sum()
        assert np.median(fused.sigma_rad[both]) < 0.7 * np.median(alone.sigma_rad[both])


def dome(side=81, radius_mm=140.0):
    y, x = np.meshgrid(*2 * [np.linspace(-radius_mm, radius_mm, side)], indexing="ij")
    z = 45 * np.exp(-(x**2 + y**2) / (2 * 75.0**2))
    index = np.arange(side * side, dtype=np.int32).reshape(side, side)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    albedo = np.exp(np.interp(x, [-radius_mm, radius_mm], np.log([0.05, 0.9]))).astype(np.float32)
    return Mesh(np.stack([x, y, z], -1).reshape(-1, 3), faces, albedo.ravel())


@pytest.fixture(scope="module")
def rig():
    config = SimulationConfig(
        real_time=False,
        sensor=SensorConfig(width_px=232, height_px=174),
        scene=SceneConfig(object="mesh", albedo=1.0, specular=1.0),
    )
    return SimulatedRig(config, mesh=dome())


def decoded(rig, exposure_us):
    target = ProjectorTarget(1024, 768, rig.calibration().tone_curve)
    sequence = MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), target)
    camera, projector = SimulatedCamera(rig, {"warm_up": False}), SimulatedProjector(rig)
    camera.open()
    projector.open()
    projector.load(sequence, "object")
    settings = camera.arm(CameraSettings(exposure_us=exposure_us, channel="green", trigger="software"))
    frames = []
    for index in range(len(sequence.frames)):
        rig.clock.sleep(max(projector.show(index) + 0.05 - rig.clock.now(), 0.0))
        camera.trigger()
        frames.append(camera.read(5.0).image)
    camera.close()
    projector.close()
    frame_set = FrameSet(np.array(frames), sequence, settings=settings)
    return MultiFrequencyDecoder().run({"frames": frame_set}, MultiFrequencyDecoder.Params(), RecordingContext())


def test_albedos_of_a_twentieth_to_nine_tenths_and_a_highlight_are_all_there(rig):
    maps = tuple(decoded(rig, 8333.333 * factor) for factor in FACTORS.values())
    fused = FuseExposures().run({"maps": maps}, FuseExposures.Params(), RecordingContext())
    truth = rig.truth()
    wanted = (truth.is_object > 0) & (truth.visible > 0) & (truth.lit > 0)
    kept = (fused.rejected == 0) & wanted
    assert kept.sum() > 0.99 * wanted.sum()
    good = [((one.rejected == 0) & wanted & (one.sigma_rad < 0.04)).sum() / wanted.sum() for one in (*maps, fused)]
    assert good[3] > 0.98 > 0.85 > max(good[:3])
    error = fused.phase_rad - truth.projector_px[..., 0] * np.float32(2 * np.pi / fused.period_px)
    assert not np.any(np.abs(error[kept]) > np.pi)
    # The median of squared normal errors is 0.455 of their variance; 8 bits and 12,000 pixels leave some percent.
    assert np.median((error[kept] / fused.sigma_rad[kept]) ** 2) / 0.455 == pytest.approx(1.0, abs=0.2)
