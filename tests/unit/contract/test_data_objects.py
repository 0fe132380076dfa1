"""Data objects refuse what contradicts itself, never change, and get ids that sort by time."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fringed import data
from fringed.errors import DataError

EYE = np.eye(4)
PATTERN = np.zeros((1, 8, 1), np.uint8)
IMAGE = np.zeros((3, 4), np.float32)
MASK = np.zeros((3, 4), np.uint8)
XYZ = np.zeros((3, 4, 3), np.float32)


def sequence(count: int = 2) -> data.PatternSequence:
    frames = tuple(data.PatternFrame("sine", step=k, steps=2, group=k // 2) for k in range(count))
    return data.PatternSequence("x", 8, 6, frames, (PATTERN,) * count)


def test_ids_sort_by_time_and_never_repeat() -> None:
    ids = [data.new_id() for _ in range(5000)]
    assert ids == sorted(ids)
    assert len({one[:-5] for one in ids}) == 5000  # their times alone are different
    assert all(re.fullmatch(r"\d{8}T\d{6}\.\d{6}Z-[0-9a-f]{4}", one) for one in ids)


def test_ids_of_several_threads_never_repeat() -> None:
    found: list[str] = []

    def work() -> None:
        mine = [data.new_id() for _ in range(500)]
        assert mine == sorted(mine)
        found.extend(mine)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({one[:-5] for one in found}) == 2000


def test_ids_go_on_when_the_clock_is_set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    before = data.new_id()
    monkeypatch.setattr(time, "time_ns", lambda: 10**18)
    assert data.new_id() > before


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: data.PatternSequence("x", 8, 6, (), ()), "at least one"),
        (lambda: data.PatternSequence("x", 8, 6, (data.PatternFrame("s"),), ()), "1 frames and 0 patterns"),
        (lambda: data.PatternSequence("x", 9, 6, (data.PatternFrame("s"),), (PATTERN,)), r"\(6 or 1, 9 or 1, 1 or 3\)"),
        (lambda: data.FrameSet(np.zeros((2, 3, 4), np.float32), sequence()), "uint8 or uint16"),
        (lambda: data.FrameSet(np.zeros((2, 0, 4), np.uint8), sequence()), "none of them zero"),
        (lambda: data.FrameSet(np.zeros((3, 4), np.uint8), sequence()), r"\(n, height, width\)"),
        (lambda: data.FrameSet(np.zeros((3, 3, 4), np.uint8), sequence()), "3 frames for a sequence of 2"),
        (
            lambda: data.FrameSet(np.zeros((2, 3, 4), np.uint8), sequence(), stamps=(data.FrameStamp(0, 0, 0, 0),)),
            "1 stamps for 2 frames",
        ),
        (lambda: data.PhaseMap(IMAGE[0], IMAGE, IMAGE, MASK, "wrapped", 8.0), "phase map is"),
        (lambda: data.PhaseMap(IMAGE, IMAGE, IMAGE[1:], MASK, "wrapped", 8.0), "siblings have"),
        (lambda: data.Lens(4, 3, np.eye(4), np.zeros(5)), r"\(3, 3\) matrix and 5"),
        (lambda: data.RangeImage(IMAGE, MASK, MASK), r"\(height, width, 3\)"),
        (lambda: data.RangeImage(XYZ, MASK[1:], MASK), "siblings have"),
        (lambda: data.Registration("a", "b", np.eye(3), True, "", 0.0, 0.0), r"expected \(4, 4\)"),
        (lambda: data.Model(XYZ, XYZ, MASK), r"expected \(n, 3\)"),
        (lambda: data.Model(XYZ[0], XYZ[0, 1:], MASK[0]), "normals"),
        (lambda: data.Truth(XYZ, XYZ, MASK, MASK, MASK, EYE), "projector_px"),
        (lambda: data.Truth(XYZ, XYZ[..., :2], MASK[1:], MASK, MASK, EYE), "truth"),
        (lambda: data.Mesh(np.zeros((3, 2)), np.zeros((1, 3), np.int32)), r"vertices_mm .* expected \(n, 3\)"),
        (lambda: data.Mesh(np.zeros((3, 3)), np.zeros((1, 4), np.int32)), "faces"),
    ],
)
def test_contradictions_are_refused_with_shapes(make: Callable[[], Any], why: str) -> None:
    with pytest.raises(DataError, match=why):
        make()


def test_arrays_are_read_only_and_c_ordered() -> None:
    frames = np.asfortranarray(np.zeros((2, 3, 4), np.uint8))
    item = data.FrameSet(frames, sequence())
    assert item.frames.flags.c_contiguous
    for array in (item.frames, item.sequence.patterns[0]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    frames[0] = 5  # what the caller keeps is its own business


def test_arrays_that_fit_are_not_copied() -> None:
    frames = np.zeros((2, 3, 4), np.uint8)
    assert np.shares_memory(data.FrameSet(frames, sequence()).frames, frames)


def test_frames_of_foreign_byte_order_are_turned() -> None:
    frames = np.arange(24, dtype=">u2").reshape(2, 3, 4)
    item = data.FrameSet(frames, sequence())
    assert item.frames.dtype == np.uint16
    assert np.array_equal(item.frames, frames)


def test_faces_of_python_integers_are_taken() -> None:
    mesh = data.Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    assert mesh.faces.dtype == np.int32
    with pytest.raises(DataError, match="do not fit"):
        data.Mesh(np.zeros((3, 3)), np.array([[0, 1, 2**40]]))


def test_groups_keep_the_order_of_frames() -> None:
    assert sequence(4).groups() == {0: (0, 1), 1: (2, 3)}


def test_calibration_hash_follows_geometry_only() -> None:
    lens = data.Lens(4, 3, np.eye(3), np.zeros(5))

    def calibration(**more: Any) -> data.Calibration:
        known = {"camera": lens, "projector": lens, "T_projector_camera": EYE, "rig": "a", "source": "b"}
        return data.Calibration(**{**known, **more})

    assert calibration().hash == calibration(rig="other", id="x", residuals={"rms": 1.0}).hash
    moved = EYE.copy()
    moved[0, 3] = 1e-9
    others = [
        calibration(T_projector_camera=moved),
        calibration(reference_plane=np.array([0, 0, 1.0, 0])),
        calibration(camera=data.Lens(5, 3, np.eye(3), np.zeros(5))),
        calibration(projector=data.Lens(4, 3, np.eye(3), np.full(5, 1e-9))),
    ]
    assert len({c.hash for c in (calibration(), *others)}) == 5
