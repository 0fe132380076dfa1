"""How the station is, published each second and whenever it changed.

Owns `StationState` and the devices' last known states; measures memory and disk, decides nothing.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from fringed import __version__, wire
from fringed.errors import FringedError
from fringed.messages import DeviceState, StationState
from fringed.serving.house import House
from fringed.serving.leases import Leases
from fringed.serving.reactor import Timer
from fringed.serving.scans import Scans

HEARTBEAT_S = 1.0
_DISK_INTERVAL_S = 2.0
_SOON_S = 0.05  # changes within it are told together
_PAGE = os.sysconf("SC_PAGE_SIZE")
_ALWAYS = ("sets_taken", "sets_retaken", "sets_failed", "frames_discarded", "jobs", "recorded")
_UNKNOWN = DeviceState("ABSENT", "none", "", "not configured")


@dataclass(frozen=True)
class Identity:
    """What does not change while the daemon runs."""

    name: str
    rig: str
    simulated: bool
    replayed: bool
    data_dir: str
    config_path: str


@dataclass
class Status:
    """Gather and publish."""

    house: House
    leases: Leases
    scans: Scans
    identity: Identity
    gauges: Callable[[], Mapping[str, int]]
    devices: dict[str, DeviceState] = field(default_factory=dict)
    _began_s: float = 0.0
    _soon: Timer | None = None
    _last: StationState | None = None
    _free_bytes: int = 0
    _measuring: bool = False

    def start(self) -> None:
        """Publish from now on."""
        self._began_s = self.house.reactor.now()
        self._free_bytes = self.house.store.free_bytes()
        self.house.reactor.every(_DISK_INTERVAL_S, self._measure_disk)
        self.house.reactor.every(HEARTBEAT_S, self._publish)

    def device_changed(self, which: str, state: DeviceState) -> None:
        """Note how a device is, "camera" or "projector"."""
        self.devices[which] = state
        self.changed()

    def changed(self) -> None:
        """Publish soon."""
        if self._soon is None:
            self._soon = self.house.reactor.call_later(_SOON_S, self._publish)

    def state(self) -> StationState:
        """Return how the station is now."""
        house, now = self.house, self.house.reactor.now()
        current = self.scans.current
        calibration = house.present.calibration
        return StationState(
            name=self.identity.name,
            version=__version__,
            pid=os.getpid(),
            uptime_s=round(now - self._began_s, 3),
            simulated=self.identity.simulated,
            replayed=self.identity.replayed,
            rig=self.identity.rig,
            calibration=calibration.hash if calibration else "",
            calibration_origin="; ".join(filter(None, (house.present.in_force.origin, house.present.in_force.problem))),
            camera=self._camera(),
            projector=self.devices.get("projector", _UNKNOWN),
            lease=self.leases.state(now),
            workers=house.hosts.states(),
            quarantine=house.hosts.quarantined(),
            scan=current.id if current else "",
            pipelines=tuple(sorted(house.present.config.pipelines)),
            counters=self._counters(),
            memory_mb=memory_mb(),
            data_dir=self.identity.data_dir,
            free_disk_mb=round(self._free_bytes / 1e6, 1),
            config_path=self.identity.config_path,
        )

    def _camera(self) -> DeviceState:
        camera, missing = self.devices.get("camera", _UNKNOWN), self.house.no_scene
        return replace(camera, detail=f"no scans: {missing.message}") if missing else camera

    def _measure_disk(self) -> None:
        """Ask the disk in the loader's thread: one that hangs, such as a lost network disk, must not hold the loop."""
        if not self._measuring:
            self._measuring = True
            self.house.in_thread(self.house.loader, self.house.store.free_bytes, self._disk_measured, self._unmeasured)

    def _disk_measured(self, free_bytes: int) -> None:
        self._free_bytes, self._measuring = free_bytes, False

    def _unmeasured(self, _: FringedError) -> None:
        self._measuring = False

    def _counters(self) -> dict[str, int]:
        house = self.house
        total: Counter[str] = Counter(dict.fromkeys(_ALWAYS, 0))
        total.update(house.counters)
        total.update(house.records.counters)
        total.update({f"stream_{name}": count for name, count in house.stream.counters.items()})
        total["stream_dropped"] = house.stream.outlet.dropped
        total["stream_malformed"] = house.stream.malformed
        total["handler_failures"] = house.reactor.failures
        total.update(self.gauges())
        return dict(total)

    def _publish(self) -> None:
        """Publish; a heartbeat that differs in nothing else still tells that the station lives."""
        if self._soon is not None:
            self._soon.cancel()
            self._soon = None
        self.house.stream.publish(self.state(), wire.TOPIC_STATE)

    def watch(self) -> None:
        """Publish soon where something that people see has changed since the last look."""
        state = self.state()
        seen = replace(state, uptime_s=0.0, counters={}, memory_mb=0.0, free_disk_mb=0.0, lease=None)
        if state.lease is not None:
            seen = replace(seen, lease=replace(state.lease, expires_in_s=0.0))
        seen = replace(seen, workers=tuple(replace(worker, memory_mb=0.0) for worker in seen.workers))
        if seen != self._last:
            self._last = seen
            self.changed()


def memory_mb() -> float:
    """Return the resident memory of this process."""
    try:
        return round(int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE / 1e6, 1)
    except (OSError, ValueError, IndexError):
        return 0.0
