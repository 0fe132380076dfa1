"""The range image of the simulated rig against its truth, default noise, at a third of the full resolution.

The full size and several seeds are in tests/bench/bench_accuracy.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from msgspec import convert

from fringed.config.simulated import SimulationConfig
from fringed.data import CameraSettings, FrameSet
from fringed.devices.camera.sim import SimulatedCamera
from fringed.devices.projector.sim import SimulatedProjector
from fringed.hookspecs import ProjectorTarget
from fringed.simulation.rig import SimulatedRig
from fringed.testing import RecordingContext
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder
from fringed_plugins.triangulation_plugin import Triangulate


def scan(scene):
    table = {"real_time": False, "seed": 11, "sensor": {"width_px": 464, "height_px": 348}, "scene": scene}
    rig = SimulatedRig(convert(table, SimulationConfig))
    calibration, context = rig.calibration(), RecordingContext()
    target = ProjectorTarget(calibration.projector.width_px, calibration.projector.height_px, calibration.tone_curve)
    sequence = MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), target)
    camera, projector = SimulatedCamera(rig, {"warm_up": False}), SimulatedProjector(rig)
    camera.open()
    projector.open()
    projector.load(sequence, "object")
    settings = camera.arm(CameraSettings(exposure_us=8333.333, channel="green", trigger="software"))
    frames = []
    for index in range(len(sequence.frames)):
        projector.show(index)
        rig.clock.sleep(0.1)
        camera.trigger()
        frames.append(camera.read(5.0).image)
    camera.close()
    frame_set = FrameSet(np.array(frames), sequence, settings=settings)
    phase = MultiFrequencyDecoder().run({"frames": frame_set}, MultiFrequencyDecoder.Params(), context)
    inputs = {"phase": phase, "calibration": calibration}
    return Triangulate().run(inputs, Triangulate.Params(), context), rig.truth()


@pytest.mark.parametrize(
    "scene", [{"object": "plane"}, {"object": "sphere", "options": {"radius_mm": 60.0}}, {"object": "steps"}],
    ids=lambda scene: scene["object"],
)  # fmt: skip
def test_range_image_is_unbiased_complete_and_as_noisy_as_predicted(scene):
    view, truth = scan(scene)
    wanted = (truth.is_object > 0) & (truth.visible > 0) & (truth.lit > 0)
    kept = (view.rejected == 0) & wanted
    xyz = truth.xyz_mm.astype(float)
    along = np.einsum("...i,...i", view.xyz_mm - xyz, xyz) / np.linalg.norm(xyz, axis=2)
    # The figures of the foundation issue. 14,000 points or more: the mean is known to 0.001 mm, the deviation to 1 %.
    assert abs(along[kept].mean()) < 0.02
    assert np.std(along[kept] / view.sigma_mm[kept]) <= 1.15
    assert kept.sum() > 0.98 * wanted.sum()
    for row, column in np.argwhere((view.rejected == 0) & ~(np.abs(along) <= 1.0)):
        near = xyz[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4].reshape(-1, 3)
        assert np.nanmin(np.linalg.norm(near - view.xyz_mm[row, column], axis=1)) <= 1.0
