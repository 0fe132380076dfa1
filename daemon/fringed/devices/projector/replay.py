"""The projector of a replay: it shows nothing, and tells the replayed camera which pattern would be seen.

Owns no picture and no time of its own; the camera's recordings have both.
"""

from __future__ import annotations

from fringed.data import PatternSequence
from fringed.devices.camera.replay import ReplayCamera
from fringed.errors import DeviceError


class ReplayProjector:
    """Stand for the projector that was there when the camera's recordings were made."""

    replayed = True

    def __init__(self, camera: ReplayCamera) -> None:
        self._camera = camera
        self._sequence: PatternSequence | None = None
        self.simulated = camera.simulated

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the panel that was recorded."""
        return self._camera.projector_size_px

    def open(self) -> str:
        """Return what it stands for."""
        return "replay"

    def close(self) -> None:
        """Release everything; harmless when closed."""
        self._sequence = None

    def load(self, sequence: PatternSequence, role: str) -> None:
        """Cue the next recording of `role`; raises UsageError where none was made with `sequence`."""
        self._camera.cue(sequence, role)
        self._sequence = sequence

    def show(self, index: int) -> float:
        """Take pattern `index` as shown and return the time of that.

        Raises
        ------
        DeviceError
            no sequence was loaded.
        UsageError
            the sequence has no such pattern.
        """
        if self._sequence is None:
            raise DeviceError("the replayed projector has no patterns; load a sequence before one is shown")
        return self._camera.present(index)

    def idle(self) -> None:
        """Take the idle picture as shown."""
        self._camera.present(-1)
