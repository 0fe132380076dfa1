"""Parameters are checked against what workers told, before a scan begins."""

from typing import Annotated, Literal

import msgspec
import pytest

from fringed.errors import ConfigurationError, NotFound
from fringed.hookspecs import Params
from fringed.messages import StageCall
from fringed.serving.schemas import check_stages


class Fit(Params, frozen=True, kw_only=True):
    """Toy parameters."""

    radius_mm: Annotated[float, msgspec.Meta(gt=0, le=10, extra_json_schema={"units": "mm"})] = 1.0
    mode: Literal["fast", "good"] = "fast"
    periods: Annotated[list[int], msgspec.Meta(min_length=1)] | int = 3
    needed: int


SCHEMAS = {"processor": {"fit": msgspec.json.schema(Fit)}}


def problems(**params):
    with pytest.raises(ConfigurationError) as caught:
        check_stages([StageCall("mine", "processor", "fit", params)], SCHEMAS)
    return [str(problem) for problem in caught.value.problems]


def test_good_parameters_pass():
    for periods in (3, [1, 2]):
        good = StageCall("mine", "processor", "fit", {"needed": 1, "radius_mm": 2, "mode": "good", "periods": periods})
        check_stages([good], SCHEMAS)


def test_every_wrong_one_is_named_with_its_path_and_what_is_allowed():
    found = problems(radius_mm=11, mode="slow", periods=["x"], raduis_mm=1)
    assert len(found) == 5
    assert "mine.params.radius_mm: 11 is not allowed; expected more than 0" in found[0]
    assert "mm" in found[0]
    assert any("one of 'fast', 'good'" in text for text in found)
    assert any("did you mean 'radius_mm'" in text for text in found)
    assert any(text.startswith("mine.params.needed: nothing") for text in found)


def test_a_truth_value_is_no_number():
    assert problems(needed=True)


def test_an_unknown_plug_in_lists_those_that_exist():
    with pytest.raises(NotFound, match="there are fit"):
        check_stages([StageCall("mine", "processor", "fti")], SCHEMAS)


def test_nothing_is_refused_before_workers_told_what_they_have():
    check_stages([StageCall("mine", "processor", "anything")], {})
