"""No projector at all.

Owns no device.
"""

from __future__ import annotations

from typing import NoReturn

from fringed.data import PatternSequence
from fringed.errors import DeviceAbsent


class AbsentProjector:
    """No projector: every use says what to configure."""

    simulated = False

    def __init__(
        self,
        why: str = "no projector is configured: set projector.driver to sim, replay, hitachi, window or a plug-in's "
        "driver",
    ) -> None:
        self._why = why

    @property
    def size_px(self) -> tuple[int, int]:
        """Nothing."""
        return (0, 0)

    def open(self) -> str:
        """Raise DeviceAbsent."""
        self._refuse()

    def close(self) -> None:
        """Do nothing."""

    def load(self, sequence: PatternSequence, role: str) -> None:
        """Raise DeviceAbsent."""
        self._refuse()

    def show(self, index: int) -> float:
        """Raise DeviceAbsent."""
        self._refuse()

    def idle(self) -> None:
        """Do nothing: nothing is shown."""

    def _refuse(self) -> NoReturn:
        raise DeviceAbsent(self._why)
