"""The video output on a real X server whose frame buffer is mapped: what is scanned out, not what is claimed."""

import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest

import xvfb
from fringed.config import validate
from fringed.data import PatternFrame, PatternSequence
from fringed.devices.building import DriverContext
from fringed.devices.camera.base import MachineClock
from fringed.devices.projector.window import WINDOW, WindowOptions, WindowProjector, displays, environment_of
from fringed.display.picture import BRIGHT, DIM, grid
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.one_shot import OneShotPhaseShiftEncoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder

SIZE = WIDTH, HEIGHT = 1024, 768
FRAME_S = 1 / 60
pytestmark = pytest.mark.skipif(not xvfb.available(), reason=xvfb.MISSING)


def window(cable, **options):
    return WindowProjector(WindowOptions(**{"x_display": cable.display, "backend": "x11", **options}), "bench-3")


@pytest.fixture(scope="module")
def station_cable(tmp_path_factory):
    """One head for the module; its name makes the check for leaks count it as there before."""
    with xvfb.Xvfb(tmp_path_factory.mktemp("xvfb"), SIZE) as cable:
        yield cable


@pytest.fixture(scope="module")
def station_window(station_cable):
    projector = window(station_cable, grid_after_s=3600)
    projector.open()
    yield projector
    projector.close()


@pytest.fixture
def cable(tmp_path):
    with xvfb.Xvfb(tmp_path / "xvfb", SIZE) as made:
        yield made


def sequence_of(*patterns):
    return PatternSequence("flat", *SIZE, tuple(PatternFrame("flat") for _ in patterns), patterns)


def flat(*levels):
    return sequence_of(*(np.full((1, 1, 1), level, np.uint8) for level in levels))


def full(pattern):
    return np.broadcast_to(pattern, (HEIGHT, WIDTH, 3))


@pytest.mark.parametrize("channels", [(0,), (1,), (2,), (0, 1, 2)], ids=["red", "green", "blue", "grey"])
def test_256_of_256_levels_of_each_channel_reach_the_cable(station_cable, station_window, channels):
    ramps = np.zeros((2, WIDTH, 3), np.uint8)
    ramps[0][:, channels] = (np.arange(WIDTH) % 256)[:, None]
    ramps[1] = ramps[0, ::-1]
    station_window.load(sequence_of(*(ramp[None] for ramp in ramps)), "object")
    for index, ramp in enumerate(ramps):
        station_window.show(index)
        seen = station_cable.picture()
        assert np.array_equal(seen, full(ramp))
        assert all(len(np.unique(seen[..., channel])) == 256 for channel in channels)


@pytest.mark.parametrize("orientation", ["columns", "rows"])
def test_every_pattern_of_a_12_frame_multi_frequency_set_is_exact(station_cable, station_window, orientation):
    params = validate({"orientation": orientation}, MultiFrequencyEncoder.Params)
    sequence = MultiFrequencyEncoder().encode(params, ProjectorTarget(*SIZE))
    assert len(sequence.patterns) == 12
    station_window.load(sequence, "object")
    flips = []
    for index, pattern in enumerate(sequence.patterns):
        asked = time.monotonic()
        flips.append(station_window.show(index))
        assert asked < flips[-1] <= time.monotonic()
        assert np.array_equal(station_cable.picture(), full(pattern))
    assert np.diff(flips).min() >= FRAME_S * 0.9  # no pattern is there for less than a frame


def test_colour_patterns_are_exact(station_cable, station_window):
    params = validate({}, OneShotPhaseShiftEncoder.Params)
    sequence = OneShotPhaseShiftEncoder().encode(params, ProjectorTarget(*SIZE))
    assert {pattern.shape[2] for pattern in sequence.patterns} == {3}
    station_window.load(sequence, "object")
    for index, pattern in enumerate(sequence.patterns):
        station_window.show(index)
        assert np.array_equal(station_cable.picture(), full(pattern))


def test_a_pattern_of_every_pixel_is_exact(station_cable, station_window):
    noise = np.random.default_rng(5).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    station_window.load(sequence_of(noise, noise[::-1, :, :1]), "object")
    for index, wanted in enumerate((noise, noise[::-1, :, :1])):
        station_window.show(index)
        assert np.array_equal(station_cable.picture(), full(wanted))


def test_flips_that_follow_no_refresh_are_measured_and_said(station_window):
    assert station_window.ready.depth == -1  # Xvfb has no refresh, whatever SDL says
    assert station_window.ready.interval_s > 0
    assert "not timed by the refresh" in station_window.open()
    assert any("[A]" in warning for warning in station_window.ready.warnings)


def test_a_display_without_refresh_is_refused_where_one_is_required(station_cable):
    with pytest.raises(DeviceAbsent, match=r"do not follow the display's refresh.*'required'"):
        window(station_cable, vsync="required").open()


def test_what_is_not_loaded_or_made_for_another_size_is_refused(station_window):
    station_window.load(flat(0), "object")
    with pytest.raises(DeviceError, match="pattern 1 is asked for; 1 are loaded"):
        station_window.show(1)
    other = PatternSequence("flat", 912, 1140, (PatternFrame("flat"),), (np.zeros((1, 1, 1), np.uint8),))
    with pytest.raises(DeviceError, match="patterns are 912 x 1140; the projector's panel is 1024 x 768"):
        station_window.load(other, "object")


def test_idle_is_dark_at_once_and_a_dim_grid_with_text_a_while_later(cable):
    projector = window(cable, grid_after_s=0.2, idle_text="{station}\n{host} {address}")
    try:
        projector.open()
        plain = np.broadcast_to(grid(SIZE), (HEIGHT, WIDTH, 3))
        first = cable.picture()
        assert set(np.unique(first)) == {0, DIM, BRIGHT}
        assert np.count_nonzero(first != plain) > 300  # the text
        assert np.array_equal(first[: HEIGHT // 2], plain[: HEIGHT // 2])
        projector.load(flat(255), "object")
        projector.show(0)
        projector.idle()
        assert wait(lambda: np.array_equal(cable.picture(), first), projector.check)
        projector.show(0)
        assert (cable.picture() == 255).all()
    finally:
        projector.close()


def test_darkness_comes_with_idle(station_cable, station_window):
    station_window.load(flat(255), "object")
    station_window.show(0)
    station_window.idle()
    assert not station_cable.picture().any()


def test_a_desktop_of_another_size_is_refused_with_both_sizes(tmp_path):
    with xvfb.Xvfb(tmp_path / "xvfb", (1280, 800)) as cable:
        projector = window(cable)
        with pytest.raises(DeviceAbsent, match=r"desktop of 1280 x 800; the patterns need 1024 x 768"):
            projector.open()
        assert projector.pid == 0
        other = window(cable, size_px=(1280, 800))
        other.open()
        other.close()


def test_a_desktop_of_16_bits_is_refused(tmp_path):
    with xvfb.Xvfb(tmp_path / "xvfb", SIZE, depth=16) as cable:
        with pytest.raises(DeviceAbsent, match="5, 6 and 5 bits"):
            window(cable).open()


def test_displays_are_told_apart(station_cable, station_window, tmp_path):
    with xvfb.Xvfb(tmp_path / "second", SIZE) as cable:
        second = window(cable)
        try:
            second.open()
            for projector, level in ((station_window, 10), (second, 200)):
                projector.load(flat(level), "object")
                projector.show(0)
            assert (station_cable.picture() == 10).all()
            assert (cable.picture() == 200).all()
        finally:
            second.close()


def test_a_display_that_does_not_exist_is_named(station_cable):
    with pytest.raises(DeviceAbsent, match=r"no display 'HDMI-7'; x11 has: 0 '.*' 1024 x 768"):
        window(station_cable, display="HDMI-7").open()


def test_the_displays_are_listed_for_whoever_asks(station_cable, tmp_path):
    options = WindowOptions(x_display=station_cable.display)
    found = displays(options)
    assert (found.backend, found.problem) == ("x11", "")
    assert [(one.index, one.size_px) for one in found.displays] == [(0, SIZE)]
    assert "no X server answers" in displays(WindowOptions(x_display=":987")).problem
    command = [sys.executable, "-m", "fringed.display", "--list", "x11"]
    ran = subprocess.run(command, env=environment_of(options), capture_output=True, text=True, check=True)
    assert ran.stdout.startswith(f"backend x11\ndisplay 0 '{found.displays[0].name}' 1024 x 768, ")
    assert subprocess.run(command[:3], capture_output=True, text=True, check=False).stderr.startswith("usage")


LOCKED = """
import os, sys
import msgspec, numpy as np
from fringed.display import pacing
from fringed.display.environment import ENVIRONMENT
from fringed.display.messages import Setup
os.environ.update(ENVIRONMENT)
pacing.measured = lambda *_: pacing.Pace(1 / 60, 0.0, int(sys.argv[3]))  # as if there were a refresh
from fringed.display.window import Window
window = Window(msgspec.json.decode(sys.argv[1], type=Setup))
print(window.open().renderer, flush=True)
window.load(list(np.load(sys.argv[2]).values()))
for index in map(int, sys.stdin):
    print(window.show(index), flush=True)
window.close()
"""


@pytest.mark.parametrize("depth", [0, 1])
def test_the_way_through_the_graphics_card_is_exact_too(station_cable, tmp_path, depth):
    """The way of a display with a refresh, which Xvfb lacks: taken here as if it had one."""
    patterns = [np.random.default_rng(k).integers(0, 256, (1, WIDTH, 3)).astype(np.uint8) for k in range(6)]
    np.savez(tmp_path / "patterns.npz", *patterns)
    options = WindowOptions(x_display=station_cable.display, backend="x11")
    setup = msgspec.json.encode(WindowProjector(options).setup()).decode()
    command = [sys.executable, "-c", LOCKED, setup, str(tmp_path / "patterns.npz"), str(depth)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
    with subprocess.Popen(command, env=environment_of(options), **pipes) as process:
        assert process.stdout.readline().strip() not in ("", "copy")
        for index, pattern in enumerate(patterns):
            process.stdin.write(f"{index}\n")
            assert float(process.stdout.readline()) > 0
            assert wait(partial(scanned_out, station_cable, full(pattern)))
        process.stdin.close()


def test_no_x_server_says_what_to_set():
    with pytest.raises(DeviceAbsent, match=r"DISPLAY=':987'.*x_display"):
        WindowProjector(WindowOptions(x_display=":987", backend="x11")).open()


def wait(reached, look=lambda: None, patience_s=30):
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline:
        if reached():
            return True
        look()
        time.sleep(0.02)
    return False


def scanned_out(cable, wanted):
    return np.array_equal(cable.picture(), wanted)


def lost(projector):
    """Wait until the driver says by itself that the display has gone; return what it says."""
    with pytest.raises(DeviceAbsent) as caught:
        wait(lambda: False, projector.check)
    return caught.value.message


def test_a_killed_display_process_is_absent_at_once_and_the_next_open_works(station_cable):
    projector = window(station_cable)
    try:
        projector.open()
        projector.load(flat(90, 91), "object")
        first = projector.pid
        os.kill(first, signal.SIGKILL)
        with pytest.raises(DeviceAbsent, match=f"display process {first} was killed by SIGKILL"):
            projector.show(0)
        with pytest.raises(DeviceAbsent, match="was killed by SIGKILL"):
            projector.check()
        projector.open()
        assert projector.pid not in (0, first)
        with pytest.raises(DeviceError, match="none are loaded"):
            projector.show(0)
        projector.load(flat(90, 91), "object")
        projector.show(1)
        assert (station_cable.picture() == 91).all()
    finally:
        projector.close()


def test_a_process_that_hangs_is_ended_and_the_next_open_works(station_cable):
    projector = window(station_cable, timeout_s=0.5)
    try:
        projector.open()
        projector.load(flat(7), "object")
        first = projector.pid
        os.kill(first, signal.SIGSTOP)
        with pytest.raises(DeviceStalled, match=r"did not answer within 0.5 s \(the command 'show'\)"):
            projector.show(0)
        assert not Path(f"/proc/{first}").exists()
        projector.open()
        projector.check()
    finally:
        projector.close()


def test_an_x_server_that_ends_is_said_without_being_asked_and_the_next_one_serves(tmp_path):
    cable = xvfb.Xvfb(tmp_path / "first", SIZE)
    projector = window(cable)
    try:
        projector.open()
        cable.unplug()
        assert re.search("X server|X connection", lost(projector))
        with pytest.raises(DeviceAbsent, match="no X server answers"):
            projector.open()
    finally:
        projector.close()
        cable.close()


def connector(folder, status):
    path = folder / "card0-HDMI-A-1"
    path.mkdir(exist_ok=True, parents=True)
    (path / "modes").write_text("1024x768\n800x600\n")
    (path / "status").write_text(f"{status}\n")


def test_an_unplugged_display_is_said_at_once_and_opens_again_when_plugged(station_cable, tmp_path):
    """The kernel's list of connectors is a folder of ours; the watch is the real one."""
    connector(tmp_path, "connected")
    projector = window(station_cable, drm_folder=str(tmp_path), connector="card0-HDMI-A-1")
    try:
        assert "on card0-HDMI-A-1" in projector.open()
        connector(tmp_path, "disconnected")
        assert "unplugged from card0-HDMI-A-1" in lost(projector)
        with pytest.raises(DeviceAbsent, match="nothing is plugged into connector 'card0-HDMI-A-1'"):
            projector.open()
        connector(tmp_path, "connected")
        projector.open()
        projector.load(flat(33), "object")
        projector.show(0)
        assert (station_cable.picture() == 33).all()
    finally:
        projector.close()


ORPHAN = """
import sys, time
from fringed.devices.projector.window import WindowOptions, WindowProjector
projector = WindowProjector(WindowOptions(x_display=sys.argv[1], backend="x11"))
projector.open()
print(projector.pid, flush=True)
time.sleep(300)
"""


@pytest.mark.parametrize("stopped", [False, True], ids=["running", "hanging"])
def test_no_display_process_outlives_its_daemon(station_cable, stopped):
    daemon = subprocess.Popen([sys.executable, "-c", ORPHAN, station_cable.display], stdout=subprocess.PIPE)
    try:
        pid = int(daemon.stdout.readline())
        if stopped:
            os.kill(pid, signal.SIGSTOP)
        daemon.kill()
        assert wait(lambda: ended(pid))
    finally:
        daemon.kill()
        daemon.wait(10)
        daemon.stdout.close()


def ended(pid):
    try:
        return ") Z" in Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return True


def test_the_driver_is_built_from_its_options_and_the_station(station_cable):
    options = validate({"x_display": station_cable.display, "size_px": list(SIZE)}, WINDOW.Options)
    projector = WINDOW.create(options, DriverContext("bench-3", MachineClock()))
    assert (WINDOW.name, projector.simulated, projector.size_px) == ("window", False, SIZE)
    projector.close()
    with pytest.raises(DeviceAbsent, match="closed"):
        projector.idle()


def test_opening_and_closing_leaves_no_descriptor_and_warns_once(station_cable, caplog):
    projector = window(station_cable)
    projector.open()
    projector.close()
    assert len(caplog.records) == 1
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(3):
        projector.open()
        projector.load(flat(1), "object")
        projector.close()
    assert len(list(Path("/proc/self/fd").iterdir())) == before
    assert len(caplog.records) == 1


def test_signals_for_the_daemon_leave_the_window_to_it(station_cable, station_window):
    pid = station_window.pid
    os.kill(pid, signal.SIGINT)
    os.kill(pid, signal.SIGTERM)
    station_window.check()
    station_window.load(flat(12), "object")
    station_window.show(0)
    assert station_window.pid == pid
    assert (station_cable.picture() == 12).all()
