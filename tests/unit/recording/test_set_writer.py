"""A frame set written while its frames arrive is the same as one saved whole."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from recordings import frame_set, same, sequence

from fringed.data import FrameSet, new_id
from fringed.errors import DataError, StorageError, UsageError
from fringed.recording import SetWriter, Store


def begun(store: Store, item: FrameSet) -> SetWriter:
    return store.begin_set(item.id, item.sequence, item.frames.shape[1:], item.frames.dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_frames_written_one_by_one_come_back(store: Store, dtype: type) -> None:
    item = frame_set(40, 2000, dtype)
    writer = begun(store, item)
    for index, frame in enumerate(item.frames):
        writer.write(index, frame)
    path = writer.commit(item)
    assert path == store.path_of(item.id)
    assert same(store.load(item.id), item)
    assert store.list()[0]["id"] == item.id


def test_nothing_is_visible_before_the_commit(store: Store) -> None:
    item = frame_set()
    writer = begun(store, item)
    writer.write(0, item.frames[0])
    assert store.list() == []
    assert not list(store.data_dir.rglob("*.h5"))
    writer.commit(item)
    assert len(store.list()) == 1


def test_retaken_missing_and_unordered_frames_end_up_right(store: Store) -> None:
    item = frame_set()
    writer = begun(store, item)
    writer.write(3, item.frames[3])
    writer.write(0, item.frames[2])  # taken again later, and not written again
    writer.write(1, item.frames[0])
    writer.write(1, item.frames[1])
    writer.commit(item)
    assert same(store.load(item.id), item)


def test_frames_that_are_views_of_other_layout_are_written_right(store: Store) -> None:
    item = frame_set()
    writer = begun(store, item)
    for index, frame in enumerate(item.frames):
        writer.write(index, np.asfortranarray(frame))
    writer.commit(item)
    assert same(store.load(item.id), item)


def test_an_aborted_set_leaves_nothing(store: Store) -> None:
    item = frame_set()
    writer = begun(store, item)
    writer.write(0, item.frames[0])
    writer.abort()
    writer.abort()
    assert not [p for p in store.data_dir.rglob("*") if p.is_file()]
    with pytest.raises(StorageError, match="given up"):
        writer.write(1, item.frames[1])
    with pytest.raises(StorageError, match="given up"):
        writer.commit(item)


def test_abort_after_the_commit_is_harmless(store: Store) -> None:
    item = frame_set()
    writer = begun(store, item)
    writer.commit(item)
    writer.abort()
    assert same(store.load(item.id), item)


def test_a_set_other_than_the_one_begun_is_refused_and_removed(store: Store) -> None:
    item = frame_set()
    others = {
        "writing began as": dataclasses.replace(item, id=new_id()),
        "frames is not what writing began with": dataclasses.replace(item, frames=item.frames[:, 1:]),
        "sequence/patterns/0 is not": dataclasses.replace(item, sequence=sequence()),
    }
    for message, other in others.items():
        writer = begun(store, item)
        with pytest.raises(DataError, match=message):
            writer.commit(other)
        assert not [p for p in store.data_dir.rglob("*") if p.is_file()]


def test_impossible_sets_and_frames_are_refused(store: Store) -> None:
    item = frame_set()
    for shape, dtype in (((3, 6, 8), np.uint8), ((6,), np.uint8), ((0, 8), np.uint8), ((6, 8), np.float32)):
        with pytest.raises(DataError, match="expected"):
            store.begin_set(item.id, item.sequence, shape, dtype)
    with pytest.raises(UsageError, match="is not an id"):
        store.begin_set("mine", item.sequence, (6, 8), np.uint8)
    writer = begun(store, item)
    for index, image in ((4, item.frames[0]), (-1, item.frames[0]), (0, item.frames[0][1:]), (0, item.frames[0] * 1.0)):
        with pytest.raises(DataError, match="expected 0 to 3"):
            writer.write(index, image)
    writer.abort()


def test_the_same_id_is_not_written_twice_at_once(store: Store) -> None:
    item = frame_set()
    writer = begun(store, item)
    with pytest.raises(StorageError):
        begun(store, item)
    writer.commit(item)
    with pytest.raises(UsageError, match="recorded already"):
        begun(store, item)
