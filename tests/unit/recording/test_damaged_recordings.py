"""Truncated, flipped and foreign files are refused with what is wrong, whatever was done to them."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from recordings import every_kind, frame_set, range_image, same

from fringed.data import new_id
from fringed.errors import NotFound, RecordingError
from fringed.recording import Store
from fringed.recording.preface import Preface, Summary, block_bytes, decode, encode
from fringed.recording.store import load_file, summary_of_file


def test_every_truncation_is_refused(store: Store) -> None:
    path = store.save(frame_set())
    whole = path.read_bytes()
    lengths = {0, 1, 30, 4095, 4096, len(whole) - 1, *np.random.default_rng(1).integers(0, len(whole), 60).tolist()}
    for length in sorted(lengths):
        path.write_bytes(whole[:length])
        with pytest.raises(RecordingError, match=r"truncated|not a recording"):
            load_file(path)


def test_bytes_appended_are_refused(store: Store) -> None:
    path = store.save(frame_set())
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(RecordingError, match="longer than it was"):
        load_file(path)


def test_no_flipped_bit_is_ever_returned(store: Store) -> None:
    """Every byte counts: each flip outside the first block's padding is refused, and inside it harms nothing."""
    item = frame_set(200, 400)
    path = store.save(item)
    whole = path.read_bytes()
    rng = np.random.default_rng(2)
    positions = [*rng.integers(0, 600, 60), *rng.integers(4096, 9000, 150), *rng.integers(0, len(whole), 60)]
    for position in map(int, positions):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << int(rng.integers(0, 8))
        path.write_bytes(damaged)
        try:
            back = load_file(path)
        except RecordingError:
            continue
        assert position < 4096 and same(back, item), f"a bit at {position} was flipped and not found"


def test_damage_of_frames_names_the_dataset(store: Store) -> None:
    item = frame_set(200, 400)
    path = store.save(item)
    with h5py.File(path) as file:
        offset = file["frames"].id.get_offset()
    with path.open("r+b") as raw:
        raw.seek(offset + 1000)
        raw.write(b"\xff\x00\xff\x00")
    with pytest.raises(RecordingError, match=r"frames does not match its checksum; .*restore it from a copy"):
        store.load(item.id)
    assert store.load(item.id, verify=False).frames.shape == item.frames.shape


def test_file_changed_by_another_program_is_refused(store: Store) -> None:
    item = range_image()
    path = store.save(item)
    with h5py.File(path, "r+") as file:
        file.attrs["scan"] = "another"
    with pytest.raises(RecordingError):
        load_file(path)


class Bomb:
    """Unpickling this would call os._exit."""

    def __reduce__(self) -> Any:
        return os._exit, (66,)


@pytest.mark.parametrize(
    "content",
    [b"", b"\0" * 5000, b"\x89HDF\r\n\x1a\n" + b"\0" * 100, b"hello", pickle.dumps(Bomb()), b"fringed-recording 1 2\n"],
    ids=["empty", "zeros", "hdf5 signature", "text", "pickle", "half a line"],
)
def test_foreign_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.h5"
    path.write_bytes(content)
    for read in (load_file, summary_of_file):
        with pytest.raises(RecordingError, match="not a recording of this station"):
            read(path)


def test_somebody_elses_hdf5_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.h5"
    with h5py.File(path, "w") as file:
        file["frames"] = np.zeros((4, 6, 8), np.uint8)
    with pytest.raises(RecordingError, match=r"capture\.toml"):
        load_file(path)


def test_other_format_versions_are_refused_with_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "x.h5"
    path.write_bytes(b"fringed-recording 2 2 0123456789abcdef\n{}\n")
    with pytest.raises(RecordingError, match="format 2; this release reads format 1: install"):
        load_file(path)


def test_missing_files_are_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        load_file(tmp_path / "x.h5")
    with pytest.raises(NotFound):
        load_file(Path("/dev/null/x.h5"))


def sealed(path: Path, make: Any) -> Path:
    """Write an HDF5 file of any content with a preface that makes it whole."""
    from fringed.recording.sealing import seal

    with h5py.File(path, "w", userblock_size=4096) as file:
        make(file)
    fd = os.open(path, os.O_RDWR)
    seal(fd, Summary(id=new_id(), kind="FrameSet"), [])
    os.close(fd)
    return path


def object_array(file: h5py.File) -> None:
    file["frames"] = np.array(["a", "b"], dtype=h5py.string_dtype())
    file.attrs.update(kind="FrameSet", tree="{}")


def chunked(file: h5py.File) -> None:
    file.create_dataset("frames", data=np.zeros((4, 6, 8), np.uint8), compression="gzip")
    file.attrs.update(kind="FrameSet", tree="{}")


def external(file: h5py.File) -> None:
    file.create_dataset("frames", (4, 6, 8), np.uint8, external=[("/etc/passwd", 0, 192)])
    file.attrs.update(kind="FrameSet", tree="{}")


def attributes(**values: Any) -> Any:
    return lambda file: file.attrs.update(values)


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (object_array, "is of type object"),
        (chunked, "not stored contiguously"),
        (external, r"not stored contiguously|checksum"),
        (attributes(), "tree|kind"),
        (attributes(kind="FrameSet", tree="no json"), "cannot be read"),
        (attributes(kind="FrameSet", tree="[]"), "no object"),
        (attributes(kind="Request", tree="{}"), "holds a 'Request'"),
        (attributes(kind="Os", tree="{}"), "holds a 'Os'"),
        (attributes(kind="FrameSet", tree="{}"), "cannot read: not a valid FrameSet"),
        (attributes(kind="FrameSet", tree='{"frames": {"$array": "frames"}}'), "names the array 'frames'"),
    ],
)
def test_whole_files_of_impossible_content_are_refused(tmp_path: Path, make: Any, why: str) -> None:
    with pytest.raises(RecordingError, match=why):
        load_file(sealed(tmp_path / "x.h5", make))


def test_prefaces_with_impossible_extents_are_refused(store: Store) -> None:
    path = store.save(range_image())
    whole = path.read_bytes()
    right = decode(whole[:4096], "x")
    for extents in ([(0, 10)], [(2**40, 1)], [(4096, 2**40)], [(5000, 100), (4500, 100)], [(5000, -1)]):
        wrong = Preface(summary=right.summary, extents=extents, meta_xxh3=right.meta_xxh3)
        path.write_bytes(encode(wrong) + whole[4096:])
        with pytest.raises(RecordingError, match="extents that it does not have"):
            load_file(path)


def test_first_block_has_room_for_the_longest_summary() -> None:
    text = "\0" * 120  # six bytes each in JSON
    for count in (0, 1, 63, 64, 65, 4096):
        summary = Summary(id="x" * 32, kind="PatternSequence", created=text, scan=text, summary=text)
        preface = Preface(
            summary=summary, block=block_bytes(count), extents=[(2**43 + k, 2**40) for k in range(count)]
        )  # fmt: skip
        assert len(encode(preface)) == preface.block


def test_reading_never_changes_a_file(store: Store) -> None:
    for item in every_kind():
        path = store.save(item)
        before = path.read_bytes(), path.stat().st_mtime_ns
        path.chmod(0o400)
        store.load(item.id)
        assert (path.read_bytes(), path.stat().st_mtime_ns) == before
