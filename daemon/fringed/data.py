"""The data that travels through the house: frozen dataclasses around read-only arrays.

Owns what a frame set, a phase map, a calibration, a range image, a registration and a model are;
knows nothing of sockets, files or plug-ins. Conventions that hold everywhere:

- Arrays are C-ordered and read-only. Images are `(height, width)`, row first.
- Pixel coordinates put the centre of the first pixel at 0 (OpenCV). A projector column `u` carries
  the phase `2 pi u / period_px + initial_phase_rad`.
- A transform is named by its frames: `T_reference_model` takes model points to the reference frame.
- Lengths are millimetres, angles radians, times seconds unless the name says otherwise.
- `rejected` masks (uint16) are zero where a pixel is kept, otherwise an OR of `Reject` flags.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import IntFlag
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt
import xxhash

from fringed.errors import DataError

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
UInt8Array = npt.NDArray[np.uint8]
UInt16Array = npt.NDArray[np.uint16]
Int32Array = npt.NDArray[np.int32]

Role = str  # "object", "reference", or what a pipeline names
Channel = Literal["white", "red", "green", "blue"]
CameraChannel = Literal["white", "red", "green", "blue", "rgb"]  # "rgb": all three of one exposure
Orientation = Literal["columns", "rows"]
PhaseKind = Literal["wrapped", "absolute", "relative"]


class Reject(IntFlag):
    """Say why a pixel was dropped."""

    KEPT = 0
    SATURATED = 1
    LOW_MODULATION = 2
    FRINGE_ORDER = 4
    RESIDUAL = 8
    OUT_OF_RANGE = 16
    ISOLATED = 32
    DISCONTINUITY = 64
    OTHER = 128
    HOT_PIXEL = 256
    SHADOW = 512
    REPEATED = 1024


_id_lock = threading.Lock()
_last_id_us = 0


def new_id() -> str:
    """Return an identity that sorts by time of creation, such as `20260102T030405.678901Z-1f0c`."""
    global _last_id_us
    with _id_lock:
        now_us = max(time.time_ns() // 1000, _last_id_us + 1)
        _last_id_us = now_us
    stamp = datetime.fromtimestamp(now_us // 1_000_000, UTC).strftime("%Y%m%dT%H%M%S")
    return f"{stamp}.{now_us % 1_000_000:06d}Z-{os.urandom(2).hex()}"


def read_only(array: Array, dtype: npt.DTypeLike | None = None) -> Array:
    """Return a C-ordered read-only view of `array` (a copy only where dtype or order demand it)."""
    view = np.asarray(array, dtype=dtype, order="C").view()
    view.flags.writeable = False
    return view


_ARRAY_TYPES: dict[type[Any], dict[str, np.dtype[Any] | None]] = {}


def _array_types(cls: type[Any]) -> dict[str, np.dtype[Any] | None]:
    """Map each field of `cls` that holds arrays to their dtype, None where any will do."""
    if cls in _ARRAY_TYPES:
        return _ARRAY_TYPES[cls]
    found: dict[str, np.dtype[Any] | None] = {}
    for name, hint in get_type_hints(cls).items():
        for part in (hint, *get_args(hint)):
            if get_origin(part) is np.ndarray:
                (scalar,) = get_args(get_args(part)[1]) or (Any,)
                found[name] = None if scalar is Any else np.dtype(scalar)
    _ARRAY_TYPES[cls] = found
    return found


def _conform(name: str, value: Any, dtype: np.dtype[Any] | None) -> Any:
    """Return an array (or tuple of them) read-only, C-ordered and of `dtype`, where no value is lost by it."""
    if isinstance(value, tuple):
        return tuple(_conform(name, item, dtype) for item in value)
    if not isinstance(value, np.ndarray):
        return value
    if not value.dtype.isnative:
        value = value.astype(value.dtype.newbyteorder("="))
    if dtype is None or value.dtype == dtype:
        return read_only(value) if value.flags.writeable or not value.flags.c_contiguous else value
    kinds = "buif" if dtype.kind == "f" else "bui"
    cast = read_only(value, dtype) if value.dtype.kind in kinds else None
    if cast is None or (dtype.kind != "f" and not np.array_equal(cast, value)):
        raise DataError(f"{name} is of type {value.dtype}; expected {dtype}, and these values do not fit into it")
    return cast


class _Frozen:
    """Make every array of a dataclass read-only and of its declared dtype when it is built."""

    def __post_init__(self) -> None:
        cls: type[Any] = type(self)
        for name, dtype in _array_types(cls).items():
            value = getattr(self, name)
            kept = _conform(f"{cls.__name__}.{name}", value, dtype)
            if kept is not value:
                object.__setattr__(self, name, kept)
        self._check()

    def _check(self) -> None:
        """Raise DataError where the fields contradict each other."""


def _same_shape(name: str, shape: tuple[int, ...], *arrays: Array | None) -> None:
    for array in arrays:
        if array is not None and array.shape != shape:
            raise DataError(f"{name}: an array has shape {array.shape}; its siblings have {shape}")


@dataclass(frozen=True)
class Provenance:
    """Where a product comes from: enough to make it again."""

    inputs: tuple[str, ...] = ()
    plugin: str = ""
    plugin_version: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    calibration: str = ""
    rig: str = ""
    software: str = ""
    created: str = ""
    simulated: bool = False
    replayed: bool = False


@dataclass(frozen=True)
class PatternFrame:
    """What one projected frame is, enough to decode it.

    A sinusoid of `group` g is `A + B cos(2 pi u / period_px + initial_phase_rad + shift_rad)`, u the
    projector column (orientation "columns") or row. Frames of one group differ in `shift_rad` only. Other
    styles have that sinusoid as their fundamental. `bit` numbers the bits of a Gray code from the coarsest, 0;
    -1: no code. `inverted` frames show the complement. `level` is the frame's light over the sequence's
    (several of them: high dynamic range). Frames of one `shot` are the channels of a single exposure and
    share its pattern; -1: a shot of its own.
    """

    style: str
    orientation: Orientation = "columns"
    period_px: float = 0.0
    shift_rad: float = 0.0
    initial_phase_rad: float = 0.0
    step: int = 0
    steps: int = 1
    group: int = 0
    channel: Channel = "white"
    bit: int = -1
    inverted: bool = False
    level: float = 1.0
    shot: int = -1


@dataclass(frozen=True)
class PatternSequence(_Frozen):
    """The ordered patterns of one acquisition.

    `patterns[i]` is uint8 `(height or 1, width or 1, 1 or 3)` and broadcasts to the projector's size.
    """

    family: str
    width_px: int
    height_px: int
    frames: tuple[PatternFrame, ...]
    patterns: tuple[UInt8Array, ...]
    grey_low: float = 0.0
    grey_high: float = 255.0
    precompensated: bool = False
    encoder: str = ""
    encoder_version: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def _check(self) -> None:
        if not self.frames or len(self.frames) != len(self.patterns):
            raise DataError(
                f"a pattern sequence needs as many patterns as frames and at least one; "
                f"it has {len(self.frames)} frames and {len(self.patterns)} patterns"
            )
        for index, pattern in enumerate(self.patterns):
            allowed = ({1, self.height_px}, {1, self.width_px}, {1, 3})
            if pattern.ndim != 3 or any(n not in a for n, a in zip(pattern.shape, allowed, strict=True)):
                raise DataError(
                    f"pattern {index} has shape {pattern.shape}; expected "
                    f"({self.height_px} or 1, {self.width_px} or 1, 1 or 3)"
                )

    def groups(self) -> dict[int, tuple[int, ...]]:
        """Map each group to the indices of its frames, in order."""
        found: dict[int, list[int]] = {}
        for index, frame in enumerate(self.frames):
            found.setdefault(frame.group, []).append(index)
        return {group: tuple(indices) for group, indices in found.items()}

    def exposures(self) -> tuple[tuple[int, ...], ...]:
        """Return the frames of each exposure, in order: one frame, or those of one shot."""
        found: dict[tuple[str, int], list[int]] = {}
        for index, frame in enumerate(self.frames):
            found.setdefault(("frame", index) if frame.shot < 0 else ("shot", frame.shot), []).append(index)
        return tuple(tuple(indices) for indices in found.values())


@dataclass(frozen=True)
class FrameStamp:
    """When one frame was shown and integrated, on the station's clock, and the camera's counter."""

    flip_s: float
    exposure_start_s: float
    exposure_end_s: float
    counter: int


@dataclass(frozen=True)
class CameraSettings:
    """What the camera was told. `noise_floor_dn` and `electrons_per_dn` describe its noise."""

    exposure_us: float = 8000.0
    gain_db: float = 0.0
    bits: int = 8
    channel: CameraChannel = "white"
    trigger: Literal["free-running", "software", "hardware"] = "free-running"
    electrons_per_dn: float = 0.0
    read_noise_electrons: float = 0.0


@dataclass(frozen=True)
class CheckFinding:
    """One thing that the station's own check of a set found wrong."""

    fault: str
    detail: str
    frames: tuple[int, ...] = ()


@dataclass(frozen=True)
class CheckReport:
    """What the station's own check of a set measured."""

    passed: bool
    findings: tuple[CheckFinding, ...] = ()
    residual: float = 0.0
    saturated_fraction: float = 0.0
    lit_fraction: float = 0.0
    counters_skipped: int = 0


@dataclass(frozen=True)
class FrameSet(_Frozen):
    """Frames `(n, height, width)` uint8 or uint16 of one role, one for each frame of `sequence`."""

    frames: Array
    sequence: PatternSequence
    role: Role = "object"
    id: str = ""
    scan: str = ""
    stamps: tuple[FrameStamp, ...] = ()
    settings: CameraSettings = field(default_factory=CameraSettings)
    check: CheckReport | None = None
    retakes: int = 0
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        frames = self.frames
        if frames.ndim != 3 or frames.dtype not in (np.uint8, np.uint16) or 0 in frames.shape:
            raise DataError(
                f"frames have shape {frames.shape} and type {frames.dtype}; "
                "expected (n, height, width) of uint8 or uint16, none of them zero"
            )
        if len(frames) != len(self.sequence.frames):
            raise DataError(f"{len(frames)} frames for a sequence of {len(self.sequence.frames)} patterns")
        if self.stamps and len(self.stamps) != len(frames):
            raise DataError(f"{len(self.stamps)} stamps for {len(frames)} frames; expected none or one for each")


@dataclass(frozen=True)
class PhaseMap(_Frozen):
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
        _same_shape("phase map", shape, self.modulation, self.background, self.rejected)
        _same_shape("phase map", shape, self.sigma_rad, self.wrapped_rad, self.confidence)


@dataclass(frozen=True)
class Lens(_Frozen):
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
class PhaseErrorTable(_Frozen):
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
class Calibration(_Frozen):
    """Everything that turns phase into millimetres.

    `T_projector_camera` (4, 4) takes camera points to the projector's frame. `reference_plane`
    (nx, ny, nz, d): n . X = d in the camera's frame, n towards the camera. `tone_curve` (256,) is the
    relative light for each grey level, 0 to 1. `crosstalk` (3, 3) has the response of camera channels R, G, B
    (rows) to the projector's (columns). `source` is "exact-simulated" for the simulator's own.
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
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        if self.T_projector_camera.shape != (4, 4):
            raise DataError(f"T_projector_camera has shape {self.T_projector_camera.shape}; expected (4, 4)")
        if self.crosstalk is not None and self.crosstalk.shape != (3, 3):
            raise DataError(f"crosstalk has shape {self.crosstalk.shape}; expected (3, 3), camera by projector channel")

    @property
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
        return digest.hexdigest()


@dataclass(frozen=True)
class RangeImage(_Frozen):
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
        _same_shape("range image", self.xyz_mm.shape[:2], self.rejected, self.intensity, self.sigma_mm)


@dataclass(frozen=True)
class IterationRecord:
    """One iteration of a registration."""

    rms_mm: float
    pairs: int
    threshold_mm: float
    rotation_rad: float
    translation_mm: float
    stage: str = ""


@dataclass(frozen=True)
class Registration(_Frozen):
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
class Model(_Frozen):
    """Merged points of many views: (n, 3) mm with normals, intensity (n,), optional faces (m, 3).

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
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        if self.points_mm.ndim != 2 or self.points_mm.shape[1] != 3:
            raise DataError(f"points_mm has shape {self.points_mm.shape}; expected (n, 3)")
        _same_shape("model normals", self.points_mm.shape, self.normals)
        _same_shape("model", self.points_mm.shape[:1], self.intensity, self.view_index)


@dataclass(frozen=True)
class Truth(_Frozen):
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
        _same_shape("truth", size, self.visible, self.lit, self.is_object)
        _same_shape("truth's projector_px", (*size, 2), self.projector_px)


@dataclass(frozen=True)
class Mesh(_Frozen):
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
        _same_shape("mesh", self.vertices_mm.shape[:1], self.albedo)


@dataclass(frozen=True)
class Artifact(_Frozen):
    """A finished file: `content` uint8 (n,), with its name and media type."""

    name: str
    media_type: str
    content: UInt8Array
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)


Product = PhaseMap | Calibration | RangeImage | Registration | Model | Truth | Mesh | Artifact
RECORDED: tuple[type, ...] = (
    FrameSet, PatternSequence, PhaseMap, Calibration, RangeImage, Registration, Model, Truth, Mesh, Artifact,
)  # fmt: skip
