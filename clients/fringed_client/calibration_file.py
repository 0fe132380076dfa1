"""Calibrations as readable files, and recordings that are read without a station.

Owns `calibration.json` (every number of a Calibration, arrays as lists, NaN as null) and reading an HDF5 recording
with plain h5py; the recordings' format is docs/recording-format.md.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_origin, get_type_hints

import numpy as np

from fringed import wire
from fringed.data import Calibration
from fringed.errors import DataError, NotFound, RecordingError
from fringed.tree import join, split
from fringed_client.files import write_aside

if TYPE_CHECKING:
    from fringed_client.station import Station


def save_calibration(calibration: Calibration, path: Path) -> Path:
    """Write a calibration as JSON."""
    arrays: dict[str, Any] = {}
    tree = split(calibration, "", arrays)
    document = {"format": "fringed-calibration", "version": 1, "hash": calibration.hash, **_listed(tree, arrays)}
    return write_aside(path, json.dumps(document, indent=1).encode())


def _listed(node: Any, arrays: dict[str, Any]) -> Any:
    if isinstance(node, dict):
        if set(node) == {"$array"}:
            return _numbers(arrays[node["$array"]])
        return {key: _listed(item, arrays) for key, item in node.items()}
    if isinstance(node, list):
        return [_listed(item, arrays) for item in node]
    return node


def _numbers(array: Any) -> Any:
    """Return nested lists; JSON has no NaN, so it is null, and an empty array says its shape."""
    if array.size == 0:
        return {"$empty": list(array.shape)}
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        listed = array.astype(object)
        listed[~np.isfinite(array)] = None
        return listed.tolist()
    return array.tolist()


def load_calibration(path: Path) -> Calibration:
    """Read a calibration: JSON as `save_calibration` writes it, or an HDF5 recording.

    Raises
    ------
    DataError
        it is missing, or not a calibration.
    """
    if path.suffix.lower() in (".h5", ".hdf5"):
        found = load_recording(path)
        if not isinstance(found, Calibration):
            raise DataError(f"{path} holds a {type(found).__name__}; expected a Calibration")
        return found
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"the calibration {path} cannot be read: {error}; name a calibration .json or .h5") from error
    if not isinstance(tree, dict) or tree.get("format") != "fringed-calibration":
        raise DataError(f'{path} is no calibration: it lacks "format": "fringed-calibration"')
    own = {key: value for key, value in tree.items() if key not in ("format", "version", "hash")}
    try:
        loaded: Calibration = join(_arrayed(own, Calibration), Calibration, {}, wire.KINDS)
    except (ValueError, TypeError, KeyError) as error:
        raise DataError(f"{path} is no calibration: {error}") from error
    if tree.get("hash") not in (None, loaded.hash):
        raise DataError(
            f"{path} was changed by hand: its hash is {loaded.hash}, the file says {tree['hash']}; remove the line"
        )
    return loaded


def _arrayed(node: Any, hint: Any) -> Any:
    """Turn lists of numbers into arrays where a type's hints say arrays; null is NaN."""
    if node is None:
        return None
    for part in (hint, *get_args(hint)):  # Float64Array | None
        if get_origin(part) is np.ndarray:
            scalar = get_args(get_args(part)[1])[0]
            return np.zeros(node["$empty"], scalar) if isinstance(node, dict) else np.array(node, scalar)
        if hasattr(part, "__dataclass_fields__") and isinstance(node, dict):
            hints = get_type_hints(part)
            return {key: _arrayed(item, hints.get(key)) for key, item in node.items()}
    if isinstance(node, list) and get_origin(hint) is tuple:
        return [_arrayed(item, get_args(hint)[0]) for item in node]
    return node


def load_recording(path: Path) -> Any:
    """Read a recording's HDF5 file.

    Raises
    ------
    RecordingError
        it is missing, truncated, or something else.
    """
    import h5py

    arrays: dict[str, Any] = {}
    try:
        with h5py.File(path, "r", locking=False) as file:
            kind, tree = str(file.attrs["kind"]), json.loads(str(file.attrs["tree"]))
            file.visititems(
                lambda name, item: arrays.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None
            )
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise RecordingError(
            f"{path} is no readable recording: {error}; give an id or a recording's .h5 file"
        ) from error
    if kind not in wire.KINDS:
        raise RecordingError(f"{path} holds a {kind}, which this release does not know")
    return join(tree, wire.KINDS[kind], arrays, wire.KINDS)


def calibration_of(station: Station) -> Calibration:
    """Return the calibration that the station uses.

    Raises
    ------
    NotFound
        it has none.
    """
    used = station.status().calibration
    if not used:
        raise NotFound(f"the station at {station.address} has no calibration; name one in its configuration")
    found: Calibration = station.get(used)
    return found
