"""A station on an emulated laboratory: its daemon, its client, and what is asked of both."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fringed.config.toml_text import dumps
from fringed.emulators.lab import Lab
from fringed.errors import StationError
from fringed.simulation.rig import SimulatedRig
from fringed_client import Station

READY_S = 120.0


@dataclass
class EmulatedStation:
    """A daemon on a laboratory, and a client of it."""

    lab: Lab
    process: subprocess.Popen[bytes]
    client: Station

    def states(self) -> dict[str, str]:
        """Return the devices' states by name."""
        now = self.client.status()
        return {"camera": now.camera.state, "projector": now.projector.state}

    def wait(self, condition: Any, timeout_s: float = READY_S) -> float:
        """Wait until `condition(states)` holds; return how long it took, in seconds."""
        began = time.monotonic()
        while not condition(self.states()):
            if time.monotonic() - began > timeout_s:
                now = self.client.status()
                raise TimeoutError(f"after {timeout_s:g} s: camera {now.camera}, projector {now.projector}")
            time.sleep(0.02)
        return time.monotonic() - began

    def wait_ready(self) -> float:
        """Wait until both devices are ready; return how long it took."""
        return self.wait(lambda states: set(states.values()) <= {"IDLE", "DEGRADED"})


@contextlib.contextmanager
def emulated_station(
    folder: Path, simulation: dict[str, Any] | None = None, more: dict[str, Any] | None = None
) -> Iterator[EmulatedStation]:
    """Run a laboratory and a station on it, with the rig's exact calibration."""
    folder.mkdir(parents=True, exist_ok=True)
    with Lab(folder / "lab", simulation) as lab:
        rig = SimulatedRig(lab.simulation)
        exact = replace(rig.calibration(), rig=lab.configuration["name"])
        config = {**lab.configuration, **(more or {})}
        (folder / "station.toml").write_text(dumps(config))
        env = {**os.environ, **lab.environment}
        env |= {"FRINGED_RUNTIME_DIR": str(folder / "run"), "FRINGED_DATA_DIR": str(folder / "data")}
        command = [sys.executable, "-m", "fringed", "run", "--config", str(folder / "station.toml")]
        with (folder / "station.log").open("wb") as log:
            process = subprocess.Popen(command, env=env, stdout=log, stderr=log)
        try:
            with _client(folder, process) as client:
                client.request("calibration.use", timeout_s=60.0, id=client.add(exact))
                yield EmulatedStation(lab, process, client)
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _client(folder: Path, process: subprocess.Popen[bytes]) -> Station:
    deadline = time.monotonic() + READY_S
    while True:
        try:
            client = Station(str(folder / "run"))
            client.status()
            return client
        except StationError as error:
            if process.poll() is not None or time.monotonic() > deadline:
                said = (folder / "station.log").read_text()[-2000:]
                raise RuntimeError(f"the station does not serve: {error}\n{said}") from error
            time.sleep(0.1)
