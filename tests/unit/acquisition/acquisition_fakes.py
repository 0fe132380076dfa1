"""An analytic scene, and a tiny physically honest rig on a virtual clock, independent of the simulator."""

from __future__ import annotations

import math
import threading
import time

import numpy as np

from fringed.data import CameraSettings, PatternFrame, PatternSequence
from fringed.errors import DeviceAbsent, DeviceStalled
from fringed.hookspecs import RawFrame, Setting

WIDTH, HEIGHT = 256, 192
SHAPE = (60, 80)
NOISY = CameraSettings(exposure_us=8000.0, electrons_per_dn=51.0, read_noise_electrons=12.0)


def sinusoids(periods=(1, 4, 16), steps=4, orientation="columns"):
    extent = WIDTH if orientation == "columns" else HEIGHT
    frames, patterns = [], []
    for group, count in enumerate(periods):
        for step in range(steps):
            shift = 2 * np.pi * step / steps
            frame = PatternFrame("sinusoid", orientation, extent / count, shift, 0.0, step, steps, group)
            wave = 127.5 + 127.5 * np.cos(2 * np.pi * np.arange(extent) / frame.period_px + shift)
            frames.append(frame)
            shape = (1, -1, 1) if orientation == "columns" else (-1, 1, 1)
            patterns.append(np.round(wave).astype(np.uint8).reshape(shape))
    return PatternSequence("test", WIDTH, HEIGHT, tuple(frames), tuple(patterns), precompensated=True)


class Scene:
    """What each camera pixel sees of the panel: column, row and albedo."""

    def __init__(self, shape=SHAPE, albedo=0.8, kind="object"):
        y, x = np.mgrid[: shape[0], : shape[1]]
        y, x = y / shape[0], x / shape[1]
        self.column = 15 + 215 * x
        self.row = 12 + 165 * y
        self.albedo = np.full(shape, albedo)
        if kind == "object":  # a bump in front of a black backdrop, with an edge
            radius = np.hypot((x - 0.5) * 1.3, y - 0.5)
            self.column = self.column + 30 * np.sqrt(np.maximum(0.2 - radius**2, 0))
            self.albedo = np.where(radius < 0.42, albedo * (0.8 + 0.2 * np.sin(9 * x) * np.cos(7 * y)), 0.01)

    def light(self, sequence, index, gamma=1.0):
        """Mean grey level under pattern `index`; -1 is the idle picture."""
        if index < 0:
            relative = np.zeros_like(self.albedo)
        else:
            frame = sequence.frames[index]
            if frame.style in ("black", "white"):
                relative = np.full_like(self.albedo, float(frame.style == "white"))
            else:
                place = self.column if frame.orientation == "columns" else self.row
                relative = (0.5 + 0.5 * np.cos(2 * np.pi * place / frame.period_px + frame.shift_rad)) ** gamma
        return 2 + 200 * self.albedo * (0.03 + 0.0025 + 0.9975 * relative)


def exposed(light, rng):
    """A frame of `light` from a sensor of 51 e-/DN and 12 e- read noise."""
    electrons = light * 51
    electrons = electrons + rng.standard_normal(light.shape) * np.sqrt(electrons + 144)
    return np.clip(np.round(electrons / 51), 0, 255).astype(np.uint8)


class VirtualClock:
    def __init__(self):
        self.time_s = 100.0

    def now(self):
        return self.time_s

    def sleep(self, seconds):
        self.time_s += max(seconds, 0.0)


class FakeRig:
    """Display and camera of one scene. `faults` lists (what, frame number) that strike once each."""

    def __init__(self, scene=None, latency_s=0.034, decay_s=0.0015, period_s=0.1335, readout_s=0.002, seed=0):
        self.clock = VirtualClock()
        self.scene = scene or Scene()
        self.rng = np.random.default_rng(seed)
        self.latency_s, self.decay_s, self.period_s, self.readout_s = latency_s, decay_s, period_s, readout_s
        self.sequence, self.role, self.roles = None, "", []
        self.timeline = [(-math.inf, None, -1)]  # since when, sequence, pattern
        self.orders = []
        self.brightness = 50
        self.present = {"camera": True, "projector": True}
        self.opened = {"camera": 0, "projector": 0}
        self.threads = set()
        self.camera, self.projector = FakeCamera(self), FakeProjector(self)

    def order(self, fault, count=1):
        self.orders += [fault] * count

    def strikes(self, fault):
        if fault in self.orders:
            self.orders.remove(fault)
            return True
        return False

    def touched(self, which):
        self.threads.add(threading.current_thread().name)
        if not self.present[which]:
            raise DeviceAbsent(f"the fake {which} is not there")

    def light(self, start_s, end_s):
        """Mean over the exposure, by quadrature: no formula of the code under test."""
        total = 0.0
        for time_s in np.linspace(start_s, end_s, 9):
            past = [entry for entry in self.timeline if entry[0] <= time_s]
            shown = self.scene.light(*past[-1][1:])
            if len(past) > 1:
                left = math.exp(-(time_s - past[-1][0]) / self.decay_s)
                shown = shown + left * (self.scene.light(*past[-2][1:]) - shown)
            total = total + shown
        return total / 9


class FakeProjector:
    simulated = True
    size_px = (WIDTH, HEIGHT)

    def __init__(self, rig):
        self.rig = rig

    def open(self):
        self.rig.touched("projector")
        self.rig.opened["projector"] += 1
        return "fake projector"

    def close(self):
        pass

    def load(self, sequence, role):
        self.rig.touched("projector")
        self.rig.sequence, self.rig.role = sequence, role
        self.rig.roles.append(role)

    def show(self, index):
        self.rig.touched("projector")
        late_s = self.rig.period_s if self.rig.strikes("late") else 0.0
        return self._flip(index, late_s)

    def idle(self):
        self.rig.touched("projector")
        self._flip(-1, 0.0)

    def check(self):
        self.rig.touched("projector")

    def settings(self):
        self.rig.touched("projector")
        return [
            Setting("brightness", self.rig.brightness, "%", 0, 100),
            Setting("input", "rgb1", choices=("rgb1", "rgb2")),
            Setting("lamp_hours", 120.5, "h", writable=False),
        ]

    def adjust(self, name, value):
        self.rig.touched("projector")
        assert name == "brightness"
        self.rig.brightness = value

    def _flip(self, index, late_s):
        rig = self.rig
        flip_s = (math.floor(rig.clock.now() * 60 + 1e-6) + 1) / 60
        rig.clock.time_s = flip_s
        since_s = flip_s + rig.latency_s + late_s
        rig.timeline = [entry for entry in rig.timeline if entry[0] < since_s][-8:]
        rig.timeline.append((since_s, rig.sequence, index))
        return flip_s


class FakeCamera:
    simulated = True
    replayed = False

    def __init__(self, rig):
        self.rig = rig
        self.clock = rig.clock
        self.size_px = (rig.scene.albedo.shape[1], rig.scene.albedo.shape[0])
        self.settings = None
        self.last = None
        self.blocking = threading.Event()

    @property
    def period_s(self):
        return self.rig.period_s

    def open(self):
        self.rig.touched("camera")
        self.rig.opened["camera"] += 1
        return "fake camera"

    def close(self):
        self.settings = None

    def arm(self, settings):
        self.rig.touched("camera")
        self.zero_s, self.next, self.triggered = self.clock.now(), 0, []
        self.settings = CameraSettings(settings.exposure_us, trigger=settings.trigger, electrons_per_dn=51.0,
                                       read_noise_electrons=12.0)  # fmt: skip
        return self.settings

    def disarm(self):
        self.settings = None

    def trigger(self):
        self.rig.touched("camera")
        self.triggered.append(self.clock.now())

    def read(self, timeout_s):
        rig = self.rig
        rig.touched("camera")
        if rig.strikes("vanish"):
            raise DeviceAbsent("the fake camera was pulled")
        if rig.strikes("crash"):
            raise ZeroDivisionError("a bug of the driver")
        if rig.strikes("stall"):
            self.clock.sleep(timeout_s)
            raise DeviceStalled("silence")
        if self.blocking.is_set():  # real time passes
            time.sleep(0.02)
        exposure_s = self.settings.exposure_us * 1e-6
        if self.settings.trigger == "free-running":
            if rig.strikes("dropped"):
                self.next += 1
            start_s = self.zero_s + self.next * rig.period_s
        else:
            start_s = self.triggered.pop(0)
        self.clock.time_s = max(self.clock.time_s, start_s + exposure_s + rig.readout_s)
        counter, self.next = self.next, self.next + 1
        return RawFrame(self._picture(start_s, start_s + exposure_s), counter, start_s, start_s + exposure_s)

    def _picture(self, start_s, end_s):
        rig = self.rig
        light = rig.light(start_s, end_s)
        before = rig.scene.light(*rig.timeline[max(len(rig.timeline) - 2, 0)][1:])
        if rig.strikes("blended"):
            light = 0.5 * light + 0.5 * before
        if rig.strikes("torn"):
            light = np.concatenate([light[:30], before[30:]])
        if rig.strikes("repeated"):
            return self.last
        self.last = exposed(light, rig.rng)
        return self.last[:7] if rig.strikes("garbage") else self.last
