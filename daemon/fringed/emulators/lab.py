"""A laboratory in which only the photons are simulated: real drivers, a real window, real serial ports.

    python -m fringed.emulators.lab --folder lab        starts it and writes lab/station.toml for `fringed run`

Owns the emulated devices as processes (an X server whose frame buffer is the video cable, a CP-X260 and an MS3100 on
pseudo-terminals) and the USB3 Vision bridge that sits in the daemon as a PyUSB backend, fed by simulated optics from
what the X server scans out.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import msgspec

from fringed.config.simulated import SimulationConfig
from fringed.config.toml_text import dumps
from fringed.data import Array, CameraSettings
from fringed.emulators.framebuffer import FrameBuffer
from fringed.emulators.scanned import ScannedOptics
from fringed.emulators.u3v import EmulatedUsb
from fringed.emulators.u3v_camera import EmulatedU3vCamera
from fringed.emulators.u3v_memory import EmulatedIdentity
from fringed.errors import DeviceAbsent, UsageError

PLACE = "FRINGED_EMULATED_LAB"
_START_S = 60.0
_STOP_S = 5.0
_LAB, _ORDERS = "lab.json", "bridge.orders"
_LOOK_S = 0.02
BRIDGE = "bridge"


class Lab:
    """The emulated devices of a folder; a context, or `start` and `close`."""

    def __init__(self, folder: Path, simulation: Mapping[str, Any] | None = None, warm_up_s: float = 3.0) -> None:
        self.folder = folder.resolve()
        self.simulation = msgspec.convert({**(simulation or {}), "real_time": True}, SimulationConfig)
        self._warm_up_s = warm_up_s
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self.display = ""

    @property
    def environment(self) -> dict[str, str]:
        """What the daemon's environment has to hold beside its own."""
        return {PLACE: str(self.folder / _LAB)}

    @property
    def configuration(self) -> dict[str, Any]:
        """The station's configuration of its devices."""
        sensor, projector = self.simulation.sensor, self.simulation.projector
        panel = [projector.width_px, projector.height_px]
        bridge = {"backend": "fringed.emulators.lab:backend", "full_well_electrons": sensor.full_well_electrons}
        bridge |= {"exposure_feature": ""}  # the MS3100 is told over its own line
        return {
            "name": "emulated-lab",
            "camera": {
                "driver": "duncantech",
                "channel": "green",
                "trigger": "software",
                "options": {
                    "port": str(self.folder / "camera"),
                    "output": "rgb",
                    "trigger_mode": "external",
                    "width_px": sensor.width_px,
                    "height_px": sensor.height_px,
                    "images": {"driver": "usb3vision", "options": bridge},
                },
            },
            "projector": {
                "driver": "hitachi",
                "options": {
                    "port": str(self.folder / "projector"),
                    "panel_px": panel,
                    "output": {"size_px": panel, "backend": "x11", "x_display": self.display},
                },
            },
        }

    def start(self) -> None:
        """Start all of them.

        Raises
        ------
        UsageError
            Xvfb is not installed.
        DeviceAbsent
            one does not start; its log says why.
        """
        if shutil.which("Xvfb") is None:
            raise UsageError("an emulated video cable needs Xvfb (Debian: apt install xvfb)")
        self.folder.mkdir(parents=True, exist_ok=True)
        width, height = self.simulation.projector.width_px, self.simulation.projector.height_px
        read, write = os.pipe()
        screen = ["-displayfd", str(write), "-screen", "0", f"{width}x{height}x24", "-fbdir", str(self.folder)]
        self._run("Xvfb", ["Xvfb", *screen, "-nolisten", "tcp", "-noreset"], (write,))
        os.close(write)
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        if not number:
            raise self._absent("Xvfb")
        self.display = f":{number}"
        python = [sys.executable, "-m"]
        ports = {"projector": self.folder / "projector", "camera": self.folder / "camera"}
        warm = ["--warm-up", str(self._warm_up_s), "--cool-down", str(self._warm_up_s)]
        self._run("cpx260", [*python, "fringed.emulators.cpx260", "--pty", str(ports["projector"]), *warm])
        self._run("ms3100", [*python, "fringed.emulators.ms3100", "--pty", str(ports["camera"])])
        self._await(ports)
        lab = {
            "frame_buffer": str(self.folder / "Xvfb_screen0"),
            "camera": str(self.folder / "ms3100.out"),
            "orders": str(self.folder / _ORDERS),
            "simulation": msgspec.to_builtins(self.simulation),
        }
        (self.folder / _ORDERS).write_text("")
        (self.folder / _LAB).write_text(json.dumps(lab))
        (self.folder / "station.toml").write_text(dumps(self.configuration), encoding="utf-8")

    def order(self, device: str, **order: Any) -> None:
        """Order something of "cpx260" or "ms3100" as their processes take it, or of "bridge".

        The bridge takes `do` = "unplug" or "plug", and any fault of `u3v_faults.Faults` by its name.
        """
        if device == BRIDGE:
            with (self.folder / _ORDERS).open("a") as orders:
                orders.write(json.dumps(order) + "\n")
            return
        stdin = self._processes[device].stdin
        if stdin is not None:
            stdin.write(json.dumps(order).encode() + b"\n")
            stdin.flush()

    def close(self) -> None:
        """End all of them; harmless when ended."""
        for process in reversed(self._processes.values()):
            if process.stdin is not None:
                process.stdin.close()
            process.terminate()
        for process in self._processes.values():
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._processes.clear()

    def __enter__(self) -> Self:
        try:
            self.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self, name: str, command: list[str], pass_fds: tuple[int, ...] = ()) -> None:
        with (self.folder / f"{name}.out").open("wb") as out, (self.folder / f"{name}.log").open("wb") as log:
            self._processes[name] = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=out, stderr=log, pass_fds=pass_fds, start_new_session=True
            )

    def _await(self, ports: Mapping[str, Path]) -> None:
        deadline_s = time.monotonic() + _START_S
        while not all(port.exists() for port in ports.values()):
            for name, process in self._processes.items():
                if process.poll() is not None:
                    raise self._absent(name)
            if time.monotonic() > deadline_s:
                raise DeviceAbsent(f"the emulators made no ports in {self.folder} within {_START_S:g} s")
            time.sleep(0.05)

    def _absent(self, name: str) -> DeviceAbsent:
        said = (self.folder / f"{name}.log").read_text(errors="replace").strip().splitlines()[-1:] or ["nothing"]
        return DeviceAbsent(f"{name} did not start; it says: {said[0]}")


@dataclass
class _Optics:
    """What the bridge's camera sees: exposures are those that the MS3100 was told over its serial line."""

    scanned: ScannedOptics
    told: Path
    camera: EmulatedU3vCamera | None = field(default=None)

    def picture(self, start_s: float, exposure_s: float) -> Array:
        bits = self.camera.bits if self.camera is not None else 8
        exposure_us = self._exposure_us() or exposure_s * 1e6
        self.scanned.settings = CameraSettings(exposure_us, bits=bits, channel="rgb", trigger="software")
        return self.scanned.image(start_s, exposure_us * 1e-6)

    def _exposure_us(self) -> float:
        """Return the integration of the green CCD; 0 where nothing was told yet."""
        for line in reversed(self.told.read_text().splitlines()):
            try:
                said = json.loads(line)
            except ValueError:  # half a line: it is being written
                continue
            if said.get("event") == "settings":
                return float(said["ccds"]["green"]["integration_us"])
        return 0.0


def backend() -> EmulatedUsb:
    """Return a USB bus with the bridge on it; made in the daemon, of the laboratory that the environment names.

    Raises
    ------
    UsageError
        the environment names none.
    """
    place = os.environ.get(PLACE, "")
    if not place:
        raise UsageError(f"{PLACE} is not set: start `python -m fringed.emulators.lab` first, it tells what to set")
    lab = json.loads(Path(place).read_text())
    simulation = msgspec.convert(lab["simulation"], SimulationConfig)
    scanned = ScannedOptics(simulation, FrameBuffer(Path(lab["frame_buffer"])))
    scanned.start()
    optics = _Optics(scanned, Path(lab["camera"]))
    identity = EmulatedIdentity(width=simulation.sensor.width_px, height=simulation.sensor.height_px)
    optics.camera = EmulatedU3vCamera(optics.picture, identity, simulation.sensor.period_s)
    threading.Thread(target=_obey, args=(optics.camera, Path(lab["orders"])), name="bridge", daemon=True).start()
    return EmulatedUsb([optics.camera])


def _obey(camera: EmulatedU3vCamera, orders: Path) -> None:
    """Do what is written to a file, line by line, as long as the file is there."""
    with orders.open() as lines:
        while orders.exists():
            line = lines.readline()
            if not line.endswith("\n"):
                lines.seek(lines.tell() - len(line))
                time.sleep(_LOOK_S)
                continue
            order = json.loads(line)
            if order.get("do") == "unplug":
                camera.unplug()
            elif order.get("do") == "plug":
                camera.plug()
            for name, value in order.items():
                if name != "do":
                    setattr(camera.faults, name, deque(value) if isinstance(value, list) else value)


def main() -> None:
    """Start a laboratory and keep it until Ctrl-C."""
    import argparse

    parser = argparse.ArgumentParser(description="an emulated laboratory: only its photons are simulated")
    parser.add_argument("--folder", type=Path, default=Path("lab"), help="ports, logs and station.toml come here")
    folder = parser.parse_args().folder
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # so that the emulators end too
    with Lab(folder) as lab:
        for name, value in lab.environment.items():
            sys.stdout.write(f"export {name}={value}\n")
        sys.stdout.write(f"fringed run --config {lab.folder / 'station.toml'}\n")
        sys.stdout.flush()
        try:
            while True:
                time.sleep(3600.0)
        except KeyboardInterrupt:
            return


if __name__ == "__main__":
    main()
