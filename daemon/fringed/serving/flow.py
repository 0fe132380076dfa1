"""What all kinds of jobs share: a record, an end, and the way to be stopped.

Owns the base class; the kinds are in `scan_flow` and `other_flows`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from fringed import wire
from fringed.data import Array, Truth
from fringed.errors import FringedError
from fringed.messages import ErrorInfo, Event
from fringed.serving.house import House
from fringed.serving.jobs import JobRun
from fringed.serving.ports import AcquiredSet, SetUnderWay
from fringed.serving.records import Record
from fringed.serving.requests import error_info


class Flow(ABC):
    """One job's life, from `start` to the end of its record; everything in the reactor's thread."""

    moves_rig: ClassVar[bool] = False  # whether it needs the rig, and so obeys its lease

    def __init__(self, house: House, record: Record) -> None:
        self.house = house
        self.record = record
        self.job: JobRun | None = None

    @abstractmethod
    def start(self) -> None:
        """Begin."""

    def cancel(self) -> None:
        """Stop, as asked."""
        self.end(ErrorInfo("Cancelled", "cancelled, as asked"))

    def end(self, error: ErrorInfo | None) -> None:
        """End the record, well or not; the first end counts. With an error, a job that still runs is stopped."""
        if error is None:
            self.house.records.change(self.record, "done", 1.0, "done")
            return
        if self.job is not None:
            self.job.cancel()
        self.house.records.fail(self.record, error)

    def fail(self, error: FringedError) -> None:
        """End it with an exception."""
        self.end(error_info(error))

    # What acquisition tells; only scans and latency measurements listen.

    def acquiring(self, fraction: float, text: str) -> None:  # noqa: B027  most kinds take no sets
        """Know how far the sets are."""

    def frame_kept(self, of: SetUnderWay, index: int, image: Array) -> None:  # noqa: B027
        """See a frame of a set that is being taken."""

    def set_acquired(self, acquired: AcquiredSet) -> None:
        """Take a set that passed its check."""
        acquired.discard()

    def truth_known(self, truth: Truth) -> None:  # noqa: B027
        """Take what a simulated rig knows of a set."""

    def told(self, event: Event) -> None:  # noqa: B027
        """Know what the rig says of itself."""

    def acquired_all(self) -> None:  # noqa: B027
        """Know that nothing more is to be taken."""

    def acquisition_failed(self, error: ErrorInfo) -> None:
        """Know that a set or measurement could not be taken."""
        self.end(error)

    def announced(self, entry: dict[str, str], _: wire.Encoded) -> None:
        """List a product that was just announced."""
        self.record.products.append(entry)
        self.house.records.touch(self.record)
