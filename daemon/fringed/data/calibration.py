"""What turns phase into millimetres: lenses, where they stand, tone, and how well all of it is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
import xxhash

from fringed.data.arrays import Float32Array, Float64Array, Frozen, Provenance, UInt8Array
from fringed.errors import DataError


@dataclass(frozen=True)
class Lens(Frozen):
    """A pinhole with Brown distortion: `matrix` (3, 3) in pixels, `distortion` (k1, k2, p1, p2, k3).

    It holds for a camera and, inverted, for a projector (Zhang & Huang 2006).
    """

    width_px: int
    height_px: int
    matrix: Float64Array
    distortion: Float64Array

    def _check(self) -> None:
        if self.matrix.shape != (3, 3) or self.distortion.shape != (5,):
            raise DataError(
                f"a lens has a (3, 3) matrix and 5 distortion coefficients; "
                f"these have {self.matrix.shape} and {self.distortion.shape}"
            )


@dataclass(frozen=True)
class PhaseErrorTable(Frozen):
    """What the projector's tone curve adds to a wrapped phase of `steps` steps: `error_rad` (n,) float64.

    Entry i holds for the phase `2 pi i / n - pi`; a decoder subtracts it. It is right for fringes of
    `period_px` and the grey levels that it was measured with, and only where the light is blurred alike.
    """

    steps: int
    period_px: float
    error_rad: Float64Array

    def _check(self) -> None:
        if self.error_rad.ndim != 1 or len(self.error_rad) < 8 or self.steps < 3:
            raise DataError(
                f"a phase error table has 3 or more steps and 8 or more entries; this one has {self.steps} steps and "
                f"errors of shape {self.error_rad.shape}"
            )


@dataclass(frozen=True)
class PixelModel(Frozen):
    """Points as a function of the phase, fitted for each camera pixel by itself.

    `coefficients` (k, height, width) float32, by `form`. "rational": z = (a + b p) / (1 + c p) of coefficients a, b
    and c, with x and y on the pixel's ray. "polynomial": x, y and z are polynomials of p, k / 3 coefficients each, the
    lowest power first. "height": the reference plane's formula, L and 2 pi f0 D of h = L d / (d + 2 pi f0 D), d the
    phase minus the plane's, which is the third one. p is `(phase - phase_offset_rad) * phase_scale`, for fringes of
    `period_px` along `orientation`. `z_range_mm` is where it was fitted: beyond, nothing is known. `sigma_mm` is how
    well it is known along the ray, from the scatter of the planes about it.
    """

    form: Literal["rational", "polynomial", "height"]
    coefficients: Float32Array
    orientation: Literal["columns", "rows"]
    period_px: float
    initial_phase_rad: float
    z_range_mm: tuple[float, float]
    phase_offset_rad: float = 0.0
    phase_scale: float = 1.0
    sigma_mm: float = 0.0

    def _check(self) -> None:
        if self.coefficients.ndim != 3:
            raise DataError(f"coefficients have shape {self.coefficients.shape}; expected (k, height, width)")


@dataclass(frozen=True)
class ViewFit(Frozen):
    """How one board view fits a calibration: residuals (n, 2) px, observed minus predicted, NaN where there is none.

    `used` (n,) uint8 tells which points counted. `T_camera_board` (4, 4). `note` says why a view was left out.
    """

    view: str
    T_camera_board: Float64Array
    camera_px: Float64Array
    camera_residual_px: Float64Array
    projector_px: Float64Array
    projector_residual_px: Float64Array
    used: UInt8Array
    name: str = ""
    note: str = ""


@dataclass(frozen=True)
class Calibration(Frozen):
    """Everything that turns phase into millimetres.

    `T_projector_camera` (4, 4) takes camera points to the projector's frame. `reference_plane`
    (nx, ny, nz, d): n . X = d in the camera's frame, n towards the camera. `tone_curve` (256,) is the
    relative light for each grey level, 0 to 1. `crosstalk` (3, 3) has the response of camera channels R, G, B
    (rows) to the projector's (columns). `source` is "exact-simulated" for the simulator's own.

    `model` says how phase becomes points: "stereo" by both lenses, "pixel" by `pixel_model`. `covariance` (p, p) is
    that of the numbers `parameters` names, such as "camera.fx", "projector.k1", "stereo.rx" (rad, a rotation before
    T_projector_camera's) and "stereo.tx" (mm). `views` are the board's poses. `camera_falloff` and
    `projector_falloff` (k,) are relative light 1 + c1 r^2 + c2 r^4 ..., r from the picture's centre over half its
    diagonal. `temperature_c` is the room's.
    """

    camera: Lens
    projector: Lens
    T_projector_camera: Float64Array
    rig: str
    source: str
    reference_plane: Float64Array | None = None
    tone_curve: Float64Array | None = None
    crosstalk: Float64Array | None = None
    phase_errors: tuple[PhaseErrorTable, ...] = ()
    residuals: Mapping[str, float] = field(default_factory=dict)
    model: Literal["stereo", "pixel"] = "stereo"
    pixel_model: PixelModel | None = None
    covariance: Float64Array | None = None
    parameters: tuple[str, ...] = ()
    views: tuple[ViewFit, ...] = ()
    camera_falloff: Float64Array | None = None
    projector_falloff: Float64Array | None = None
    temperature_c: float | None = None
    notes: tuple[str, ...] = ()
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        if self.T_projector_camera.shape != (4, 4):
            raise DataError(f"T_projector_camera has shape {self.T_projector_camera.shape}; expected (4, 4)")
        if self.crosstalk is not None and self.crosstalk.shape != (3, 3):
            raise DataError(f"crosstalk has shape {self.crosstalk.shape}; expected (3, 3), camera by projector channel")
        count = len(self.parameters)
        if self.covariance is not None and self.covariance.shape != (count, count):
            raise DataError(f"the covariance has shape {self.covariance.shape}; {count} parameters are named")
        if self.model == "pixel" and self.pixel_model is None:
            raise DataError("a calibration whose model is 'pixel' has to hold one in pixel_model")

    @cached_property
    def hash(self) -> str:
        """Sixteen hexadecimal digits of the numbers that geometry depends on; products name it."""
        digest = xxhash.xxh3_64()
        for lens in (self.camera, self.projector):
            digest.update(np.array([lens.width_px, lens.height_px], np.int64).tobytes())
            digest.update(lens.matrix.astype(np.float64).tobytes())
            digest.update(lens.distortion.astype(np.float64).tobytes())
        digest.update(self.T_projector_camera.astype(np.float64).tobytes())
        if self.reference_plane is not None:
            digest.update(self.reference_plane.astype(np.float64).tobytes())
        if self.model == "pixel" and self.pixel_model is not None:
            digest.update(self.pixel_model.coefficients.data)  # many megabytes: not copied
        return digest.hexdigest()
