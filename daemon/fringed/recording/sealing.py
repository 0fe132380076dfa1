"""Make a written file whole, and tell whether one is: its size, its extents, the checksum of the rest.

Owns how a preface is computed and checked; knows nothing of HDF5.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import xxhash

from fringed.errors import RecordingError
from fringed.recording import preface
from fringed.recording.disk import read_at, write_at
from fringed.recording.preface import Preface, Summary


def seal(fd: int, summary: Summary, extents: list[tuple[int, int]]) -> Summary:
    """Write the preface of a file that is otherwise finished; return its summary with the file's size."""
    size = os.fstat(fd).st_size
    final = Summary(**{**{name: getattr(summary, name) for name in Summary.__struct_fields__}, "bytes": size})
    block = preface.block_bytes(len(extents))
    ordered = sorted(extents)
    digest = meta_xxh3(fd, block, size, ordered)
    write_at(fd, preface.encode(Preface(summary=final, block=block, extents=ordered, meta_xxh3=digest)), 0)
    return final


def read_preface(fd: int, name: str) -> Preface:
    """Return what stands in the file's first block.

    Raises
    ------
    RecordingError
        a foreign file, one of another version, or a damaged block.
    """
    start = os.pread(fd, preface.BLOCK_BYTES, 0)
    wanted = preface.length(start, name)
    if wanted > len(start) == preface.BLOCK_BYTES:
        start += os.pread(fd, min(wanted, os.fstat(fd).st_size) - len(start), len(start))
    return preface.decode(start, name)


def check_whole(fd: int, found: Preface, name: str) -> None:
    """Check size and structure, before anything parses them.

    Raises
    ------
    RecordingError
        a truncated or damaged file.
    """
    size = os.fstat(fd).st_size
    if size != found.summary.bytes:
        what = "truncated" if size < found.summary.bytes else "longer than it was"
        raise RecordingError(
            f"{name} is {what}: it has {size} bytes and was written with {found.summary.bytes}; restore it from a copy"
        )
    try:
        digest = meta_xxh3(fd, found.block, size, found.extents)
    except ValueError as error:
        raise RecordingError(f"{name} describes extents that it does not have: {error}") from error
    if digest != found.meta_xxh3:
        raise RecordingError(f"{name} was damaged or changed since it was written; restore it from a copy")


def meta_xxh3(fd: int, block: int, size: int, extents: list[tuple[int, int]]) -> str:
    """Return the XXH3-64 of the file without its first block and its large arrays."""
    digest = xxhash.xxh3_64()
    for start, end in _gaps(block, size, extents):
        chunk = bytearray(end - start)
        if read_at(fd, memoryview(chunk), start) != len(chunk):
            raise ValueError(f"bytes {start} to {end} are missing")
        digest.update(chunk)
    return str(digest.hexdigest())


def _gaps(block: int, size: int, extents: list[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    at = block
    for offset, length in (*extents, (size, 0)):
        if not at <= offset <= size or not 0 <= length <= size - offset:
            raise ValueError(f"{length} bytes at {offset} of {size}")
        if offset > at:
            yield at, offset
        at = offset + length
