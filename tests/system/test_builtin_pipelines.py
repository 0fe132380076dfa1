"""Every built-in pipeline ends with what it promises, on the simulated rig."""

from __future__ import annotations

import numpy as np
import pytest

from fringed.config import simulated_station
from fringed.data import Calibration, FrameSet, RangeImage
from fringed_client import Station

RANGE_MM = {"hierarchical": 0.3, "heterodyne": 0.3, "number-theoretic": 0.3, "gray": 0.3, "hdr": 0.3, "hdr-levels": 0.3}
SMALL = {
    "one-shot": {"periods": [13, 20, 32]},
    "fourier": {"periods": 32},
}  # fringes that a camera of 232 pixels resolves
CALIBRATIONS = ("tone", "crosstalk")
PIPELINES = sorted(simulated_station().pipelines)


def products(station, state):
    return [station.get(product["id"]) for product in state.products]


@pytest.mark.parametrize("name", PIPELINES)
def test_built_in_pipeline_ends_with_what_it_promises(station_runtime, name):
    with Station(station_runtime) as station:
        result = station.scan(name, truth=True, encoder_params=SMALL.get(name))
        made = products(station, result.state)
        assert result.state.state == "done"
        for set_id in result.state.frame_sets.values():
            assert station.get(set_id).check.passed
        if name in CALIBRATIONS:
            assert any(isinstance(one, Calibration) for one in made)
        if name in RANGE_MM:
            view = next(one for one in made if isinstance(one, RangeImage))
            truth = next(one for one in made if type(one).__name__ == "Truth")
            wanted = (truth.is_object > 0) & (truth.visible > 0) & (truth.lit > 0)
            kept = (view.rejected == 0) & wanted
            assert kept.sum() > 0.9 * wanted.sum()
            # Six times the scatter that 4 steps of 64 periods leave with this sensor, 0.05 mm.
            assert np.median(np.linalg.norm(view.xyz_mm - truth.xyz_mm, axis=2)[kept]) < RANGE_MM[name]


def test_one_exposure_gives_a_range_image_once_the_crosstalk_is_measured(station_runtime):
    with Station(station_runtime) as station:
        measured = next(
            one for one in products(station, station.scan("crosstalk").state) if isinstance(one, Calibration)
        )
        assert measured.crosstalk is not None
        taken = station.scan("one-shot", process=False, encoder_params=SMALL["one-shot"]).state
        frames = station.get(taken.frame_sets["object"])
        assert isinstance(frames, FrameSet) and len({stamp.counter for stamp in frames.stamps}) == 1
        made = products(station, station.process({"frames": frames.id, "calibration": measured}, "one-shot").state)
        view = next(one for one in made if isinstance(one, RangeImage))
        assert (view.rejected == 0).sum() > 500


def test_wrong_camera_for_colours_is_refused_with_what_to_set(station_runtime):
    from fringed.errors import UsageError

    with Station(station_runtime) as station:
        with pytest.raises(UsageError, match="channel"):
            station.scan("one-shot", camera={"channel": "green"})
        with pytest.raises(UsageError, match="channel"):
            station.scan("hierarchical", camera={"channel": "rgb"})
