"""What goes wrong outside: a full disk, plug-ins that crash or make scenes, a killed worker."""

import os
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest
from daemonkit import SMALL, Daemon

from fringed.errors import NotFound, Quarantined, StorageError
from fringed_client.protocol.requests import Call

PLUGIN = """
import os
from fringed.data import FrameSet, Mesh, PhaseMap
from fringed.hookspecs import Params, hookimpl
import numpy as np

class Crash:
    name, version, summary = "crash", "1", "takes its worker down"
    inputs, optional, output = {"frames": FrameSet}, frozenset(), PhaseMap
    class Params(Params, frozen=True, kw_only=True):
        pass
    def run(self, inputs, params, context):
        os._exit(9)

class Wedge:
    name, version, summary = "wedge", "1", "two triangles"
    class Params(Params, frozen=True, kw_only=True):
        size_mm: float = 80.0
    def make(self, params):
        s = params.size_mm
        corners = np.array([[-s, -s, 0], [s, -s, 0], [s, s, 20], [-s, s, 20]], float)
        return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))

@hookimpl
def register_processors():
    return [Crash]

@hookimpl
def register_scenes():
    return [Wedge]
"""
CRASHING = """
[pipelines.crashing]
encoder = "multi-frequency"
encoder_params = { periods = [1, 8, 64], steps = 4 }
stages = [{ processor = "crash" }]
"""


@pytest.fixture
def plugin_config(tmp_path):
    folder = tmp_path / "plugins"
    folder.mkdir()
    (folder / "mine.py").write_text(PLUGIN)
    return SMALL.replace("[workers]", f"[workers]\nattempts = 2\nplugin_folders = [{str(folder)!r}]") + CRASHING


def finished(client, state, timeout_s=60.0):
    deadline = time.monotonic() + timeout_s
    while state.state not in ("done", "failed", "cancelled"):
        assert time.monotonic() < deadline, state
        time.sleep(0.05)
        state = client._run(looked_at(state.id))
    return state


def looked_at(scan):
    return (yield Call("wait", {"id": scan, "timeout_s": 0.0}))


def test_a_crashing_plug_in_is_quarantined_over_a_restart_while_others_go_on(tmp_path, plugin_config):
    daemon = Daemon(tmp_path, plugin_config).until_ready().until_worker()
    try:
        with daemon.client() as client:
            failed = finished(client, client.request("scan", pipeline="crashing"))
            assert failed.error.code == Quarantined.__name__, failed
            assert finished(client, client.request("scan")).state == "done"
            (entry,) = client.status().quarantine
            assert entry.pipeline == "crashing"
            assert "exited with status 9" in entry.reason
            frames = failed.frame_sets["object"]
        assert daemon.end() == 0
        daemon = Daemon(tmp_path, plugin_config).until_ready().until_worker()
        with daemon.client() as client:
            assert client.status().quarantine == (entry,)
            inputs = {"object": frames}
            again = finished(client, client.request("process", pipeline="crashing", inputs=inputs))
            assert again.error.code == Quarantined.__name__
            assert client.request("quarantine.clear")["cleared"] == 1
            assert client.status().quarantine == ()
    finally:
        daemon.end()


def test_a_scene_of_a_plug_in_stands_before_the_rig_from_the_start(tmp_path, plugin_config):
    config = plugin_config.replace('object = "sphere"', 'object = "wedge"\noptions = { size_mm = 60.0 }')
    daemon = Daemon(tmp_path, config).until_ready()
    try:
        assert "until a worker has made it, there are no scans" in daemon.log
        daemon.logged("the scene 'wedge' stands there now", 60.0)
        with daemon.client() as client:
            state = finished(client, client.request("scan", truth=True))
            truth = client.request("get", id=next(p["id"] for p in state.products if p["kind"] == "Truth"))
        heights = truth.xyz_mm[..., 2][(truth.is_object > 0)]
        assert np.ptp(heights) == pytest.approx(20.0, rel=0.1)  # the wedge rises by 20 mm; its edges are a pixel wide
    finally:
        daemon.end()


def test_a_scene_that_nobody_has_is_never_replaced_by_another_one(tmp_path, plugin_config):
    daemon = Daemon(tmp_path, plugin_config.replace('object = "sphere"', 'object = "nope"')).until_ready()
    known = r"'nope'; built in are plane, .*, mesh, board; of plug-ins: .*wedge"
    try:
        daemon.logged("so there are no scans", 60.0)
        with daemon.client() as client:
            for verb, params in (("scan", {}), ("simulate.scene", {"scene": {"object": "nope"}})):
                with pytest.raises(NotFound, match=known):
                    client.request(verb, **params)
            assert "no scans: no scene is called 'nope'" in client.status().camera.detail
            client.request("simulate.scene", scene={"object": "sphere"})
            assert "no scans" not in client.status().camera.detail
            assert finished(client, client.request("scan")).state == "done"
    finally:
        daemon.end()


def test_a_killed_worker_is_replaced_and_scans_go_on(tmp_path):
    daemon = Daemon(tmp_path).until_ready().until_worker()
    try:
        with daemon.client() as client:
            os.kill(client.status().workers[0].pid, signal.SIGKILL)
            assert finished(client, client.request("scan")).state == "done"
            assert client.status().workers[0].restarts == 1
    finally:
        daemon.end()


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 8 MB; skipped where mounting is not allowed."""
    folder = tmp_path / "disk"
    folder.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(folder)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        pytest.skip(f"a tmpfs cannot be mounted here: {done.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_fails_the_scan_and_the_daemon_goes_on(tmp_path, small_disk):
    daemon = Daemon(tmp_path, FRINGED_DATA_DIR=str(small_disk)).until_ready().until_worker()
    try:
        with daemon.client() as client:
            assert finished(client, client.request("scan")).state == "done"
            free = shutil.disk_usage(small_disk).free
            (small_disk / "filler").write_bytes(b"x" * (free - 100_000))
            failed = finished(client, client.request("scan"))
            assert failed.error.code == StorageError.__name__, failed
            assert "disk" in failed.error.message or "space" in failed.error.message
            assert not any(small_disk.rglob("*.part"))
            (small_disk / "filler").unlink()
            assert finished(client, client.request("scan")).state == "done"
            assert client.status().counters["handler_failures"] == 0
        assert daemon.end() == 0
    finally:
        daemon.end()
