"""What every camera driver needs: a check of what came over its port, the machine's clock, and no camera at all.

Owns no device.
"""

from __future__ import annotations

import time
from typing import NoReturn

import numpy as np

from fringed.data import Array, CameraSettings
from fringed.errors import DeviceAbsent, ProtocolError
from fringed.hookspecs import Clock, RawFrame


class MachineClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Return seconds; it never goes back."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let that much time pass."""
        time.sleep(max(0.0, seconds))


def checked_image(image: object, size_px: tuple[int, int], bits: int, channels: int = 1) -> Array:
    """Return `image` if it is what a camera of that size and depth delivers; `channels` is 3 for "rgb".

    Raises
    ------
    ProtocolError
        another shape or type, or numbers that `bits` cannot hold.
    """
    width, height = size_px
    wanted = np.dtype(np.uint8 if bits <= 8 else np.uint16)
    shape = (height, width) if channels == 1 else (height, width, channels)
    if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype != wanted:
        seen = f"{image.dtype} of {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise ProtocolError(
            f"the camera delivered {seen}; a frame of {bits} bits is {wanted} of {shape}: check its format and cable"
        )
    if bits not in (8, 16) and int(image.max()) >= 2**bits:
        raise ProtocolError(f"the camera delivered the number {int(image.max())}; {bits} bits end at {2**bits - 1}")
    return image


class AbsentCamera:
    """No camera: every use says what to configure."""

    simulated = False
    replayed = False

    def __init__(
        self,
        why: str = "no camera is configured: set camera.driver to sim, replay, duncantech, usb3vision, gige, webcam or "
        "a plug-in's driver",
    ) -> None:
        self.clock: Clock = MachineClock()
        self._why = why

    @property
    def size_px(self) -> tuple[int, int]:
        """Nothing."""
        return (0, 0)

    @property
    def period_s(self) -> float:
        """Nothing."""
        return 0.0

    def open(self) -> str:
        """Raise DeviceAbsent."""
        self._refuse()

    def close(self) -> None:
        """Do nothing."""

    def arm(self, settings: CameraSettings) -> CameraSettings:
        """Raise DeviceAbsent."""
        self._refuse()

    def disarm(self) -> None:
        """Do nothing."""

    def trigger(self) -> None:
        """Raise DeviceAbsent."""
        self._refuse()

    def read(self, timeout_s: float) -> RawFrame:
        """Raise DeviceAbsent."""
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise DeviceAbsent(self._why)
