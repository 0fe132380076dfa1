"""A wrong configuration gets every problem with its path, the value and what is allowed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from fringed.config import (
    StationConfig,
    check_station,
    effective,
    load_station,
    merged,
    simulated_station,
    station_of,
    validate,
)
from fringed.config.defaults import PIPELINES
from fringed.errors import ConfigurationError, Problem


def problems(raw: dict[str, Any]) -> dict[str, Problem]:
    with pytest.raises(ConfigurationError) as caught:
        station_of(merged(PIPELINES, raw))
    return {problem.path: problem for problem in caught.value.problems}


def test_every_problem_is_listed_with_its_path() -> None:
    raw = {
        "name": "no spaces please",
        "camera": {"driver": "sim", "exposure_us": -1, "bits": 9, "gain": 3},
        "acquisition": {"retries": 1.5, "settle_s": "soon"},
        "workers": 4,
        "pipelines": {"mine": {"stages": [{"processor": "x"}, {"name": "y"}]}},
        "simulation": {"sensor": {"width_px": 0}},
    }
    assert set(problems(raw)) == {
        "name", "camera.exposure_us", "camera.bits", "camera.gain", "acquisition.retries", "acquisition.settle_s",
        "workers", "pipelines.mine.encoder", "pipelines.mine.stages[1].processor", "simulation.sensor.width_px",
        "projector.driver",
    }  # fmt: skip


def test_a_problem_tells_value_limits_and_units() -> None:
    found = problems({"camera": {"exposure_us": -1, "bits": 9}})
    assert str(found["camera.exposure_us"]) == (
        "camera.exposure_us: -1 is not allowed; expected number > 0 and <= 1e+07 us"
    )
    assert str(found["camera.bits"]) == "camera.bits: 9 is not allowed; expected one of 8, 10, 12, 16"


def test_an_unknown_key_gets_a_suggestion() -> None:
    found = problems({"camera": {"exposur_us": 1.0}, "zzz": 1})
    assert found["camera.exposur_us"].allowed.endswith("did you mean 'exposure_us'?")
    assert "did you mean" not in found["zzz"].allowed


def test_a_table_is_asked_for_where_one_belongs() -> None:
    assert problems({"camera": "sim"})["camera"].allowed == "a table"
    assert problems({"pipelines": {"x": 5}})["pipelines.x"].allowed == "a table"
    assert "list" in problems({"pipelines": {"x": {"encoder": "e", "stages": "s"}}})["pipelines.x.stages"].allowed
    assert problems({"tcp": {"bind": "0.0.0.0"}})["tcp.keys_dir"].allowed == "a value; it has no default"


@pytest.mark.parametrize(
    ("raw", "path"),
    [
        ({"default_pipeline": "hierachical"}, "default_pipeline"),
        ({"presets": {"p": {"pipeline": "nothing"}}}, "presets.p.pipeline"),
        ({"calibration": "simulated", "camera": {"driver": "none"}}, "calibration"),
        ({"camera": {"driver": "sim"}, "projector": {"driver": "window"}}, "projector.driver"),
        (
            {"pipelines": {"p": {"encoder": "e", "stages": [{"processor": "a", "inputs": {"x": "later"}}]}}},
            "pipelines.p.stages[0].inputs.x",
        ),
        (
            {"pipelines": {"p": {"encoder": "e", "stages": [{"processor": "a"}, {"processor": "a"}]}}},
            "pipelines.p.stages[1].name",
        ),
    ],
)
def test_names_that_refer_to_nothing_are_found(raw: dict[str, Any], path: str) -> None:
    assert path in problems(raw)


def test_references_are_all_listed_at_once() -> None:
    raw = {"default_pipeline": "x", "presets": {"p": {"pipeline": "y"}}, "calibration": "simulated"}
    assert set(problems(raw)) >= {"default_pipeline", "presets.p.pipeline", "calibration"}


def test_types_and_references_are_told_in_one_round() -> None:
    raw = {
        "camera": {"bits": 9, "driver": "sim"},
        "default_pipeline": "nothing",
        "pipelines": {
            "broken": {"stages": [{"processor": 1}]},
            "p": {"encoder": "e", "stages": [{"processor": "a"}] * 2},
        },
        "presets": {"on-broken": {"pipeline": "broken"}, "p": {"pipeline": "y", "encoder_params": 1}},
    }  # fmt: skip
    assert set(problems(raw)) == {
        "camera.bits", "default_pipeline", "projector.driver", "pipelines.p.stages[1].name", "presets.p.pipeline",
        "pipelines.broken.encoder", "pipelines.broken.stages[0].processor", "presets.p.encoder_params",
    }  # fmt: skip


def test_a_wrong_value_is_not_reported_again_through_what_refers_to_it() -> None:
    raw = {"camera": {"driver": 5}, "projector": {"driver": "sim"}, "calibration": "simulated"}
    assert set(problems(raw)) == {"camera.driver"}


def test_stages_may_name_roles_earlier_stages_and_the_calibration() -> None:
    stages = [
        {"processor": "a", "inputs": {"frames": "object"}},
        {"processor": "b", "inputs": {"phase": "a", "calibration": "calibration"}},
    ]
    check_station(
        validate(merged(PIPELINES, {"pipelines": {"p": {"encoder": "e", "stages": stages}}}), StationConfig)
    )  # fmt: skip


def test_the_station_without_a_configuration_is_simulated_and_says_so() -> None:
    config = simulated_station()
    assert (config.name, config.camera.driver, config.projector.driver) == ("simulated", "sim", "sim")
    assert effective(config)["camera"]["exposure_us"] > 0


def test_a_configuration_that_names_no_camera_has_none(tmp_path: Path) -> None:
    path = tmp_path / "station.toml"
    path.write_text('name = "empty"\n')
    assert load_station(path).camera.driver == "none"


def test_effective_configuration_is_valid_and_says_the_same(tmp_path: Path) -> None:
    config = simulated_station({"camera": {"gain_db": 3.0}})
    assert validate(effective(config), StationConfig) == config


@pytest.mark.parametrize(
    ("content", "why"),
    [(b"name = ", "is not TOML"), (b"\xff\xfe", "cannot be read"), (b"name = 5", "1 problem"), (None, "there is no")],
)
def test_files_that_cannot_be_read_say_why(tmp_path: Path, content: bytes | None, why: str) -> None:
    path = tmp_path / "station.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=why):
        load_station(path)
    with pytest.raises(ConfigurationError):
        load_station(tmp_path)


def test_tables_are_merged_key_by_key_and_lists_replaced() -> None:
    base = {"a": {"x": 1, "y": [1, 2]}, "b": 1}
    assert merged(base, {"a": {"y": [3]}, "b": {"z": 1}}) == {"a": {"x": 1, "y": [3]}, "b": {"z": 1}}
    assert base == {"a": {"x": 1, "y": [1, 2]}, "b": 1}


class Knob(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A plug-in's parameters."""

    size_px: Annotated[int, Meta(ge=1, extra_json_schema={"units": "px"})] = 3
    mode: Literal["fast", "exact"] = "fast"
    level: Annotated[float, Meta(ge=0)] | None = None
    pair: tuple[int, int] = (0, 0)
    names: list[str] = []
    table: dict[str, float] = {}
    steps: Annotated[int, Meta(ge=3)] | list[Annotated[int, Meta(ge=3)]] = 4
    code: Annotated[str, Meta(pattern="^[a-z]+$")] = "a"
    exact: bool = False


@pytest.mark.parametrize(
    ("raw", "path", "allowed"),
    [
        ({"size_px": 0}, "size_px", "integer >= 1 px"),
        ({"size_px": True}, "size_px", "integer >= 1 px"),
        ({"size_px": 2.5}, "size_px", "integer >= 1 px"),
        ({"mode": "quick"}, "mode", "one of 'fast', 'exact'"),
        ({"level": -1.0}, "level", "number >= 0"),
        ({"pair": [1]}, "pair", "2 integers"),
        ({"names": ["a", 5]}, "names[1]", "text"),
        ({"table": {"x": "y"}}, "table.x", "number"),
        ({"steps": 2}, "steps", "integer >= 3 or a list of integers >= 3"),
        ({"code": "A"}, "code", "text matching ^[a-z]+$"),
        ({"exact": 1}, "exact", "true or false"),
    ],
)
def test_parameters_of_every_type_are_checked(raw: dict[str, Any], path: str, allowed: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        validate(raw, Knob, "params")
    (problem,) = caught.value.problems
    assert problem.path == f"params.{path}"
    assert allowed in problem.allowed


def test_right_parameters_are_built() -> None:
    knob = validate({"size_px": 5, "level": 1, "pair": [1, 2], "table": {"a": 1}}, Knob)
    assert (knob.size_px, knob.level, knob.pair, knob.table) == (5, 1.0, (1, 2), {"a": 1.0})
    assert validate({"level": None}, Knob).level is None


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_numbers_that_are_none_are_refused(value: float) -> None:
    found = problems({"camera": {"exposure_us": value, "options": {"x": [1.0, value]}}})
    assert set(found) == {"camera.exposure_us", "camera.options"}
    with pytest.raises(ConfigurationError, match="finite"):
        validate({"table": {"a": value}}, Knob)
