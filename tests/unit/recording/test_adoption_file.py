"""The acts by which calibrations are put in force: remembered whole, whatever happens."""

from __future__ import annotations

import pytest

from fringed.errors import StorageError
from fringed.recording.adoption import Adoption, AdoptionFile


def use(name):
    return Adoption(action="use", id=name, hash=name * 2, time="2026-01-01T00:00:00", by="me")


def revert(name=""):
    return Adoption(action="revert", id=name)


def names(file):
    return [act.id for act in file.stack]


def test_the_last_one_used_is_in_force_and_reverting_goes_back_one_by_one(tmp_path):
    file = AdoptionFile(tmp_path / "calibration.json")
    for act in (use("a"), use("b"), use("c"), revert("c")):
        file.append(act)
    assert names(file) == ["a", "b"]
    file.append(use("d"))
    assert names(file) == ["a", "b", "d"]
    assert names(AdoptionFile(tmp_path / "calibration.json")) == ["a", "b", "d"]


def test_reverting_to_the_configuration_forgets_all_but_the_history(tmp_path):
    file = AdoptionFile(tmp_path / "calibration.json")
    for act in (use("a"), use("b"), revert()):
        file.append(act)
    assert names(file) == [] and len(file.history) == 3


def test_an_act_that_cannot_be_written_has_not_happened(tmp_path):
    folder = tmp_path / "data"
    file = AdoptionFile(folder / "calibration.json")
    file.append(use("a"))
    (folder / "calibration.json.part").mkdir()  # what the file is written aside as cannot be made
    with pytest.raises(StorageError):
        file.append(use("b"))
    assert names(file) == ["a"] and names(AdoptionFile(folder / "calibration.json")) == ["a"]


def test_a_half_written_file_beside_it_harms_nothing(tmp_path):
    path = tmp_path / "calibration.json"
    AdoptionFile(path).append(use("a"))
    path.with_name("calibration.json.part").write_bytes(b'[{"action": "use", "id"')
    file = AdoptionFile(path)
    file.append(use("b"))
    assert names(AdoptionFile(path)) == ["a", "b"]


def test_a_damaged_file_is_put_aside_and_said(tmp_path, caplog):
    path = tmp_path / "calibration.json"
    path.write_text("{nonsense")
    assert names(AdoptionFile(path)) == []
    assert "damaged" in caplog.text and path.with_suffix(".damaged").read_text() == "{nonsense"
