"""The simulated rig: a scene, a display and a sensor on one clock.

Owns what is in front of the devices and what light falls on the sensor; the devices themselves are in
`fringed.devices`. Safe to use from several threads.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from functools import cached_property
from math import cos, pi
from typing import Any

import msgspec
import numpy as np

from fringed.config.simulated import SceneConfig, SimulationConfig
from fringed.data import Array, Calibration, CameraSettings, Channel, Float64Array, Mesh, PatternSequence, Truth
from fringed.errors import DeviceError
from fringed.simulation import optics
from fringed.simulation.clock import VirtualClock
from fringed.simulation.display import Display, Picture
from fringed.simulation.faults import Faults
from fringed.simulation.frames import exposed
from fringed.simulation.geometry import Geometry, blur_sigmas_px, trace, truth_of
from fringed.simulation.heap import return_memory
from fringed.simulation.light import Light, channel_mix, light_of, widened
from fringed.simulation.printing import apply_print
from fringed.simulation.scene import REFERENCE, Scene, build_scene, reference_solid, solid_of
from fringed.simulation.sensor import RGB, Sensor
from fringed.simulation.tone import response

_POSES_KEPT = 2  # the object and the reference plane: some 40 MB each at full size
_LIGHTS_KEPT = 6


class SimulatedRig:
    """Everything that a simulated camera and projector share.

    Raises
    ------
    ConfigurationError, DataError
        the configured scene cannot be.
    """

    def __init__(self, config: SimulationConfig, mesh: Mesh | None = None) -> None:
        self.config = config
        self.clock = VirtualClock(config.real_time)
        self.faults = Faults(config.faults, config.seed)
        self.sensor = Sensor(config)
        self._idle = Picture(np.zeros((1, 1, 1), np.uint8))
        self.display = Display(config.projector, self.clock, self._idle)
        self._sigmas = blur_sigmas_px(config)
        self._response = response(config.projector)
        self._lock = threading.RLock()
        self._geometries: OrderedDict[Any, Geometry] = OrderedDict()
        self._lights: OrderedDict[tuple[Picture, Channel], Light] = OrderedDict()
        self._pictures: tuple[Picture, ...] = ()
        self._role = ""
        self._set_start_s = self.clock.now()
        self.counter = 0  # of the camera: it never starts again, so that no two frames have the same noise
        self._scene = self._built(config.scene, mesh)

    @cached_property
    def identity(self) -> str:
        """A name that is another one when lenses, their places or their sizes are."""
        sizes = (self.config.sensor.width_px, self.config.sensor.height_px,
                 self.config.projector.width_px, self.config.projector.height_px)  # fmt: skip
        digest = hashlib.sha256(msgspec.json.encode((self.config.geometry, sizes))).hexdigest()[:8]
        return f"simulated-{digest}"

    def calibration(self) -> Calibration:
        """Return the calibration that describes this rig without error; it does not change with the scene."""
        return self._calibration

    @cached_property
    def _calibration(self) -> Calibration:
        return optics.exact_calibration(self.config, self.identity)

    def order_fault(self, name: str, count: int = 1) -> None:
        """Let the next `count` occasions for a fault be struck; raises UsageError for one that is unknown."""
        self.faults.order(name, count)

    # The scene.

    def set_scene(self, config: SceneConfig, mesh: Mesh | None = None) -> None:
        """Put another scene in front of the rig; `mesh` is the object that a plug-in made.

        Raises
        ------
        ConfigurationError, DataError
            the scene cannot be; the old one stays.
        """
        self._scene = self._built(config, mesh)  # without the lock: who holds it may be tracing, or compiling, for long

    def _built(self, config: SceneConfig, mesh: Mesh | None) -> Scene:
        return build_scene(config, self.config.geometry.working_distance_mm, mesh)

    @property
    def scene(self) -> SceneConfig:
        """The scene in front of the rig."""
        return self._scene.config

    def truth(self) -> Truth:
        """Return what every pixel sees, for the role of the last set; a moving object stands where the set began."""
        with self._lock:
            scene = self._scene
            geometry = self._geometry(scene, self._set_start_s)
            about = {**msgspec.to_builtins(scene.config), "role": self._role}
        return truth_of(self.config, geometry, about)

    def _geometry(self, scene: Scene, time_s: float) -> Geometry:
        for stale in [key for key in self._geometries if key[0] is not scene]:
            del self._geometries[stale]
        moved = np.zeros(3)
        if scene.moves and not self._sees_reference:
            moved = np.array(scene.config.velocity_mm_s) * (time_s - self._set_start_s)
        key = (scene, self._sees_reference, *moved)
        if key not in self._geometries:
            self._geometries[key] = self._traced(scene, moved)
            return_memory()
        self._geometries.move_to_end(key)
        while len(self._geometries) > (1 if scene.moves else _POSES_KEPT):
            self._geometries.popitem(last=False)
        return self._geometries[key]

    @property
    def _sees_reference(self) -> bool:
        """Whether the set's role is the reference plane, at whatever exposure (`reference-long`)."""
        return self._role.partition("-")[0] == REFERENCE

    def _traced(self, scene: Scene, moved_mm: Float64Array) -> Geometry:
        pose = scene.T_camera_object(moved_mm)
        solid = reference_solid(self.config) if self._sees_reference else solid_of(scene, pose)
        light = (scene.config.specular, scene.config.ambient)
        geometry = trace(self.config, solid, light, self.sensor.sensitivity(), pose)
        if scene.shape.printed is not None and not self._sees_reference:
            apply_print(geometry, scene.shape.printed, optics.packed(optics.camera_lens(self.config)))
        return geometry

    # The projector.

    def load(self, sequence: PatternSequence, role: str) -> None:
        """Prepare a set's patterns; a moving object starts from its place. "reference" shows the reference plane.

        Raises
        ------
        DeviceError
            the patterns are made for a projector of another size.
        """
        optics_ = self.config.projector
        size = (optics_.width_px, optics_.height_px)
        if (sequence.width_px, sequence.height_px) != size:
            raise DeviceError(
                f"the patterns are {sequence.width_px} x {sequence.height_px}; the simulated projector is "
                f"{size[0]} x {size[1]}: encode them for it"
            )
        with self._lock:
            self._pictures = tuple(Picture(pattern) for pattern in sequence.patterns)
            self._role = role
            self._set_start_s = self.clock.now()

    def show(self, index: int) -> float:
        """Show pattern `index` of the loaded set and return the time of its flip."""
        if not 0 <= index < len(self._pictures):
            raise DeviceError(f"pattern {index} is asked for; {len(self._pictures)} are loaded")
        late_s = self.config.sensor.period_s if self.faults.strikes("late") else 0.0
        return self.display.show(self._pictures[index], late_s)

    def idle(self) -> None:
        """Show black."""
        self.display.show(self._idle)

    # The camera.

    def image(self, start_s: float, end_s: float, settings: CameraSettings, counter: int) -> Array:
        """Return the frame that integrates from `start_s` to `end_s`, with the faults that the light may have.

        `(height, width)`, or for channel "rgb" `(height, width, 3)`: three CCDs behind one lens, one exposure.
        """
        shares, torn_px = self._shown(start_s, end_s)
        channels: tuple[Channel, ...] = RGB if settings.channel == "rgb" else (settings.channel,)
        with self._lock:
            geometry = self._geometry(self._scene, (start_s + end_s) / 2)
            seen = [self._electrons(geometry, shares, (start_s, end_s), channel) for channel in channels]
            if torn_px is not None:
                before = [(1.0, self.display.previous(start_s))]
                old = [self._electrons(geometry, before, (start_s, end_s), channel) for channel in channels]
                seen = [np.where(geometry.row < torn_px, *both) for both in zip(seen, old, strict=True)]
        if settings.channel != "rgb":
            return self.sensor.digitise(seen[0], settings, counter)
        frames = [self.sensor.digitise(one, settings, counter, ccd) for one, ccd in zip(seen, RGB, strict=True)]
        return np.stack(frames, axis=-1)

    def _shown(self, start_s: float, end_s: float) -> tuple[list[tuple[float, Picture]], float | None]:
        """Return the share of each picture in an exposure, and the projector row from which an older one is seen."""
        shares = self.display.weights(start_s, end_s)
        awaited = self.display.is_awaited(start_s)
        torn = awaited and self.faults.strikes("torn")
        if awaited and self.faults.strikes("blended"):
            old = self.faults.draw("blended", 0.3, 0.7)
            shares = [((1 - old) * share, picture) for share, picture in shares]
            shares.append((old, self.display.previous(start_s)))
        return shares, self.faults.draw("torn", 0.4, 0.6) * self.config.projector.height_px if torn else None

    def _electrons(
        self, geometry: Geometry, shares: list[tuple[float, Picture]], span_s: tuple[float, float], channel: Channel
    ) -> Array:
        lights = [(share, self._light(picture, channel)) for share, picture in shares]
        white = self.sensor.electrons((span_s[1] - span_s[0]) * 1e6)
        return exposed(geometry, lights, (white * self._flicker(*span_s), white), self.config.sensor.blur_px)

    def _light(self, picture: Picture, channel: Channel) -> Light:
        key = (picture, channel)
        if key not in self._lights:
            mix = channel_mix(self.config.sensor.crosstalk, channel)
            pattern = widened(picture.pattern, self.config.projector.width_px)
            displaced = self.config.projector.misconvergence_px
            self._lights[key] = light_of(pattern, mix, self._response, (self._sigmas, displaced))
        self._lights.move_to_end(key)
        while len(self._lights) > _LIGHTS_KEPT:
            self._lights.popitem(last=False)
        return self._lights[key]

    def _flicker(self, start_s: float, end_s: float) -> float:
        """Return the lamp's mean brightness over an exposure; it swings at twice the mains."""
        omega = 2 * pi * 2 * self.config.projector.mains_hz
        swing = (cos(omega * start_s) - cos(omega * end_s)) / (omega * (end_s - start_s))
        return 1 + self.config.projector.flicker * swing

    def warm_up(self) -> None:
        """Compute now what the first frame would wait for: compiled kernels, fixed pattern, geometry."""
        with self._lock:
            settings = self.sensor.in_force(CameraSettings(channel="green"))
            geometry = self._geometry(self._scene, self.clock.now())
            electrons = self._electrons(geometry, [(1.0, self._idle)], (0.0, 1e-3), "green")
        self.sensor.digitise(electrons, settings, 0)
        del electrons
        return_memory()
