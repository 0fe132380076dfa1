"""The simulated projector: the rig's display behind the interface of every projector."""

from __future__ import annotations

from fringed.data import PatternSequence
from fringed.errors import DeviceAbsent, DeviceError
from fringed.simulation.rig import SimulatedRig


class SimulatedProjector:
    """A projector of the simulated rig."""

    simulated = True

    def __init__(self, rig: SimulatedRig) -> None:
        self._rig = rig
        self._open = False
        self._loaded = False

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the panel."""
        return (self._rig.config.projector.width_px, self._rig.config.projector.height_px)

    def open(self) -> str:
        """Open and return the identity."""
        self._open = True
        return f"{self._rig.identity} projector {self.size_px[0]} x {self.size_px[1]}"

    def close(self) -> None:
        """Release everything; harmless when closed."""
        self._open = self._loaded = False

    def load(self, sequence: PatternSequence, role: str) -> None:
        """Prepare the patterns of one set; raises DeviceError for those of another size."""
        self._require_open()
        self._rig.load(sequence, role)
        self._loaded = True

    def show(self, index: int) -> float:
        """Show pattern `index` and return the time of its flip."""
        self._require_open()
        if not self._loaded:
            raise DeviceError("no patterns are loaded: call load before show")
        return self._rig.show(index)

    def idle(self) -> None:
        """Show black."""
        self._require_open()
        self._rig.idle()

    def _require_open(self) -> None:
        if not self._open:
            raise DeviceAbsent("the simulated projector is closed: open it")
