"""The phase of one orientation, with what is known of every pixel."""

from __future__ import annotations

from dataclasses import dataclass, field

from fringed.data.arrays import Float32Array, Frozen, Provenance, UInt16Array, same_shape
from fringed.data.frames import Orientation, PhaseKind
from fringed.errors import DataError


@dataclass(frozen=True)
class PhaseMap(Frozen):
    """Phase of one orientation, `(height, width)` float32 radians; NaN where `rejected`.

    `kind` "wrapped" is in (-pi, pi]; "absolute" counts from the projector's first column or row, so
    that `u = (phase - initial_phase_rad) period_px / 2 pi`; "relative" is right up to a multiple of
    2 pi for each connected region. `sigma_rad` is the standard deviation from the sensor's noise,
    `confidence` how many standard deviations of that noise the fringe order is from being a wrong one.
    `wrapped_rad` is the finest wrapped phase, where a decoder was asked to keep it; `difference_to`
    names the reference's frame set where the phase is a difference. `projector_px` is the projector's
    width for columns, its height for rows; 0 where unknown.
    """

    phase_rad: Float32Array
    modulation: Float32Array
    background: Float32Array
    rejected: UInt16Array
    kind: PhaseKind
    period_px: float
    orientation: Orientation = "columns"
    initial_phase_rad: float = 0.0
    sigma_rad: Float32Array | None = None
    wrapped_rad: Float32Array | None = None
    difference_to: str = ""
    projector_px: int = 0
    confidence: Float32Array | None = None
    id: str = ""
    scan: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        shape = self.phase_rad.shape
        if len(shape) != 2:
            raise DataError(f"a phase map is (height, width); this one has shape {shape}")
        same_shape("phase map", shape, self.modulation, self.background, self.rejected)
        same_shape("phase map", shape, self.sigma_rad, self.wrapped_rad, self.confidence)
