"""Drivers of real devices by name: each is there, says what it is, and its options are checked without opening it."""

from __future__ import annotations

import subprocess
import sys

import msgspec
import pytest

from fringed.cli.check import plugin_problems
from fringed.config import StationConfig
from fringed.devices.building import BUILT_IN, build_devices, built_in
from fringed.errors import ConfigurationError, NotFound
from fringed.hookspecs import Driver, Params

DRIVERS = [(kind, name) for kind, names in BUILT_IN.items() for name in names]


def a_station(**devices):
    return msgspec.convert({"name": "lab", **devices}, StationConfig)


@pytest.mark.parametrize(("kind", "name"), DRIVERS)
def test_driver_is_what_it_is_called(kind, name):
    driver = built_in(kind, name)
    assert isinstance(driver, Driver) and driver.name == name and driver.summary
    assert issubclass(driver.Options, Params)
    msgspec.json.schema(driver.Options)  # what `fringed show --reference` and clients read


@pytest.mark.parametrize(("kind", "name"), DRIVERS)
def test_options_that_a_driver_has_not_are_told_with_their_path(kind, name):
    config = a_station(**{kind: {"driver": name, "options": {"nonsense": 1}}})
    told = [problem for problem in plugin_problems(config) if problem.path.startswith(f"{kind}.options")]
    assert told and any("nonsense" in str(problem) for problem in told)
    with pytest.raises((ConfigurationError, NotFound)):
        build_devices(config)


def test_unknown_driver_is_told_with_those_that_there_are():
    told = plugin_problems(a_station(projector={"driver": "hitach"}))
    assert any("hitachi" in str(problem) and "window" in str(problem) for problem in told)
    assert built_in("camera", "hitachi") is None


def test_no_driver_is_imported_that_nobody_names():
    code = "import fringed.app, sys; print([m for m in sys.modules if m in ('pygame', 'usb', 'serial', 'cv2')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "[]"
