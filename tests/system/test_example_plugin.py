"""The example plug-in, installed as a package of its own, swaps a decoder and an ICP variant."""

from __future__ import annotations

import importlib
import re
import shutil
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path

import numpy as np
import pytest
from msgspec import convert

from fringed.config import simulated_station
from fringed.config.simulated import SimulationConfig
from fringed.data import CameraSettings, FrameSet, RangeImage, Registration
from fringed.devices.camera.sim import SimulatedCamera
from fringed.devices.projector.sim import SimulatedProjector
from fringed.loading import load_plugins
from fringed.messages import Job, StageCall
from fringed.simulation.rig import SimulatedRig
from fringed.testing import RecordingContext
from fringed.workers.resolve import Pool
from fringed.workers.stages import run_stage

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "example-plugin"
SIZES = {"sensor": {"width_px": 232, "height_px": 174}, "seed": 5, "real_time": False}


@pytest.fixture
def catalogue(tmp_path, monkeypatch):
    """Install the example as pip would, its entry points from its own pyproject.toml, and load all plug-ins."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    shutil.copytree(EXAMPLE / "src" / "example_plugin", tmp_path / "example_plugin")
    info = tmp_path / f"fringed_example_plugin-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    points = project["entry-points"]["fringed.plugins"]
    lines = [f"{name} = {module}" for name, module in points.items()]
    (info / "entry_points.txt").write_text("[fringed.plugins]\n" + "\n".join(lines) + "\n")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    yield load_plugins()
    for name in [name for name in sys.modules if name.partition(".")[0] == "example_plugin"]:
        del sys.modules[name]


@pytest.fixture
def pipeline():
    """Return the pipeline that the example's README shows."""
    readme = (EXAMPLE / "README.md").read_text()
    block = re.search(r"^    \[pipelines\.carre\]\n(?:    .*\n)+", readme, re.M)
    return simulated_station(tomllib.loads(textwrap.dedent(block[0]))).pipelines["carre"]


def take(catalogue, rig, pipeline, role):
    calibration = rig.calibration()
    encoder = StageCall("encode", "encoder", pipeline.encoder, pipeline.encoder_params)
    pool = Pool({"projector": calibration})
    sequence = run_stage(catalogue, Job("job", (encoder,)), encoder, pool, RecordingContext())
    camera, projector = SimulatedCamera(rig, {"warm_up": False}), SimulatedProjector(rig)
    camera.open()
    projector.open()
    projector.load(sequence, role)
    settings = camera.arm(CameraSettings(exposure_us=8333.333, channel="green", trigger="software"))
    frames = []
    for index in range(len(sequence.frames)):
        projector.show(index)
        rig.clock.sleep(0.1)
        camera.trigger()
        frames.append(camera.read(5.0).image)
    camera.close()
    return FrameSet(np.array(frames), sequence, role=role, settings=settings, id=f"set-{role}")


def test_example_is_listed_with_its_distribution(catalogue):
    info = next(info for info in catalogue.plugins if info.name == "example")
    assert info.error == ""
    assert (info.distribution, info.version) == ("fringed-example-plugin", "0.1.0")
    assert info.provides["processor"] == ("carre", "trimmed-icp")


def test_named_pipeline_runs_with_the_other_decoder(catalogue, pipeline):
    scene = {"object": "sphere", "options": {"radius_mm": 60.0}, "backdrop_distance_mm": 1060.0}
    rig = SimulatedRig(convert(SIZES | {"scene": scene}, SimulationConfig))
    pool = Pool({role: take(catalogue, rig, pipeline, role) for role in pipeline.roles})
    truth = rig.truth()
    pool.given = {**pool.given, "calibration": rig.calibration()}
    for stage in pipeline.stages:
        call = StageCall(stage.name, "processor", stage.processor, stage.params, stage.inputs)
        pool.made[stage.name] = run_stage(catalogue, Job("job", (call,)), call, pool, RecordingContext())
    view = pool.made["range"]
    assert isinstance(view, RangeImage)
    assert pool.made["wrapped-object"].provenance.plugin == "carre"
    kept = (view.rejected == 0) & (truth.is_object > 0)
    assert kept.sum() > 0.8 * ((truth.lit > 0) & (truth.is_object > 0)).sum()
    # Four 8-bit frames of 21 px fringes, twice, and Carre's formula, which doubles the noise: some 0.3 mm.
    assert np.median(np.abs(view.xyz_mm - truth.xyz_mm)[kept][:, 2]) < 0.5


def test_example_registration_takes_the_built_ins_place(catalogue):
    y, x = np.mgrid[0:60, 0:80].astype(float)
    z = 900 + 5 * np.exp(-(((x - 30) / 15) ** 2) - ((y - 25) / 12) ** 2) + 3 * np.sin(x / 9) * np.cos(y / 7)
    xyz = np.stack([x, y, z], axis=-1).astype(np.float32)
    mask = np.zeros(z.shape, np.uint8)
    views = {
        "reference": RangeImage(xyz, mask, mask, id="a"),
        "model": RangeImage(xyz + np.float32([0, 0, 2]), mask, mask, id="b"),
    }
    call = StageCall("move", "processor", "trimmed-icp", {"overlap": 0.9}, {"reference": "reference", "model": "model"})
    result = run_stage(catalogue, Job("job", (call,)), call, Pool(views), RecordingContext())
    assert isinstance(result, Registration)
    assert (result.reference, result.model) == ("a", "b")
    assert result.T_reference_model[2, 3] == pytest.approx(-2.0, abs=0.1)


def test_examples_own_tests_pass():
    command = [sys.executable, "-W", "error", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "/dev/null",
               "--rootdir", str(EXAMPLE), "--doctest-modules", "src", "tests"]  # fmt: skip
    environment = {"PYTHONPATH": str(EXAMPLE / "src"), "PATH": "/usr/bin:/bin", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=EXAMPLE, env=environment, capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_new_plug_in_of_the_scaffold_works(tmp_path):
    from fringed.scaffold import write_plugin

    files = write_plugin(tmp_path / "my-decoder", "my-decoder")
    assert {file.name for file in files} == {"pyproject.toml", "README.md", "__init__.py", "test_my_decoder.py"}
    command = [sys.executable, "-W", "error", "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    environment = {"PYTHONPATH": ".", "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        command, cwd=tmp_path / "my-decoder", env=environment, capture_output=True, text=True, timeout=100, check=False
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def test_scaffold_refuses_bad_names_and_taken_folders(tmp_path):
    from fringed.errors import UsageError
    from fringed.scaffold import write_plugin

    with pytest.raises(UsageError, match="cannot name a plug-in"):
        write_plugin(tmp_path, "My Decoder")
    write_plugin(tmp_path, "mine")
    with pytest.raises(UsageError, match="exist already"):
        write_plugin(tmp_path, "mine")
