"""What every data object is made of: read-only arrays of a declared type, identities, provenance.

Owns how arrays are checked and frozen; knows none of the objects.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from fringed.errors import DataError

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
UInt8Array = npt.NDArray[np.uint8]
UInt16Array = npt.NDArray[np.uint16]
Int32Array = npt.NDArray[np.int32]

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


class Frozen:
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


def same_shape(name: str, shape: tuple[int, ...], *arrays: Array | None) -> None:
    """Raise DataError where an array has another shape."""
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
