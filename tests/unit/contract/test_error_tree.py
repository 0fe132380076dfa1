"""The tree of errors is the one that its module draws, and every error is also what it looks like."""

from __future__ import annotations

import re

import pytest

from fringed import errors
from fringed.errors import ConfigurationError, FringedError, Problem, error_classes

DRAWN = errors.__doc__ or ""


def drawn_parents() -> dict[str, str]:
    """Return the parent of each error as the docstring draws it."""
    parents: dict[str, str] = {}
    above: dict[int, str] = {}
    for line in DRAWN.splitlines():
        match = re.match(r"^(\s*[│ ]*(?:[├└]── )?)(\w+)", line)
        if match and match[2] in error_classes():
            depth = len(match[1])
            above[depth] = match[2]
            shallower = [d for d in above if d < depth]
            parents[match[2]] = above[max(shallower)] if shallower else ""
    return parents


def own_classes() -> dict[str, type[FringedError]]:
    return {name: cls for name, cls in error_classes().items() if cls.__module__ == "fringed.errors"}


def test_every_error_is_drawn_where_it_belongs() -> None:
    expected = {
        name: next((base.__name__ for base in cls.__bases__ if issubclass(base, FringedError)), "")
        for name, cls in own_classes().items()
    }
    assert drawn_parents() == expected


@pytest.mark.parametrize("name", sorted(own_classes()))
def test_built_in_base_is_drawn_beside_the_name(name: str) -> None:
    foreign = [b.__name__ for b in own_classes()[name].__bases__ if not issubclass(b, FringedError)]
    drawn = re.search(rf"\b{name}(?: \((\w+)\))?\s", DRAWN)
    assert drawn is not None
    assert ([drawn[1]] if drawn[1] else []) == [base for base in foreign if base != "Exception"]


@pytest.mark.parametrize("name", sorted(own_classes()))
def test_every_error_is_raised_caught_and_read(name: str) -> None:
    with pytest.raises(FringedError) as caught:
        raise own_classes()[name]("what, seen, allowed, next")
    assert str(caught.value) == caught.value.message == "what, seen, allowed, next"  # KeyError would quote it
    assert str(own_classes()[name].__name__) == name


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("UsageError", 2), ("ConfigurationError", 2), ("NotFound", 2), ("NoStation", 3), ("ConnectionLost", 3),
        ("StationBusy", 3), ("RequestTimeout", 3), ("LeaseError", 4), ("DeviceAbsent", 4), ("DeviceStalled", 4),
        ("ProtocolError", 4), ("AcquisitionError", 4), ("QualityError", 5), ("ConvergenceError", 5), ("Cancelled", 130),
        ("StorageError", 1), ("PluginError", 1), ("Quarantined", 1), ("WireError", 1), ("RecordingError", 1),
    ],
)  # fmt: skip
def test_exit_codes(name: str, code: int) -> None:
    assert own_classes()[name].exit_code == code


def test_an_os_error_of_ours_has_its_message_alone() -> None:
    assert str(errors.StorageError("the disk is full")) == "the disk is full"
    assert errors.FringedError().message == "FringedError"


def test_a_configuration_error_lists_every_problem() -> None:
    problems = (Problem("camera.bits", "9", "one of 8, 10"), Problem("name", "''", "a name"))
    error = ConfigurationError("2 problems:", problems)
    assert error.problems == problems
    assert str(error).splitlines() == [
        "2 problems:",
        "  camera.bits: 9 is not allowed; expected one of 8, 10",
        "  name: '' is not allowed; expected a name",
    ]
