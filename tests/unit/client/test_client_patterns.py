"""Patterns as files and pictures: exact pixels, one row for each group, a name for each picture."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from fakestation import FakeStation

from fringed.data import PatternFrame, PatternSequence
from fringed.errors import StorageError, UsageError
from fringed_client import AsyncStation, Station
from fringed_client.pattern_files import describe, file_names, full_picture, group_rows, write_patterns
from fringed_client.pictures.patterns import draw_lines, draw_sheet


def lines(width: int = 40, height: int = 30) -> PatternSequence:
    """Return columns, rows, a coloured shot, two bits and a uniform picture."""
    u, v = np.arange(width), np.arange(height)
    wave = np.rint(127.5 + 127.5 * np.cos(2 * np.pi * np.arange(3)[:, None] / 3 + 2 * np.pi * u / 20)).astype(np.uint8)
    shot = np.ascontiguousarray(wave.T[None])
    frames = [PatternFrame("sinusoidal", period_px=20.0, shift_rad=k * 2.1, step=k, steps=3) for k in range(3)]
    frames += [PatternFrame("sinusoidal", "rows", 15.0, group=1, inverted=True, level=0.5)]
    frames += [PatternFrame("sinusoidal", period_px=20.0, group=2, channel=c, shot=4) for c in ("red", "green", "blue")]
    frames += [PatternFrame("gray", period_px=20.0, group=3, bit=b) for b in (0, 1)]
    frames += [PatternFrame("grey", group=4)]
    pictures = [
        *(w[None, :, None] for w in wave), (v * 4).astype(np.uint8)[:, None, None], shot, shot, shot,
        (255 * (u > 20)).astype(np.uint8)[None, :, None], (255 * (u % 20 > 10)).astype(np.uint8)[None, :, None],
        np.full((1, 1, 1), 9, np.uint8),
    ]  # fmt: skip
    return PatternSequence("test", width, height, tuple(frames), tuple(pictures), encoder="test", parameters={"a": 1})


def test_full_pictures_are_the_lines_on_the_whole_panel() -> None:
    sequence = lines()
    assert full_picture(sequence, 0).shape == (30, 40, 1)
    assert (full_picture(sequence, 0)[:, :, 0] == sequence.patterns[0][0, :, 0]).all()
    assert (full_picture(sequence, 3)[:, 7, 0] == sequence.patterns[3][:, 0, 0]).all()
    assert full_picture(sequence, 9).tolist() == np.full((30, 40, 1), 9).tolist()


def test_files_hold_the_exact_pixels_and_a_description(tmp_path: Path) -> None:
    sequence = lines()
    files = write_patterns(tmp_path / "out", sequence)
    names = file_names(sequence)
    assert names[4:7] == ["pattern-004.png"] * 3  # one exposure is one picture
    assert [path.name for path in files] == [*dict.fromkeys(names), "patterns.json"]
    for index, name in enumerate(names):
        read = cv2.imread(str(tmp_path / "out" / name), cv2.IMREAD_UNCHANGED)
        read = read[:, :, None] if read.ndim == 2 else read[..., ::-1]
        assert np.array_equal(read, full_picture(sequence, index))
    told = json.loads((tmp_path / "out" / "patterns.json").read_text())
    assert told == json.loads(json.dumps(describe(sequence)))
    assert told["width_px"] == 40 and told["frames"][3]["orientation"] == "rows" and told["frames"][3]["inverted"]
    assert [frame["file"] for frame in told["frames"]] == names


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="choose another"):
        write_patterns(tmp_path / "file" / "out", lines())


def test_groups_have_one_row_each() -> None:
    rows = group_rows(lines())
    assert [row["group"] for row in rows] == [0, 1, 2, 3, 4]
    assert rows[0]["shifts_deg"] == pytest.approx([0, 120.321, 240.642], abs=1e-3)
    assert rows[1]["inverted"] == 1 and rows[1]["level"] == 0.5
    assert rows[2]["channel"] == "red, green, blue"
    assert rows[3]["bits"] == [0, 1]


@pytest.mark.parametrize("keep", [slice(None), slice(3, 4), slice(9, 10), slice(7, 9)])
def test_sheet_and_lines_are_drawn_of_every_kind_of_pattern(tmp_path: Path, keep: slice) -> None:
    every = lines()
    sequence = PatternSequence("test", 40, 30, every.frames[keep], every.patterns[keep])
    for draw in (draw_sheet, draw_lines):
        picture = cv2.imread(str(draw(tmp_path / "a.png", sequence)))
        assert picture.shape[1] > 300 and picture.std() > 5


async def _asked(where: Path) -> PatternSequence:
    async with AsyncStation(where) as station:
        return await station.patterns("x", {"a": 2}, (40, 30))


def test_both_clients_ask_for_patterns_alike(tmp_path: Path) -> None:
    import asyncio

    fake = FakeStation(tmp_path / "run", {"patterns": lambda _: lines()})
    try:
        with Station(tmp_path / "run") as station:
            assert station.patterns("x", {"a": 2}, (40, 30)).frames == lines().frames
            station.patterns("x")
        assert asyncio.run(_asked(tmp_path / "run")).parameters == {"a": 1}
    finally:
        fake.stop()
    asked = [dict(request.params) for request in fake.requests if request.verb == "patterns"]
    whole = {"encoder": "x", "params": {"a": 2}, "width_px": 40, "height_px": 30}
    assert asked == [whole, {"encoder": "x", "params": {}}, whole]


def test_a_refusal_comes_back_as_what_it_is(tmp_path: Path) -> None:
    def refuse(_: object) -> None:
        raise UsageError("two steps cannot be decoded")

    fake = FakeStation(tmp_path / "run", {"patterns": refuse})
    try:
        with Station(tmp_path / "run") as station, pytest.raises(UsageError, match="two steps"):
            station.patterns("x")
    finally:
        fake.stop()
