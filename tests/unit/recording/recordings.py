"""Small objects of every recorded kind, for the tests of the store."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from fringed import data
from fringed.data import new_id

RNG = np.random.default_rng(7)


def sequence(steps: int = 4) -> data.PatternSequence:
    frames = tuple(data.PatternFrame("sine", period_px=16.0, step=k, steps=steps) for k in range(steps))
    patterns = tuple(RNG.integers(0, 255, (1, 64, 1), dtype=np.uint8) for _ in range(steps))
    return data.PatternSequence("phase-shift", 64, 48, frames, patterns, parameters={"periods": 4})


def provenance() -> data.Provenance:
    return data.Provenance(
        inputs=("a", "b"), plugin="phase-shift", plugin_version="1.2", parameters={"x": {"y": [1, 2.5, None]}},
        calibration="00ff", rig="rig-1", software="fringed 0", created="2026-01-02T03:04:05+00:00", simulated=True,
    )  # fmt: skip


def frame_set(height: int = 6, width: int = 8, dtype: Any = np.uint8, **more: Any) -> data.FrameSet:
    frames = RNG.integers(0, 255, (4, height, width)).astype(dtype)
    stamps = tuple(data.FrameStamp(k + 0.1, k + 0.2, k + 0.3, k) for k in range(4))
    known = {"id": new_id(), "scan": "scan-1", "stamps": stamps, "provenance": provenance()}
    check = data.CheckReport(True, (data.CheckFinding("late", "not really", (1,)),), residual=float("nan"))
    return data.FrameSet(frames, sequence(), **{**known, "check": check, **more})


def range_image(height: int = 5, width: int = 7) -> data.RangeImage:
    xyz = RNG.normal(size=(height, width, 3)).astype(np.float32)
    xyz[0, 0] = np.nan
    image = np.zeros((height, width), np.uint8)
    return data.RangeImage(xyz, image, image, id=new_id(), scan="scan-1", provenance=provenance())


def every_kind() -> list[Any]:
    """Return one object of each recorded kind that has an id."""
    image, lens = np.ones((5, 7), np.float32), data.Lens(7, 5, np.eye(3), np.zeros(5))
    points = RNG.normal(size=(9, 3)).astype(np.float32)
    rejected, grey = np.zeros((5, 7), np.uint8), np.zeros(9, np.uint8)
    faces = np.array([[0, 1, 2]], np.int32)
    registration = data.Registration(
        "a", "b", np.eye(4), False, "too few pairs", float("inf"), 0.5,
        history=(data.IterationRecord(0.1, 5, 1.0, 0.0, 0.0, "coarse"),), id=new_id(),
    )  # fmt: skip
    xyz = np.zeros((5, 7, 3), np.float32)
    truth = data.Truth(
        xyz, xyz[..., :2], rejected, rejected, rejected, np.eye(4), scene={"shape": "plane"}, id=new_id()
    )
    return [
        frame_set(),
        frame_set(dtype=np.uint16),
        data.PhaseMap(image, image, image, rejected, "wrapped", 16.0, id=new_id()),
        data.Calibration(lens, lens, np.eye(4), "rig-1", "exact-simulated", residuals={"rms_px": 0.1}, id=new_id()),
        range_image(),
        registration,
        data.Model(points, points, grey, ("a", "b"), np.zeros((2, 4, 4)), (registration,), id=new_id()),
        truth,
        data.Mesh(points.astype(float), faces, id=new_id()),
        data.Artifact("model.ply", "model/ply", np.frombuffer(b"ply\n", np.uint8), id=new_id()),
    ]


def same(one: Any, other: Any) -> bool:
    """Compare dataclasses deeply; arrays by dtype, shape and bits, numbers with NaN equal to itself."""
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    if dataclasses.is_dataclass(one):
        names = [f.name for f in dataclasses.fields(one)]
        return type(one) is type(other) and all(same(getattr(one, n), getattr(other, n)) for n in names)
    if isinstance(one, (tuple, list)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    return bool(one == other or (one != one and other != other))
