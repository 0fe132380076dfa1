"""The rig as a whole: brightness, blending, motion, threads."""

import threading

import msgspec
import numpy as np
import pytest

from fringed.config import SimulationConfig
from fringed.config.simulated import SceneConfig
from fringed.data import CameraSettings, PatternFrame, PatternSequence
from fringed.errors import ConfigurationError, DeviceError, UsageError
from fringed.simulation import optics
from fringed.simulation.rig import SimulatedRig

BASE = {
    "real_time": False,
    "noise": False,
    "quantise": False,
    "sensor": {"width_px": 232, "height_px": 174, "offset_dn": 0.0, "dark_electrons_per_s": 0.0},
    "projector": {"flicker": 0.0},
    "scene": {"object": "plane", "albedo": 1.0, "ambient": 0.0},
}


def rig_with(**sections):
    table = {**BASE}
    for name, section in sections.items():
        table[name] = {**table.get(name, {}), **section} if isinstance(section, dict) else section
    return SimulatedRig(msgspec.convert(table, SimulationConfig))


def flat(*levels):
    patterns = tuple(np.full((1, 1, 1), level, np.uint8) for level in levels)
    return PatternSequence("flat", 1024, 768, tuple(PatternFrame("flat") for _ in levels), patterns)


def sines(count=4, period=16.0, rows=False):
    u = np.arange(768 if rows else 1024)
    patterns, frames = [], []
    for k in range(count):
        shift = 2 * np.pi * k / count
        line = np.rint(127 + 127 * np.cos(2 * np.pi * u / period + shift)).astype(np.uint8)
        patterns.append(line[:, None, None] if rows else line[None, :, None])
        frames.append(PatternFrame("sinusoid", "rows" if rows else "columns", period, shift, 0.0, k, count))
    return PatternSequence("psp", 1024, 768, tuple(frames), tuple(patterns))


def shot(rig, index, wait_s=0.2, exposure_us=8333.333, **settings):
    """Show a pattern and take one settled frame."""
    rig.show(index)
    rig.clock.sleep(wait_s)
    start = rig.clock.now()
    rig.counter += 1
    in_force = rig.sensor.in_force(CameraSettings(exposure_us=exposure_us, channel="green", **settings))
    return rig.image(start, start + exposure_us * 1e-6, in_force, rig.counter).astype(float)


def test_a_white_plane_reaches_eighty_per_cent_after_the_reference_exposure():
    rig = rig_with()
    rig.load(flat(255), "object")
    image = shot(rig, 0)
    assert image[85:89, 113:119].mean() / 65535 == pytest.approx(0.8, rel=0.002)
    # vignetting of 15 % at the corners of camera and of projector, and the distance
    assert image[2, 2] / 65535 < 0.72


def test_light_is_proportional_to_exposure_and_albedo():
    full = rig_with()
    full.load(flat(255), "object")
    dim = rig_with(scene={"albedo": 0.25})
    dim.load(flat(255), "object")
    bright, half, quarter = shot(full, 0), shot(full, 0, exposure_us=4166.6665), shot(dim, 0)
    assert np.abs(half / bright - 0.5).max() < 1e-3
    assert np.abs(quarter / bright - 0.25).max() < 1e-3


def test_ambient_light_adds_its_share_of_white():
    rig = rig_with(scene={"ambient": 0.1}, projector={"black_level": 0.0, "flicker": 0.0})
    rig.load(flat(0), "object")
    assert shot(rig, 0)[85:89, 113:119].mean() / 65535 == pytest.approx(0.08, rel=0.002)


def test_gloss_brightens_what_mirrors_the_projector():
    dull, glossy = (rig_with(scene={"object": "sphere", "specular": s, "albedo": 0.3}) for s in (0.0, 0.8))
    images = []
    for rig in (dull, glossy):
        rig.load(flat(255), "object")
        images.append(shot(rig, 0))
    ratio = images[1] / np.maximum(images[0], 1)
    row, column = np.unravel_index(np.argmax(images[1] - images[0]), ratio.shape)
    assert ratio[row, column] > 1.5
    assert column > 116  # half way to the projector, on the right


def test_fringes_carry_the_projector_column_of_the_truth():
    """N-step PSP on frames without noise gives the phase of the truth: end to end through optics and light."""
    rig = rig_with(scene={"object": "sphere", "albedo": 0.9}, projector={"flicker": 0.0, "gamma": 1.0, "s_curve": 0.0})
    for rows in (False, True):
        rig.load(sines(rows=rows), "object")
        frames = np.stack([shot(rig, k) for k in range(4)])
        delta = 2 * np.pi * np.arange(4) / 4
        phase = np.arctan2(-np.tensordot(np.sin(delta), frames, 1), np.tensordot(np.cos(delta), frames, 1))
        truth = rig.truth()
        good = (truth.lit == 1) & (truth.is_object == 1) & (frames.mean(axis=0) > 3000)
        error = np.angle(np.exp(1j * (phase - 2 * np.pi * truth.projector_px[..., int(rows)] / 16)))[good]
        assert good.sum() > 1500
        # grey levels are rounded: at most 0.5 / 127 / sqrt(2) rad; the mean is far smaller
        assert np.abs(error).max() < 5e-3
        assert abs(error.mean()) < 2e-4


def test_a_free_running_exposure_over_a_switch_is_the_blend_of_both():
    rig = rig_with(projector={"settle_s": 0.0, "flicker": 0.0})
    rig.load(flat(255, 0), "object")
    white, black = shot(rig, 0), shot(rig, 1)
    light = rig.show(0) + 2 / 60
    settings = rig.sensor.in_force(CameraSettings(exposure_us=8000.0, channel="green"))
    blended = rig.image(light - 0.006, light + 0.002, settings, 9).astype(float)
    scale = 8000.0 / 8333.333
    expected = scale * (0.25 * white + 0.75 * black)
    assert np.abs(blended - expected).max() < 0.001 * 65535


def test_flicker_is_what_the_lamps_sine_integrates_to():
    rig = rig_with(projector={"flicker": 0.02, "mains_hz": 50.0})
    steady = rig_with()
    for each in (rig, steady):
        each.load(flat(255), "object")
        each.show(0)
    settings = rig.sensor.in_force(CameraSettings(exposure_us=2000.0, channel="green"))
    for start in (0.5, 0.5025, 0.505, 0.5075):
        ratio = rig.image(start, start + 0.002, settings, 1)[87, 116] / steady.image(start, start + 0.002, settings, 1)[
            87, 116
        ].astype(float)
        t = np.linspace(start, start + 0.002, 1001)
        assert ratio == pytest.approx(1 + 0.02 * np.sin(2 * np.pi * 100 * t).mean(), abs=2e-4)


def test_a_colour_pattern_is_seen_by_its_channel():
    pattern = np.zeros((1, 1, 3), np.uint8)
    pattern[..., 0] = 255
    rig = rig_with()
    rig.load(PatternSequence("red", 1024, 768, (PatternFrame("flat"),), (pattern,)), "object")
    rig.show(0)
    rig.clock.sleep(0.2)
    seen = {}
    for channel in ("red", "green", "blue"):
        settings = rig.sensor.in_force(CameraSettings(exposure_us=8000, channel=channel))
        seen[channel] = float(rig.image(1.0, 1.008, settings, 1)[87, 116])
    assert seen["green"] / seen["red"] == pytest.approx(0.07 / 0.90, abs=0.01)
    assert seen["blue"] / seen["red"] == pytest.approx(0.01 / 0.90, abs=0.01)


def test_a_frame_repeats_under_its_seed_and_counter():
    frames = []
    for seed in (1, 1, 2):
        rig = rig_with(noise=True, quantise=True, seed=seed)
        rig.load(sines(), "object")
        frames.append([shot(rig, k) for k in range(2)])
    assert all((a == b).all() for a, b in zip(frames[0], frames[1], strict=True))
    assert (frames[0][0] != frames[2][0]).any()


def test_the_lens_blur_of_the_camera_mixes_neighbours():
    sharp, soft = rig_with(scene={"object": "sphere"}), rig_with(scene={"object": "sphere"}, sensor={"blur_px": 1.5})
    edges = []
    for rig in (sharp, soft):
        rig.load(flat(255), "object")
        edges.append(np.abs(np.diff(shot(rig, 0), axis=1)).max())
    assert edges[1] < 0.5 * edges[0]


def test_blur_grows_off_the_focus():
    contrast = []
    for z in (0.0, -150.0):
        rig = rig_with(scene={"object": "plane", "translation_mm": [0.0, 0.0, z]})
        rig.load(sines(2, period=8.0), "object")
        a, b = shot(rig, 0), shot(rig, 1)
        contrast.append((np.abs(a - b) / (a + b))[80:90, 110:120].max())
    assert contrast[1] < 0.8 * contrast[0]


def test_another_scene_changes_picture_and_truth_but_not_the_calibration():
    rig = rig_with()
    rig.load(flat(255), "object")
    calibration, before = rig.calibration(), shot(rig, 0)
    rig.set_scene(SceneConfig(object="sphere"))
    assert (shot(rig, 0) != before).any()
    assert rig.truth().scene["object"] == "sphere"
    assert rig.calibration().hash == calibration.hash


def test_a_scene_that_cannot_be_leaves_the_old_one():
    rig = rig_with()
    with pytest.raises(ConfigurationError):
        rig.set_scene(SceneConfig(object="teapot"))
    assert rig.scene.object == "plane"
    with pytest.raises(ConfigurationError):
        rig_with(scene={"object": "teapot"})


def test_another_scene_does_not_wait_for_whoever_traces_the_old_one():
    rig = rig_with()
    setting = threading.Thread(target=rig.set_scene, args=(SceneConfig(object="sphere"),))
    with rig._lock:  # a cold start compiles and traces under it
        setting.start()
        setting.join(10.0)
        waited = setting.is_alive()
    setting.join()
    assert not waited
    assert rig.truth().scene["object"] == "sphere"


def test_patterns_for_another_projector_are_refused():
    rig = rig_with()
    frames = (PatternFrame("flat"),)
    with pytest.raises(DeviceError, match="800 x 600"):
        rig.load(PatternSequence("flat", 800, 600, frames, (np.zeros((1, 1, 1), np.uint8),)), "object")
    with pytest.raises(DeviceError, match="pattern 3"):
        rig.show(3)


def test_an_unknown_fault_names_those_that_exist():
    with pytest.raises(UsageError, match="vanish"):
        rig_with().order_fault("gremlin", 1)
    with pytest.raises(UsageError, match="0 or more"):
        rig_with().order_fault("late", -1)


def test_the_rigs_name_tells_its_geometry():
    assert rig_with().identity == rig_with(scene={"object": "sphere"}, seed=4).identity
    assert rig_with().identity != rig_with(geometry={"baseline_mm": 200.0}).identity


def test_truth_and_scenes_may_be_asked_for_while_frames_are_taken():
    rig = rig_with()
    rig.load(sines(), "object")
    problems = []

    def look():
        try:
            for k in range(6):
                rig.set_scene(SceneConfig(object=("sphere", "plane")[k % 2]))
                rig.truth()
                rig.order_fault("late", 0)
        except Exception as error:  # noqa: BLE001
            problems.append(error)

    thread = threading.Thread(target=look)
    thread.start()
    for k in range(8):
        assert shot(rig, k % 4).shape == (174, 232)
    thread.join()
    assert problems == []


def test_the_truth_projects_onto_its_own_pixels_for_a_head():
    rig = rig_with(scene={"object": "face", "options": {"columns": 160, "rows": 120}, "rotation_deg": [0, 60, 0]})
    truth = rig.truth()
    seen = (truth.is_object == 1) & (truth.visible == 1)
    assert seen.mean() > 0.15
    pixels = optics.project(rig.calibration().camera, truth.xyz_mm[seen])
    rows, columns = np.nonzero(seen)
    assert np.abs(pixels - np.stack([columns, rows], axis=-1)).max() < 1e-3


def test_a_whole_picture_is_exposed_like_the_line_that_it_repeats():
    line = sines(1).patterns[0]
    for pattern in (line, sines(1, rows=True).patterns[0]):
        whole = np.ascontiguousarray(np.broadcast_to(pattern, (768, 1024, 1)))
        images = []
        for each in (pattern, whole):
            rig = rig_with()
            rig.load(PatternSequence("any", 1024, 768, (PatternFrame("sinusoid"),), (each,)), "object")
            images.append(shot(rig, 0))
        assert np.abs(images[0] - images[1]).max() < 0.004 * images[0].max()


def test_an_exposure_over_a_change_of_orientation_adds_columns_and_rows():
    columns, rows = sines(1), sines(1, rows=True)
    both = PatternSequence("both", 1024, 768, (*columns.frames, *rows.frames), (*columns.patterns, *rows.patterns))
    rig = rig_with(projector={"settle_s": 0.0, "flicker": 0.0})
    rig.load(both, "object")
    first, second = shot(rig, 0), shot(rig, 1)
    light = rig.show(0) + 2 / 60
    settings = rig.sensor.in_force(CameraSettings(exposure_us=8333.333, channel="green"))
    half = 8333.333e-6 / 2
    image = rig.image(light - half, light + half, settings, 9).astype(float)
    assert np.abs(image - (first + second) / 2).max() < 0.001 * 65535
