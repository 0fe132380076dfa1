"""What every projector does: over the simulated one always, over a real one with `-m hardware`.

A real projector is named by `FRINGED_HARDWARE_CONFIG`, the path of a station's configuration.
"""

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from fringed.config import load_station, simulated_station
from fringed.data import PatternFrame, PatternSequence
from fringed.devices.building import build_devices
from fringed.errors import DeviceError
from fringed.hookspecs import Projector
from fringed.loading import load_plugins

SMALL = {"simulation": {"real_time": False, "sensor": {"width_px": 116, "height_px": 87}, "scene": {"object": "plane"}}}


def patterns_for(projector, count=3, off=0):
    width, height = projector.size_px
    patterns = tuple(np.full((1, 1, 1), 60 * k, np.uint8) for k in range(count))
    return PatternSequence("flat", width + off, height, tuple(PatternFrame("flat") for _ in patterns), patterns)


class ProjectorContract:
    """The promises of `hookspecs.Projector`."""

    @pytest.fixture
    def projector(self) -> Projector:
        raise AssertionError("each class of projectors makes its own")

    @pytest.fixture
    def opened(self, projector):
        projector.open()
        yield projector
        projector.close()

    def test_it_says_what_it_is(self, opened):
        assert isinstance(opened.simulated, bool)
        assert opened.open()
        assert min(opened.size_px) > 0

    def test_closing_is_harmless_at_any_time(self, projector):
        projector.close()
        projector.open()
        projector.close()
        projector.close()

    def test_a_closed_projector_shows_nothing(self, projector):
        with pytest.raises(DeviceError):
            projector.load(patterns_for(projector), "object")
        with pytest.raises(DeviceError):
            projector.show(0)

    def test_nothing_is_shown_before_it_is_loaded(self, opened):
        with pytest.raises(DeviceError, match="load"):
            opened.show(0)

    def test_flips_are_confirmed_in_order(self, opened):
        opened.load(patterns_for(opened), "object")
        flips = [opened.show(k) for k in (0, 1, 2, 2, 0)]
        assert all(later > earlier for earlier, later in pairwise(flips))

    def test_a_pattern_that_is_not_there_is_refused(self, opened):
        opened.load(patterns_for(opened), "object")
        for index in (3, -1):
            with pytest.raises(DeviceError):
                opened.show(index)

    def test_patterns_of_another_size_are_refused(self, opened):
        with pytest.raises(DeviceError, match="x"):
            opened.load(patterns_for(opened, off=8), "object")

    def test_it_can_rest_and_go_on(self, opened):
        opened.load(patterns_for(opened), "object")
        opened.show(1)
        opened.idle()
        opened.show(2)


class TestSimulatedProjector(ProjectorContract):
    @pytest.fixture
    def projector(self):
        return build_devices(simulated_station(SMALL)).projector


@pytest.mark.hardware
class TestRealProjector(ProjectorContract):
    @pytest.fixture
    def projector(self):
        path = os.environ.get("FRINGED_HARDWARE_CONFIG")
        if not path:
            pytest.skip("FRINGED_HARDWARE_CONFIG names no configuration of a real station")
        return build_devices(load_station(Path(path)), load_plugins).projector
