"""What is recorded comes back bit for bit, is found by its id, and is listed newest first."""

from __future__ import annotations

import errno
import logging
import os
import pickle
import shutil
import threading
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from recordings import every_kind, frame_set, range_image, same, sequence

from fringed import data, wire
from fringed.data import new_id
from fringed.errors import DataError, NotFound, RecordingError, StorageError, UsageError
from fringed.recording import Store


@pytest.mark.parametrize("item", every_kind(), ids=lambda item: type(item).__name__)
def test_every_kind_comes_back_bit_for_bit(store: Store, item: Any) -> None:
    store.save(item)
    back = store.load(item.id)
    assert same(item, back)


def test_a_sequence_is_recorded_under_an_id_that_is_given(store: Store) -> None:
    item, record_id = sequence(), new_id()
    store.save(item, record_id)
    assert same(store.load(record_id), item)


def test_loaded_arrays_are_read_only(store: Store) -> None:
    item = range_image()
    store.save(item)
    with pytest.raises(ValueError, match="read-only"):
        store.load(item.id).xyz_mm[0] = 0


def test_awkward_provenance_survives(store: Store) -> None:
    parameters = {
        "a/b": np.arange(3.0), "a": {"b": np.arange(2.0), "": np.arange(1.0), ".": np.arange(4.0)}, "$array": "no",
        "inf": float("-inf"), "ü\0": np.zeros((0, 4), np.float32), "scalar": np.array(2.5),
    }  # fmt: skip
    item = data.Mesh(np.zeros((1, 3)), np.zeros((0, 3), np.int32), id=new_id(), provenance=data.Provenance(parameters=parameters))  # fmt: skip  # noqa: E501
    store.save(item)
    assert same(store.load(item.id), item)


def test_big_provenance_is_no_problem(store: Store) -> None:
    history = tuple(data.IterationRecord(float(k), k, 1.0, 0.0, 0.0) for k in range(5000))
    item = data.Registration("a", "b", np.eye(4), True, "ok", 0.1, 0.9, history=history, id=new_id())
    store.save(item)
    assert same(store.load(item.id), item)


def test_many_large_arrays_have_room_in_the_first_block(store: Store) -> None:
    parameters = {str(k): np.full(70_000, k, np.uint8) for k in range(150)}
    item = data.Mesh(np.zeros((1, 3)), np.zeros((0, 3), np.int32), id=new_id(), provenance=data.Provenance(parameters=parameters))  # fmt: skip  # noqa: E501
    store.save(item)
    assert same(store.load(item.id), item)
    assert Store(store.data_dir).list()[0]["id"] == item.id


def test_plain_h5py_reads_it(store: Store) -> None:
    item = frame_set()
    with h5py.File(store.save(item)) as file:
        assert np.array_equal(file["frames"][:], item.frames)
        assert np.array_equal(file["sequence/patterns/1"][:], item.sequence.patterns[1])
        assert file["frames"].chunks is None
        attributes = {name: file.attrs[name] for name in ("kind", "id", "scan", "role", "simulated", "rig", "plugin")}
        assert attributes == {
            "kind": "FrameSet", "id": item.id, "scan": "scan-1", "role": "object", "simulated": True, "rig": "rig-1",
            "plugin": "phase-shift",
        }  # fmt: skip
        assert file["frames"].attrs["xxh3"] == wire.checksum(item.frames)


def test_nothing_in_a_file_is_a_pickle(store: Store) -> None:
    for item in every_kind():
        content = store.save(item).read_bytes()
        assert pickle.dumps(item)[:8] not in content
        with h5py.File(store.path_of(item.id)) as file:
            kinds: list[Any] = []
            file.visititems(lambda _, node, kinds=kinds: kinds.append(getattr(node, "dtype", None)))
            assert not [k for k in kinds if k is not None and k.hasobject]


def test_files_are_sorted_by_day_and_named_by_id_and_kind(store: Store) -> None:
    item = range_image()
    day = (item.id[:4], item.id[4:6], item.id[6:8])
    assert store.save(item) == store.data_dir.joinpath(*day, f"{item.id}.range-image.h5") == store.path_of(item.id)


def test_encoded_objects_are_not_encoded_again(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    item = range_image()
    encoded = wire.prepare(item)
    monkeypatch.setattr("fringed.recording.store.prepare", lambda _: pytest.fail("encoded twice"))
    store.save(item, encoded=encoded)
    assert same(store.load(item.id), item)


def test_a_recording_is_never_overwritten(store: Store) -> None:
    item = range_image()
    path = store.save(item)
    before = path.read_bytes()
    with pytest.raises(UsageError, match="never overwritten"):
        store.save(item)
    assert path.read_bytes() == before
    assert not list(store.data_dir.rglob("*.part"))


@pytest.mark.parametrize("wrong", ["", "x", "../../etc/passwd", "20260102T030405.678901Z-1f0c/../x", "2026"])
def test_what_is_no_id_is_refused(store: Store, wrong: str) -> None:
    with pytest.raises(UsageError, match="is not an id"):
        store.load(wrong)


def test_unknown_id_is_not_found(store: Store) -> None:
    with pytest.raises(NotFound, match="nothing is recorded under"):
        store.load("20260102T030405.678901Z-1f0c")
    with pytest.raises(NotFound):
        store.path_of("20260102T030405.678901Z-1f0c")


def test_what_is_not_recorded_is_refused(store: Store) -> None:
    with pytest.raises(DataError, match="has no id"):
        store.save(data.Mesh(np.zeros((1, 3)), np.zeros((0, 3), np.int32)))
    with pytest.raises(DataError, match="a dict is not recorded"):
        store.save({"id": 1})
    with pytest.raises(DataError, match="cannot be recorded as"):
        store.save(range_image(), new_id())


def test_listing_is_newest_first_and_pages(store: Store) -> None:
    items = [range_image() for _ in range(7)]
    for item in items:
        store.save(item)
    ids = [item.id for item in reversed(items)]
    first = store.list(limit=3)
    rest = store.list(limit=100, before=first[-1]["id"])
    assert [entry["id"] for entry in (*first, *rest)] == ids
    assert store.list(limit=0) == []
    with pytest.raises(UsageError):
        store.list(limit=-1)


@pytest.mark.parametrize("fresh", [False, True], ids=["remembered", "read from the files"])
def test_listing_tells_what_a_file_holds(store: Store, fresh: bool) -> None:
    items = {type(item).__name__: item for item in every_kind()}
    paths = {kind: store.save(item) for kind, item in items.items()}
    listed = {entry["kind"]: entry for entry in (Store(store.data_dir) if fresh else store).list()}
    assert listed.keys() == items.keys()
    entry = listed["FrameSet"]
    assert entry == {
        "id": items["FrameSet"].id, "kind": "FrameSet", "created": "2026-01-02T03:04:05+00:00", "scan": "scan-1",
        "role": "object", "bytes": paths["FrameSet"].stat().st_size, "simulated": True, "replayed": False,
        "summary": "4 frames 8 x 6 phase-shift 16-bit",
    }  # fmt: skip
    assert listed["Mesh"]["created"].startswith(f"{items['Mesh'].id[:4]}-")
    assert listed["Registration"]["summary"] == "not converged: too few pairs, rms inf mm"
    assert all(entry["summary"] for entry in listed.values())


@pytest.mark.parametrize("kind", ["RangeImage", "range-image", "rangeimage"])
def test_listing_filters_by_kind_and_scan(store: Store, kind: str) -> None:
    for item in every_kind():
        store.save(item)
    assert [e["kind"] for e in store.list(kind=kind)] == ["RangeImage"]
    assert {e["kind"] for e in store.list(scan="scan-1")} == {"RangeImage", "FrameSet"}
    assert store.list(scan="scan-2") == []
    with pytest.raises(UsageError, match="there are artifact"):
        store.list(kind="photo")


def test_listing_goes_back_over_days(store: Store) -> None:
    ids = ["20251231T235959.999999Z-0001", "20260101T000000.000000Z-0002", "20260201T000000.000000Z-0003"]
    for record_id in ids:
        store.save(frame_set(id=record_id))
    assert [e["id"] for e in store.list()] == ids[::-1]
    assert [e["id"] for e in store.list(before="20260101")] == ids[:1]
    assert [e["id"] for e in store.list(before=ids[2])] == ids[1::-1]


def test_foreign_files_and_folders_do_not_disturb(store: Store) -> None:
    item = range_image()
    folder = store.save(item).parent
    (folder / "notes.txt").write_text("mine")
    (folder / "other.h5").write_text("mine")
    (folder / "20260102T030405.678901Z-1f0c.photo.h5").write_text("mine")
    (store.data_dir / "lost+found").mkdir()
    (store.data_dir / "2026.txt").write_text("")
    assert [e["id"] for e in Store(store.data_dir).list()] == [item.id]


def test_a_damaged_file_is_listed_as_such(store: Store) -> None:
    item = range_image()
    store.save(item).write_bytes(b"\0" * 100)
    (entry,) = Store(store.data_dir).list()
    assert entry["id"] == item.id and entry["summary"].startswith("unreadable")


def test_a_renamed_file_is_not_taken_for_another(store: Store) -> None:
    item, other_id = range_image(), new_id()
    path = store.save(item)
    path.rename(path.with_name(f"{other_id}.range-image.h5"))
    with pytest.raises(RecordingError, match=f"it holds {item.id}; give it its name back"):
        store.load(other_id)
    (entry,) = Store(store.data_dir).list()
    assert entry["id"] == other_id and "renamed" in entry["summary"]


def test_a_file_removed_by_hand_is_gone(store: Store) -> None:
    item = range_image()
    store.save(item).unlink()
    assert store.list() == []
    with pytest.raises(NotFound):
        store.load(item.id)


def test_an_empty_store_lists_nothing(tmp_path: Path) -> None:
    assert Store(tmp_path / "nowhere").list() == []
    assert Store(tmp_path / "nowhere").free_bytes() == 0


def test_unfinished_files_are_removed_counted_and_logged(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    item = range_image()
    left = [f"{store.save(item)}.part", str(store.data_dir / "quarantine.json.part")]
    for path in left:
        Path(path).write_bytes(b"half")
    with caplog.at_level(logging.WARNING):
        assert Store(store.data_dir).recover() == 2
    assert "2 unfinished recordings removed" in caplog.text
    assert not any(Path(path).exists() for path in left)
    assert same(store.load(item.id), item)
    assert Store(store.data_dir).recover() == 0


def test_recovery_leaves_a_living_writer_alone(store: Store) -> None:
    item = frame_set()
    writer = store.begin_set(item.id, item.sequence, item.frames.shape, item.frames.dtype)
    assert Store(store.data_dir).recover() == 0
    writer.commit(item)
    assert same(store.load(item.id), item)


def test_several_threads_may_save_and_list(store: Store) -> None:
    items = [range_image() for _ in range(40)]

    def work(mine: list[data.RangeImage]) -> None:
        for item in mine:
            store.save(item)
            assert item.id in {entry["id"] for entry in store.list()}

    threads = [threading.Thread(target=work, args=(items[k::4],)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(store.list()) == 40
    assert all(same(store.load(item.id), item) for item in items)


def test_full_disk_says_so_and_leaves_nothing(small_disk: Path) -> None:
    store = Store(small_disk)
    store.recover()
    big = range_image(400, 300)  # 1.4 MB of points
    with pytest.raises(StorageError, match=r"is full: [12]\.\d MB needed, [01]\.\d MB free; remove") as caught:
        store.save(big)
    assert str(small_disk) in str(caught.value)
    assert not [p for p in small_disk.rglob("*") if p.is_file()]
    small = range_image()
    store.save(small)
    assert same(store.load(small.id), small)


def test_disk_that_fills_up_meanwhile_gives_the_set_up(small_disk: Path) -> None:
    store, item = Store(small_disk), frame_set(200, 200)
    writer = store.begin_set(item.id, item.sequence, (200, 200), np.uint8)
    (small_disk / "somebody-else").write_bytes(b"x" * store.free_bytes())
    for index, frame in enumerate(item.frames):
        writer.write(index, frame)  # its room was taken at the beginning
    with pytest.raises(StorageError, match="is full"):
        store.save(range_image(50, 50))
    writer.abort()
    assert [p.name for p in small_disk.rglob("*") if p.is_file()] == ["somebody-else"]


def test_nothing_stays_visible_where_the_folder_cannot_be_synced(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: Path) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("fringed.recording.partial.sync_folder", fail)
    with pytest.raises(StorageError):
        store.save(range_image())
    assert store.list() == []
    assert not [p for p in store.data_dir.rglob("*") if p.is_file()]


def test_unwritable_folder_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    store = Store(tmp_path / "file")
    for attempt in (store.recover, lambda: store.save(range_image())):
        with pytest.raises(StorageError, match="file"):
            attempt()


@pytest.mark.skipif(os.getuid() == 0, reason="root may write everywhere")
def test_folder_without_the_right_to_write_says_so(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(StorageError, match="cannot be written"):
        Store(tmp_path).recover()


def test_vanished_folder_says_so(store: Store) -> None:
    item = frame_set()
    writer = store.begin_set(item.id, item.sequence, item.frames.shape, item.frames.dtype)
    shutil.rmtree(store.data_dir)
    with pytest.raises(StorageError, match="has vanished"):
        writer.commit(item)
    assert store.list() == []
