"""The camera's sensor: photons to electrons to numbers, with the noise that this brings.

Owns full well, gain, noise and quantisation; knows nothing of what is in front of the lens.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from fringed.config.simulated import SimulationConfig
from fringed.data import Array, CameraSettings, Channel, Float32Array
from fringed.errors import UsageError
from fringed.simulation.rows import for_rows

RGB: tuple[Channel, ...] = ("red", "green", "blue")  # the CCDs, in the order of a frame's channels
REFERENCE_SIGNAL = 0.8  # of the full well: a white plane at the working distance after the reference exposure
_MASK = (1 << 64) - 1


class Sensor:
    """One sensor, its fixed pattern drawn from the simulation's seed."""

    def __init__(self, config: SimulationConfig) -> None:
        self._config = config
        self.shape = (config.sensor.height_px, config.sensor.width_px)

    def in_force(self, asked: CameraSettings) -> CameraSettings:
        """Return the settings that the sensor takes, with what it knows of its noise.

        Unquantised frames (`quantise = false`) have 16 bits whatever was asked.

        Raises
        ------
        UsageError
            an exposure or a number of bits that the sensor has not.
        """
        if not asked.exposure_us > 0:
            raise UsageError(f"an exposure of {asked.exposure_us} us is asked; it must be more than 0")
        if not 8 <= asked.bits <= 16:
            raise UsageError(f"frames of {asked.bits} bits are asked; the simulated sensor gives 8 to 16")
        bits = asked.bits if self._config.quantise else 16
        sensor = self._config.sensor
        return replace(
            asked,
            bits=bits,
            electrons_per_dn=sensor.full_well_electrons / (2**bits - 1) / 10 ** (asked.gain_db / 20),
            read_noise_electrons=sensor.read_noise_electrons if self._config.noise else 0.0,
        )

    def sensitivity(self) -> Float32Array:
        """Return each pixel's relative gain (height, width), 1 with PRNU: drawn anew each time, always the same."""
        if not self._config.noise:
            return np.ones(self.shape, np.float32)
        return np.asarray(1 + np.float32(self._config.sensor.prnu) * self._drawn(1), dtype=np.float32)

    @cached_property
    def _fixed(self) -> Float32Array:
        """Each pixel's own dark electrons (height, width)."""
        return np.asarray(np.float32(self._config.sensor.dsnu_electrons) * self._drawn(2), dtype=np.float32)

    @cached_property
    def _other_ccds(self) -> tuple[Float32Array, Float32Array]:
        """Gains of the red and the blue CCD over the green one's, and their dark electrons, (2, height, width) each.

        A camera that delivers one channel alone is simulated with the green CCD's fixed pattern, whatever it sees.
        """
        sensor, green = self._config.sensor, self.sensitivity()
        gains = [(1 + np.float32(sensor.prnu) * self._drawn(1, ccd)) / green for ccd in (0, 2)]
        dark = [np.float32(sensor.dsnu_electrons) * self._drawn(2, ccd) for ccd in (0, 2)]
        return np.asarray(gains, np.float32), np.asarray(dark, np.float32)

    def _drawn(self, *stream: int) -> Float32Array:
        generator = np.random.Generator(np.random.Philox(self.key(*stream)))
        return generator.standard_normal(self.shape, np.float32)

    def electrons(self, exposure_us: float) -> float:
        """Return the mean electrons of a white plane at the working distance, before it saturates."""
        sensor = self._config.sensor
        return REFERENCE_SIGNAL * sensor.full_well_electrons * exposure_us / sensor.reference_exposure_us

    def digitise(self, electrons: Float32Array, settings: CameraSettings, counter: int, channel: str = "") -> Array:
        """Return the frame, uint8 up to 8 bits and uint16 above; noise depends on seed, counter and pixel only.

        `channel` names the CCD of a frame that has several: each has its own noise and fixed pattern.
        """
        from fringed.simulation.frame_kernels import digitise_rows

        sensor, noisy = self._config.sensor, self._config.noise
        top = float(2**settings.bits - 1)
        numbers = (
            sensor.dark_electrons_per_s * settings.exposure_us * 1e-6,
            sensor.read_noise_electrons**2,
            sensor.full_well_electrons,
            settings.electrons_per_dn,
            sensor.offset_dn * top / 255.0,
            top,
            float(noisy),
        )
        fixed = self._fixed if noisy else np.zeros((0, 0), np.float32)
        if noisy and channel in ("red", "blue"):
            gains, dark = self._other_ccds
            electrons, fixed = electrons * gains[int(channel == "blue")], dark[int(channel == "blue")]
        out = np.empty(electrons.shape, np.uint16)
        key = np.uint64(self.key(3, counter, *((RGB.index(channel),) if channel else ())))
        for_rows(len(out), lambda first, end: digitise_rows((first, end), electrons, fixed, key, numbers, out))
        return out.astype(np.uint8) if settings.bits <= 8 else out

    def key(self, *stream: int) -> int:
        """Return 64 bits that depend on the seed and on what is drawn with them."""
        key = self._config.seed & _MASK
        for part in stream:
            key = (key ^ (part & _MASK)) * 0x9E3779B97F4A7C15 & _MASK
            key = (key ^ (key >> 32)) * 0xD6E8FEB86659FD93 & _MASK
            key ^= key >> 29
        return key
