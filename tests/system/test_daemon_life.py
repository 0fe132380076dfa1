"""The daemon's life: ready, watched, reloaded, refused a second time, ended."""

import signal
import subprocess
import sys
import time

import pytest
from daemonkit import SMALL, Daemon

from fringed.errors import FringedError


@pytest.fixture
def daemon(tmp_path):
    made = Daemon(tmp_path)
    yield made
    made.end()


def test_it_notifies_ready_then_feeds_the_watchdog_and_says_simulated_everywhere(tmp_path):
    daemon = Daemon(tmp_path, WATCHDOG_USEC="400000")
    try:
        ready = daemon.notified()
        assert ready.startswith("READY=1")
        assert "SIMULATED" in ready
        assert [daemon.notified(5.0) for _ in range(3)] == ["WATCHDOG=1"] * 3
        with daemon.client() as client:
            state = client.status()
            assert client.hello["simulated"] is True
        assert state.simulated
        assert state.camera.driver == "sim"
        assert "SIMULATED" in daemon.log
        assert (tmp_path / "run").stat().st_mode & 0o777 == 0o700
        daemon.send(signal.SIGSTOP)  # a loop that stands still feeds nobody
        time.sleep(0.1)
        while True:
            try:
                daemon.notify.settimeout(0.6)
                daemon.notify.recv(4096)
            except TimeoutError:
                break
        daemon.send(signal.SIGCONT)
        assert daemon.notified(5.0) == "WATCHDOG=1"
    finally:
        daemon.end()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly_within_five_seconds(daemon, number):
    daemon.until_ready()
    begun = time.monotonic()
    assert daemon.end(number) == 0
    assert time.monotonic() - begun < 5.0
    assert not (daemon.runtime / "control").exists()
    assert not any(daemon.folder.rglob("*.part"))


def test_it_ends_in_time_in_the_middle_of_a_scan(daemon):
    daemon.until_ready().until_worker()
    with daemon.client() as client:
        client.request("scan")
        begun = time.monotonic()
        assert daemon.end() == 0
    assert time.monotonic() - begun < 5.0
    assert not any(daemon.folder.rglob("*.part"))


def test_a_second_daemon_is_refused_with_the_process_of_the_first(daemon):
    daemon.until_ready()
    command = [sys.executable, "-m", "fringed", "run", "--config", str(daemon.config)]
    second = subprocess.run(command, env=daemon.env, capture_output=True, text=True, timeout=30, check=False)
    assert second.returncode == 3
    assert f"process {daemon.process.pid} already serves" in second.stderr
    assert "Traceback" not in second.stderr
    with daemon.client() as client:
        assert client.status().pid == daemon.process.pid


def test_after_a_kill_the_next_start_needs_no_hand(tmp_path):
    first = Daemon(tmp_path).until_ready()
    first.end(signal.SIGKILL)
    assert (tmp_path / "run" / "control").exists()
    second = Daemon(tmp_path).until_ready()
    with second.client() as client:
        assert client.status().pid == second.process.pid
    assert second.end() == 0


def test_a_good_reload_is_applied_and_names_what_needs_a_restart(daemon):
    daemon.until_ready()
    changed = SMALL.replace("retries = 1", "retries = 7").replace("count = 1", "count = 2").replace("160", "168")
    daemon.config.write_text(changed + "[presets.mine]\npipeline = 'thesis'\n")
    daemon.send(signal.SIGHUP)
    daemon.logged("reloaded; applied: ['acquisition.retries', 'presets.mine', 'workers.count']; ")
    daemon.logged("needs a restart: ['simulation.sensor.width_px']")
    with daemon.client() as client:
        config = client.request("config")
        assert len(client.status().workers) == 2
    assert config["acquisition"]["retries"] == 7
    assert config["simulation"]["sensor"]["width_px"] == 160  # still in force


def test_a_bad_reload_changes_nothing_and_is_told(daemon):
    daemon.until_ready()
    daemon.config.write_text(SMALL.replace("retries = 1", "retries = -1") + "nonsense = 3\n")
    daemon.send(signal.SIGHUP)
    daemon.logged("nothing changes")
    assert "acquisition.retries: -1" in daemon.log
    with daemon.client() as client:
        assert client.request("config")["acquisition"]["retries"] == 1
        with pytest.raises(FringedError, match="problem"):
            client.request("reload")


def test_without_a_rig_it_serves_and_a_scan_says_what_is_missing(tmp_path):
    daemon = Daemon(tmp_path, "name = 'bare'\n[workers]\ncount = 0\n").until_ready()
    try:
        with daemon.client() as client:
            assert client.status().camera.state == "ABSENT"
            assert not client.status().simulated
            with pytest.raises(FringedError, match="no rig"):
                client.scan()
            with pytest.raises(FringedError, match="simulated rig"):
                client.request("simulate.fault", fault="late", count=1)
    finally:
        daemon.end()


def test_a_data_folder_that_cannot_be_written_is_told_at_start(tmp_path):
    daemon = Daemon(tmp_path, notify=False, FRINGED_DATA_DIR="/proc/nothing")
    assert daemon.process.wait(20) == 1
    assert "/proc/nothing" in daemon.log
    assert "Traceback" not in daemon.log
    assert not (daemon.runtime / "control").exists()
    daemon.end()
