"""The HDF5 side of a recording: contiguous datasets laid out early, attributes, and reading them back.

Owns names and types inside the file; `preface` owns the block before it. The arrays' bytes are not
written here but at the offsets that `lay_out` returns. Nothing is pickled, and reading takes no type that
could make Python run anything.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
import msgspec
import numpy as np
from h5py import h5d, h5p, h5s, h5t

from fringed.data import Array
from fringed.errors import RecordingError
from fringed.recording.disk import read_at
from fringed.recording.facts import AXES, UNITS, attributes
from fringed.recording.preface import FORMAT, LARGE_BYTES, block_bytes
from fringed.wire import DTYPES, Encoded, checksum

FORMAT_NAME = "fringed-recording"
_PAGE_BYTES = 4096

Headers = Sequence[Mapping[str, Any]]


def lay_out(path: Path, headers: Headers, encoded: Encoded | None = None, record_id: str = "") -> dict[str, int | None]:
    """Make the file with room for every array; return the offset of each, None for an empty one.

    With `encoded` its attributes are written too; otherwise `annotate` does that later.
    """
    large = sum(nbytes(header) >= LARGE_BYTES for header in headers)
    with h5py.File(
        path,
        "w",
        userblock_size=block_bytes(large),
        locking=False,  # the writer holds a lock of its own, which tells a living writer from a dead one
        alignment_threshold=LARGE_BYTES,
        alignment_interval=_PAGE_BYTES,
    ) as file:
        offsets = {header["path"]: _make_dataset(file, header) for header in headers}
        for header in headers:
            if "xxh3" in header:
                _describe(file[header["path"]], header)
        if encoded is not None:
            _annotate(file, encoded, record_id)
    return offsets


def annotate(path: Path, encoded: Encoded, record_id: str, described: Collection[str]) -> None:
    """Write the tree and the attributes into a file that `lay_out` made; `described` arrays have theirs."""
    with h5py.File(path, "r+", locking=False) as file:
        _annotate(file, encoded, record_id)
        for header in encoded.headers:
            if header["path"] not in described:
                _describe(file[header["path"]], header)


def nbytes(header: Mapping[str, Any]) -> int:
    """Return the size of the array that a wire header describes."""
    return int(prod(header["shape"]) * np.dtype(header["dtype"]).itemsize)


def _make_dataset(file: h5py.File, header: Mapping[str, Any]) -> int | None:
    create = h5p.create(h5p.DATASET_CREATE)
    create.set_layout(h5d.CONTIGUOUS)
    create.set_alloc_time(h5d.ALLOC_TIME_EARLY)
    create.set_fill_time(h5d.FILL_TIME_NEVER)
    link = h5p.create(h5p.LINK_CREATE)
    link.set_create_intermediate_group(True)
    link.set_char_encoding(h5t.CSET_UTF8)
    shape = tuple(header["shape"])
    space = h5s.create_simple(shape) if shape else h5s.create(h5s.SCALAR)
    kind = h5t.py_create(np.dtype(header["dtype"]), logical=True)
    offset = h5d.create(file.id, header["path"].encode(), kind, space, create, link).get_offset()
    return int(offset) if offset is not None and 0 not in shape else None


def _annotate(file: h5py.File, encoded: Encoded, record_id: str) -> None:
    file.attrs["format"] = FORMAT_NAME
    file.attrs["format_version"] = FORMAT
    for name, value in attributes(encoded, record_id).items():
        file.attrs[name] = value
    file.attrs["tree"] = msgspec.json.encode(encoded.body).decode()


def _describe(dataset: h5py.Dataset, header: Mapping[str, Any]) -> None:
    dataset.attrs["xxh3"] = header["xxh3"]
    name = header["path"].rpartition("/")[2]
    for suffix, units in UNITS.items():
        if name.endswith(suffix):
            dataset.attrs["units"] = units
    if name in AXES and "/" not in header["path"]:
        dataset.attrs["axes"] = AXES[name]


@contextmanager
def _refusing(name: str) -> Iterator[None]:
    """Turn whatever h5py finds wrong into a RecordingError."""
    try:
        yield
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, RecordingError):
            raise
        raise RecordingError(f"{name} cannot be read as a recording: {error}") from error


def read(path: Path, fd: int, verify: bool) -> tuple[str, dict[str, Any], dict[str, Array]]:
    """Return kind, tree and arrays by path; `fd` is the same file, open for reading.

    Raises
    ------
    RecordingError
        what HDF5 or this format does not allow, or a checksum that does not match.
    """
    with _refusing(path.name), h5py.File(path, "r", locking=False) as file:
        kind, tree = str(file.attrs["kind"]), msgspec.json.decode(str(file.attrs["tree"]))
        if not isinstance(tree, dict):
            raise RecordingError(f"{path.name} has a tree that is no object")
        arrays: dict[str, Array] = {}

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                arrays[name] = _read_array(path.name, item, fd, verify)

        file.visititems(visit)
        return kind, tree, arrays


def _read_array(name: str, dataset: h5py.Dataset, fd: int, verify: bool) -> Array:
    where = f"{name}{dataset.name}"
    if dataset.dtype.str not in DTYPES:
        raise RecordingError(f"{where} is of type {dataset.dtype}; a recording holds {', '.join(sorted(DTYPES))}")
    offset = dataset.id.get_offset()
    size = prod(dataset.shape) * dataset.dtype.itemsize
    if size > os.fstat(fd).st_size:
        raise RecordingError(f"{where} claims {size} bytes; the file has {os.fstat(fd).st_size}")
    array: Array = np.empty(dataset.shape, dataset.dtype)
    if size and (offset is None or read_at(fd, array.reshape(-1).view(np.uint8).data, offset) != size):
        raise RecordingError(f"{where} is not stored contiguously, or is cut short; a recording is never repacked")
    if verify and checksum(array) != dataset.attrs.get("xxh3"):
        raise RecordingError(f"{where} does not match its checksum; it was damaged on the disk: restore it from a copy")
    array.flags.writeable = False
    return array
