"""Measured surfaces: range images, their registration and models; and what a simulated rig knows of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fringed.data.arrays import (
    Float32Array,
    Float64Array,
    Frozen,
    Int32Array,
    Provenance,
    UInt8Array,
    UInt16Array,
    same_shape,
)
from fringed.errors import DataError


@dataclass(frozen=True)
class RangeImage(Frozen):
    """Organised points: `xyz_mm` (height, width, 3) float32 in the camera's frame, NaN where rejected.

    `intensity` is uint8 `(height, width)`; `sigma_mm` float32 the standard deviation along the ray.
    """

    xyz_mm: Float32Array
    rejected: UInt16Array
    intensity: UInt8Array
    sigma_mm: Float32Array | None = None
    calibration: str = ""
    id: str = ""
    scan: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        if self.xyz_mm.ndim != 3 or self.xyz_mm.shape[2] != 3:
            raise DataError(f"xyz_mm has shape {self.xyz_mm.shape}; expected (height, width, 3)")
        same_shape("range image", self.xyz_mm.shape[:2], self.rejected, self.intensity, self.sigma_mm)


@dataclass(frozen=True)
class IterationRecord:
    """One iteration of a registration.

    `alpha_mm` is how much one unit of an invariant's noise counted as distance, where invariants were compared.
    """

    rms_mm: float
    pairs: int
    threshold_mm: float
    rotation_rad: float
    translation_mm: float
    stage: str = ""
    alpha_mm: float = 0.0


@dataclass(frozen=True)
class Registration(Frozen):
    """`T_reference_model` (4, 4) takes points of `model` to the frame of `reference`."""

    reference: str
    model: str
    T_reference_model: Float64Array
    converged: bool
    reason: str
    rms_mm: float
    overlap: float
    covariance: Float64Array | None = None
    history: tuple[IterationRecord, ...] = ()
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        if self.T_reference_model.shape != (4, 4):
            raise DataError(f"T_reference_model has shape {self.T_reference_model.shape}; expected (4, 4)")


@dataclass(frozen=True)
class Model(Frozen):
    """Merged points of many views: (n, 3) mm with normals, intensity (n,), optional faces (m, 3).

    `confidence` (n,) in 1 / mm^2 is the sum of the weights with which views saw a point: the inverse variance along the
    normal where noise is independent, zero where nobody has looked.

    `T_model_view[i]` takes points of `views[i]` to the model's frame, that of the first view.
    `registrations[i]` brought view i + 1 there.
    """

    points_mm: Float32Array
    normals: Float32Array
    intensity: UInt8Array
    views: tuple[str, ...] = ()
    T_model_view: Float64Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    registrations: tuple[Registration, ...] = ()
    faces: Int32Array | None = None
    view_index: UInt8Array | None = None
    confidence: Float32Array | None = None
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        if self.points_mm.ndim != 2 or self.points_mm.shape[1] != 3:
            raise DataError(f"points_mm has shape {self.points_mm.shape}; expected (n, 3)")
        same_shape("model normals", self.points_mm.shape, self.normals)
        same_shape("model", self.points_mm.shape[:1], self.intensity, self.view_index, self.confidence)


@dataclass(frozen=True)
class Truth(Frozen):
    """What a simulated rig knows of one frame set, for every camera pixel.

    `xyz_mm` (height, width, 3) float32, NaN where the ray meets nothing; `projector_px`
    (height, width, 2) float32, the column and row that light it; `visible` and `lit` uint8 (0 or 1):
    the ray meets the object, and the projector sees that point. `is_object` marks what belongs to the
    measured object rather than to a backdrop. `T_camera_object` (4, 4).
    """

    xyz_mm: Float32Array
    projector_px: Float32Array
    visible: UInt8Array
    lit: UInt8Array
    is_object: UInt8Array
    T_camera_object: Float64Array
    frame_set: str = ""
    scene: Mapping[str, Any] = field(default_factory=dict)
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        if self.xyz_mm.ndim != 3 or self.xyz_mm.shape[2] != 3:
            raise DataError(f"xyz_mm has shape {self.xyz_mm.shape}; expected (height, width, 3)")
        size = self.xyz_mm.shape[:2]
        same_shape("truth", size, self.visible, self.lit, self.is_object)
        same_shape("truth's projector_px", (*size, 2), self.projector_px)


@dataclass(frozen=True)
class Mesh(Frozen):
    """A triangle mesh: `vertices_mm` (n, 3) float64, `faces` (m, 3) int32, `albedo` (n,) 0 to 1."""

    vertices_mm: Float64Array
    faces: Int32Array
    albedo: Float32Array | None = None
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        for name, array in (("vertices_mm", self.vertices_mm), ("faces", self.faces)):
            if array.ndim != 2 or array.shape[1] != 3:
                raise DataError(f"{name} has shape {array.shape}; expected (n, 3)")
        same_shape("mesh", self.vertices_mm.shape[:1], self.albedo)
