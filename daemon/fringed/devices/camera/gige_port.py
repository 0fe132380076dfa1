"""What the driver of GenICam cameras needs of a library: features by name, and buffers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fringed.data import Array
from fringed.errors import DeviceError

COMPLETE = 0
STATUS = {
    -1: "of unknown state",
    0: "complete",
    1: "cleared",
    2: "late: not all of its packets came in time",
    3: "with missing packets",
    4: "with a packet that was not its own",
    5: "larger than its buffer",
    6: "not filled",
    7: "aborted",
}
"""Why a buffer holds no frame [V: Aravis' headers]."""


class FeatureError(DeviceError):
    """A camera's feature could not be read or set."""


@dataclass(frozen=True)
class Delivery:
    """One buffer. `data` are its bytes, empty unless it is complete; times as the library gives them."""

    data: Array
    size_px: tuple[int, int]
    pixel_code: int
    status: int
    frame_id: int
    stamp_ns: int
    arrived_s: float

    @property
    def complete(self) -> bool:
        """Whether nothing of it is missing."""
        return self.status == COMPLETE


class GenicamPort(Protocol):
    """One camera behind a GenICam library. Features raise FeatureError, and DeviceAbsent when the camera is gone."""

    def open(self, device: str) -> str:
        """Open the camera of that name, or the only one for none; return its identity; raises DeviceAbsent."""
        ...

    def close(self) -> None:
        """Release it; harmless when closed."""

    def alive(self) -> bool:
        """Whether the camera answers and is ours; ends within 0.5 s; once not, it has to be opened afresh."""
        ...

    def has(self, feature: str) -> bool:
        """Whether the camera has a feature, now."""
        ...

    def choices(self, feature: str) -> tuple[str, ...]:
        """Return the entries of an enumeration that are available now."""
        ...

    def text(self, feature: str) -> str:
        """Return a string or an enumeration's entry."""
        ...

    def number(self, feature: str, whole: bool = False) -> float:
        """Return a float, or an integer for `whole`."""
        ...

    def limits(self, feature: str, whole: bool = False) -> tuple[float, float]:
        """Return the least and the greatest value of a number."""
        ...

    def put(self, feature: str, value: str | float | int | bool) -> None:
        """Set a feature: an enumeration by str, a float, an integer by int, a boolean."""

    def execute(self, command: str) -> None:
        """Execute a command."""

    def start(self, buffers: int) -> None:
        """Begin to receive into that many buffers; the camera is told by a command of its own."""

    def stop(self) -> None:
        """End receiving; harmless when not begun."""

    def pop(self, timeout_s: float) -> Delivery | None:
        """Return the next buffer, None where none comes in time."""
        ...

    def statistics(self) -> dict[str, int]:
        """Return the stream's counts, by name: frames, failures, missing packets and more."""
        ...
