"""Every built-in plug-in keeps the contract that anybody's must keep, and the checks find those that do not."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
import pytest
from msgspec import Meta, convert

from fringed import hookspecs
from fringed.config.simulated import SimulationConfig
from fringed.data import CameraSettings, FrameSet, Mesh, Model, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import ProjectorTarget
from fringed.loading import load_plugins
from fringed.simulation.optics import exact_calibration
from fringed.testing import PluginContract, RecordingContext, check_params

CATALOGUE = load_plugins()
BUILT_IN = {"phase", "triangulation", "registration", "exporters"}
SIZES = {"sensor": {"width_px": 96, "height_px": 72}, "projector": {"width_px": 256, "height_px": 192}}
PERIODS = {"multi-frequency": {"periods": [1, 4, 16]}, "phase-shift": {"periods": 16.0}}


def provided(kind):
    return sorted(CATALOGUE.provided[kind])


@pytest.fixture(scope="module")
def calibration():
    return exact_calibration(convert(SIZES, SimulationConfig), "contract")


@pytest.fixture(scope="module")
def frame_set(calibration):
    """Return a maker of frames of a plane at 1000 mm, seen through the given method."""

    def make(method, depth_mm=1000.0):
        encoder = CATALOGUE.get("encoder", method)
        sequence = encoder().encode(encoder.Params(**PERIODS[method]), ProjectorTarget(256, 192))
        u = np.linspace(60, 200, 96) + (depth_mm - 1000) * 0.3 + np.zeros((72, 1))
        frames = [np.rint(20 + 0.7 * np.interp(u, np.arange(256), p[0, :, 0])) for p in sequence.patterns]
        settings = CameraSettings(electrons_per_dn=51.0, read_noise_electrons=12.0)
        return FrameSet(np.array(frames, np.uint8), sequence, settings=settings)

    return make


def product(name, inputs):
    cls = CATALOGUE.get("processor", name)
    return cls().run(inputs, cls.Params(), RecordingContext())


@pytest.fixture(scope="module")
def inputs(frame_set, calibration):
    """Return good inputs of each of the fringe processors."""
    wrapped = [product("phase-shift", {"frames": frame_set("phase-shift", z)}) for z in (1000.0, 995.0)]
    absolute = product("multi-frequency", {"frames": frame_set("multi-frequency")})
    pair = {"reference": wrapped[0], "object": wrapped[1]}
    return {
        "phase-shift": {"frames": frame_set("phase-shift")},
        "multi-frequency": {"frames": frame_set("multi-frequency")},
        "unwrap-difference": pair,
        "unwrap": {"phase": wrapped[0]},
        "fuse-exposures": {"maps": (absolute, absolute)},
        "suggest-exposures": {"frames": (frame_set("phase-shift"),)},
        "triangulate": {"phase": absolute, "calibration": calibration},
        "reference-plane": {"phase": product("unwrap-difference", pair), "calibration": calibration},
    }


def test_all_built_in_plug_ins_load():
    states = {info.name: info.error for info in CATALOGUE.plugins}
    assert set(states) >= BUILT_IN
    assert not {name: error for name, error in states.items() if error and name in BUILT_IN}


@pytest.mark.parametrize(
    "name",
    [
        "phase-shift",
        "multi-frequency",
        "unwrap-difference",
        "unwrap",
        "fuse-exposures",
        "suggest-exposures",
        "triangulate",
        "reference-plane",
    ],
)
def test_fringe_processors_keep_the_contract(plugin_contract, inputs, name):
    plugin_contract.processor(CATALOGUE.get("processor", name), inputs[name])


@pytest.mark.parametrize("name", provided("processor"))
def test_processors_describe_themselves(plugin_contract, name):
    plugin_contract.metadata(CATALOGUE.get("processor", name), hookspecs.Processor)


@pytest.mark.parametrize("name", provided("encoder"))
@pytest.mark.parametrize("orientation", ["columns", "rows"])
def test_encoders_keep_the_contract(plugin_contract, name, orientation):
    encoder = CATALOGUE.get("encoder", name)  # uniform pictures have no orientation
    params = {"orientation": orientation} if "orientation" in encoder.Params.__struct_fields__ else {}
    sequence = plugin_contract.encoder(encoder, params)
    for decoder in CATALOGUE.get("encoder", name).decoders:
        assert decoder in CATALOGUE.provided["processor"]
    assert sequence.encoder == name


@pytest.mark.parametrize("name", provided("exporter"))
def test_exporters_keep_the_contract(plugin_contract, inputs, name):
    exporter = CATALOGUE.get("exporter", name)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2]], np.int32)
    products = {
        "RangeImage": product("triangulate", inputs["triangulate"]),
        "Model": Model(corners, corners, np.zeros(3, np.uint8), faces=faces),
        "Mesh": Mesh(corners.astype(np.float64), faces),
        "PhaseMap": inputs["triangulate"]["phase"],
    }
    for accepted in exporter.accepts:
        assert plugin_contract.exporter(exporter, products[accepted.__name__])


# The checks themselves.


class Good:
    """A processor that keeps the contract."""

    name: ClassVar[str] = "good"
    version: ClassVar[str] = "1"
    summary: ClassVar[str] = "negates a phase"
    inputs: ClassVar[dict] = {"phase": PhaseMap}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """No parameters."""

    def run(self, inputs, params, context):
        """Return the negative."""
        from dataclasses import replace

        from fringed.errors import DataError

        context.check_cancelled()
        if not isinstance(inputs.get("phase"), PhaseMap):
            raise DataError("good takes a phase map")
        return replace(inputs["phase"], phase_rad=-inputs["phase"].phase_rad)


class Forgetful(Good):
    """Never looks whether it was cancelled."""

    def run(self, inputs, params, context):
        """Return the negative."""
        return super().run(inputs, params, RecordingContext())


class Careless(Good):
    """Does not look at its inputs."""

    def run(self, inputs, params, context):
        """Return the input."""
        context.check_cancelled()
        return inputs["phase"]


class Random(Good):
    """Gives another result each time."""

    calls = 0

    def run(self, inputs, params, context):
        """Return something."""
        from dataclasses import replace

        Random.calls += 1
        result = super().run(inputs, params, context)
        return replace(result, phase_rad=result.phase_rad + Random.calls)


class Meddling(Good):
    """Writes into its input."""

    def run(self, inputs, params, context):
        """Return the negative."""
        result = super().run(inputs, params, context)
        with_base = inputs["phase"].modulation.base
        if with_base is not None:
            with_base[0, 0] += 1
        return result


class Wrong(Good):
    """Returns another type."""

    def run(self, inputs, params, context):
        """Return a number."""
        return 1


class Undocumented(Good):
    """Has a parameter that nobody can understand."""

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        level: float = 1.0


class Unbounded(Good):
    """Has a parameter without limits."""

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        level: Annotated[float, Meta(description="a level")] = 1.0


@pytest.fixture
def phase():
    zeros = [np.zeros((4, 4), np.float32) for _ in range(3)]
    return {"phase": PhaseMap(*zeros, np.zeros((4, 4), np.uint8), "absolute", 16.0)}


def test_good_processor_passes(plugin_contract, phase):
    plugin_contract.processor(Good, phase)


@pytest.mark.parametrize(
    ("cls", "complaint"),
    [
        (Forgetful, "although it was cancelled"),
        (Careless, "must raise DataError"),
        (Random, "two results for the same inputs"),
        (Meddling, "changed its inputs"),
        (Wrong, "returned a int"),
    ],
)
def test_broken_contract_is_found(phase, cls, complaint):
    with pytest.raises(AssertionError, match=complaint):
        PluginContract().processor(cls, phase)


class Summing(Good):
    """Sums frames, at once or one by one."""

    inputs: ClassVar[dict] = {"frames": FrameSet}

    def run(self, inputs, params, context):
        """Return the sum."""
        context.check_cancelled()
        if not isinstance(inputs.get("frames"), FrameSet):
            raise DataError("summing takes a frame set")
        return as_phase(inputs["frames"].frames.sum(axis=0))

    def begin(self, start, params, context):
        """Return an empty sum."""
        return Sum(start.shape)


class Sum:
    def __init__(self, shape):
        self.total = np.zeros(shape)

    def add(self, index, image):
        self.total += image

    def finish(self, frame_set, context):
        return as_phase(self.total)


class Shared(Summing):
    """Uses one sum for all sets."""

    sink = None

    def begin(self, start, params, context):
        """Return the sum that there is."""
        self.sink = self.sink or Sum(start.shape)
        return self.sink


class Keeping(Summing):
    """Keeps frames that it was only shown."""

    def begin(self, start, params, context):
        """Return what keeps them."""

        class Kept(Sum):
            def add(self, index, image):
                self.images = [*getattr(self, "images", ()), image]

            def finish(self, frame_set, context):
                return as_phase(np.sum(self.images, axis=0))

        return Kept(start.shape)


class Biased(Summing):
    """Differs by one in a thousand when it streams."""

    def begin(self, start, params, context):
        """Return a sum that is not right."""
        sink = Sum(start.shape)
        sink.total += 1
        return sink


class Two(Summing):
    """Wants more than a set, and streams."""

    inputs: ClassVar[dict] = {"frames": FrameSet, "phase": PhaseMap}
    optional: ClassVar[frozenset[str]] = frozenset({"phase"})


def as_phase(plane):
    plane = np.asarray(plane, np.float32)
    return PhaseMap(plane, plane, plane, np.zeros(plane.shape, np.uint16), "wrapped", 16.0)


def test_streaming_processor_passes(plugin_contract, frame_set):
    plugin_contract.processor(Summing, {"frames": frame_set("phase-shift")})


@pytest.mark.parametrize(
    ("cls", "complaint"),
    [
        (Shared, "differ in phase_rad"),
        (Keeping, "differ in phase_rad"),
        (Biased, "differ in phase_rad"),
        (Two, "only a processor of one FrameSet can"),
    ],
)
def test_streaming_that_gives_something_else_is_found(frame_set, cls, complaint):
    with pytest.raises(AssertionError, match=complaint):
        PluginContract().processor(cls, {"frames": frame_set("phase-shift")})


@pytest.mark.parametrize(("cls", "complaint"), [(Undocumented, "has no description"), (Unbounded, "has no limits")])
def test_parameters_without_help_or_limits_are_found(cls, complaint):
    with pytest.raises(AssertionError, match=complaint):
        check_params(cls)
