"""The device states and the transitions that are legal, as data.

Owns the tables; who moves a device from state to state is the runner. ABSENT is not connected or
gone; CONNECTING is being opened; IDLE is open; ARMED is ready to take frames; ACQUIRING takes a set;
DEGRADED works, but its last set was not good enough; FAULT answered wrongly or not at all. A
projector's lamp adds STANDBY, WARMING, ON and COOLING: unless it is ON the projector is not open, and tried again.
"""

from __future__ import annotations

from fringed.errors import AcquisitionError
from fringed.messages import DeviceStateName

Table = dict[DeviceStateName, frozenset[DeviceStateName]]


def _table(rows: dict[DeviceStateName, tuple[DeviceStateName, ...]]) -> Table:
    return {state: frozenset(nexts) for state, nexts in rows.items()}


CAMERA: Table = _table(
    {
        "ABSENT": ("CONNECTING",),
        "CONNECTING": ("IDLE", "ABSENT", "FAULT"),
        "IDLE": ("ARMED", "DEGRADED", "ABSENT", "FAULT"),
        "ARMED": ("ACQUIRING", "IDLE", "DEGRADED", "ABSENT", "FAULT"),
        "ACQUIRING": ("ARMED", "IDLE", "DEGRADED", "ABSENT", "FAULT"),
        "DEGRADED": ("ARMED", "IDLE", "ABSENT", "FAULT"),
        "FAULT": ("CONNECTING", "ABSENT"),
    }
)

PROJECTOR: Table = _table(
    {
        "ABSENT": ("CONNECTING",),
        "CONNECTING": ("IDLE", "STANDBY", "WARMING", "ON", "COOLING", "ABSENT", "FAULT"),
        "IDLE": ("ACQUIRING", "STANDBY", "WARMING", "ON", "COOLING", "DEGRADED", "ABSENT", "FAULT"),
        "STANDBY": ("CONNECTING", "WARMING", "ABSENT", "FAULT"),
        "WARMING": ("CONNECTING", "ON", "COOLING", "ABSENT", "FAULT"),
        "ON": ("IDLE", "ACQUIRING", "COOLING", "DEGRADED", "ABSENT", "FAULT"),
        "COOLING": ("CONNECTING", "STANDBY", "ABSENT", "FAULT"),
        "ACQUIRING": ("IDLE", "ON", "STANDBY", "WARMING", "COOLING", "DEGRADED", "ABSENT", "FAULT"),
        "DEGRADED": ("IDLE", "ON", "ACQUIRING", "STANDBY", "WARMING", "COOLING", "ABSENT", "FAULT"),
        "FAULT": ("CONNECTING", "COOLING", "ABSENT"),
    }
)

TABLES: dict[str, Table] = {"camera": CAMERA, "projector": PROJECTOR}


def check_transition(which: str, old: DeviceStateName, new: DeviceStateName) -> None:
    """Raise AcquisitionError where a device may not go from `old` to `new`.

    Raises
    ------
    AcquisitionError
        the transition is not in the device's table.
    """
    allowed = TABLES[which].get(old, frozenset())
    if new not in allowed:
        raise AcquisitionError(f"the {which} cannot go from {old} to {new}; allowed are {', '.join(sorted(allowed))}")
