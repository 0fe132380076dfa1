"""What a worker makes of frames that come before their job."""

from typing import Any, ClassVar

import numpy as np
import pytest

from fringed.data import Array, Calibration, CameraSettings, FrameSet, PatternFrame, PatternSequence, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Params
from fringed.loading import Catalogue
from fringed.messages import FedSet, FeedBegin, FeedFrame, Job, StageCall
from fringed.testing import RecordingContext
from fringed.workers.intake import Intake
from fringed.workers.resolve import Pool
from fringed.workers.stages import run_stage

N = 3
SEQUENCE = PatternSequence(
    "toy", 8, 8, tuple(PatternFrame("sinusoidal", period_px=8.0, step=k, steps=N) for k in range(N)),
    (np.zeros((1, 8, 1), np.uint8),) * N,
)  # fmt: skip
IMAGES = np.arange(N * 6, dtype=np.uint8).reshape(N, 2, 3)


class Sum:
    """Sum of all frames, at once or one by one; `ways` notes which."""

    name: ClassVar[str] = "sum"
    version: ClassVar[str] = "1"
    summary: ClassVar[str] = "toy"
    inputs: ClassVar[dict[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap
    Params: ClassVar[type[Params]] = Params
    ways: ClassVar[list[str]] = []

    def run(self, inputs: Any, params: Any, context: Any) -> PhaseMap:
        self.ways.append("run")
        return phase_map(inputs["frames"].frames.sum(axis=0))

    def begin(self, start: Any, params: Any, context: Any) -> Any:
        return Sink(start.shape, self.ways)


class Sink:
    def __init__(self, shape: tuple[int, int], ways: list[str]) -> None:
        self.total = np.zeros(shape)
        self.ways = ways

    def add(self, index: int, image: Array) -> None:
        assert not image.flags.writeable
        self.total += image

    def finish(self, frame_set: FrameSet, context: Any) -> PhaseMap:
        self.ways.append("finish")
        return phase_map(self.total)


class WithCalibration(Sum):
    name = "with-calibration"
    inputs: ClassVar = {"frames": FrameSet, "calibration": Calibration}
    optional = frozenset({"calibration"})


class Plain(Sum):
    name = "plain"
    begin = None


class BeginRaises(Sum):
    name = "begin-raises"

    def begin(self, *_: Any) -> Any:
        raise RuntimeError("no")


class AddRaises(Sum):
    name = "add-raises"

    def begin(self, start: Any, *_: Any) -> Any:
        class Fails(Sink):
            def add(self, index: int, image: Array) -> None:
                if index == 1:
                    raise SystemExit(3)

        return Fails(start.shape, self.ways)


def phase_map(plane: Array) -> PhaseMap:
    plane = np.asarray(plane, np.float32)
    return PhaseMap(plane, plane, plane, np.zeros(plane.shape, np.uint16), "wrapped", 8.0)


PLUGINS = (Sum, WithCalibration, Plain, BeginRaises, AddRaises)


@pytest.fixture
def intake() -> Intake:
    Sum.ways.clear()
    notes: list[str] = []
    made = Intake(Catalogue(provided={"processor": {cls.name: cls for cls in PLUGINS}}), 1, notes.append)
    made.notes = notes
    return made


def begin(plugin: str, **changes: Any) -> FeedBegin:
    stage = StageCall("s", "processor", plugin, inputs=changes.pop("inputs", {}))
    known = {"feed": "set", "scan": "scan", "role": "object", "roles": ("object",), **changes}
    return FeedBegin(**known, stages=(stage,), sequence=SEQUENCE, settings=CameraSettings(), height_px=2, width_px=3)


def fill(intake: Intake, feed: str = "set") -> None:
    assert [intake.add(FeedFrame(feed, index, image)) for index, image in enumerate(IMAGES)] == [1, 2, 3]


def finish(intake: Intake, begun: FeedBegin, stage: StageCall | None = None) -> PhaseMap:
    whole, early = intake.claim(FedSet("set", "object", "scan"))
    assert np.array_equal(whole.frames, IMAGES)
    assert not whole.frames.flags.writeable
    assert whole.sequence is begun.sequence
    stage = stage or begun.stages[0]
    job = Job("j", (stage,), {}, scan="scan")
    catalogue = intake._catalogue
    return run_stage(catalogue, job, stage, Pool({"object": whole}), RecordingContext(), early.get(stage.name))


@pytest.mark.parametrize(
    ("plugin", "way"),
    [("sum", "finish"), ("plain", "run"), ("begin-raises", "run"), ("add-raises", "run"), ("with-calibration", "run")],
)
def test_product_is_the_same_whether_a_plug_in_streams_or_not(intake, plugin, way):
    intake.begin(begun := begin(plugin))
    fill(intake)
    product = finish(intake, begun)
    assert np.array_equal(product.phase_rad, IMAGES.sum(axis=0))
    assert product.provenance.inputs == ("set",)
    assert product.scan == "scan"
    assert Sum.ways == [way]


def test_what_a_plug_in_does_is_noted_and_then_no_more(intake):
    intake.begin(begin("sum"))
    fill(intake)
    assert {"beginning stage s", "taking frames for stage s"} <= set(intake.notes)
    assert intake.notes[-1] == ""


@pytest.mark.parametrize(
    "changes",
    [{"inputs": {"frames": "reference"}}, {"roles": ("reference", "object")}, {"inputs": {"frames": "nowhere"}}],
)
def test_stage_that_takes_another_set_does_not_begin(intake, changes):
    intake.begin(begin("sum", **changes))
    fill(intake)
    _, early = intake.claim(FedSet("set"))
    assert early == {}


def test_stage_with_other_parameters_than_announced_is_run(intake):
    intake.begin(begun := begin("sum"))
    fill(intake)
    finish(intake, begun, StageCall("s", "processor", "sum", inputs={"frames": "object"}))
    assert Sum.ways == ["run"]


def test_every_frame_is_accounted_for(intake):
    intake.begin(begin("sum"))
    with pytest.raises(DataError, match="frame 1 came where frame 0 of 3 was due"):
        intake.add(FeedFrame("set", 1, IMAGES[1]))
    with pytest.raises(DataError, match="nothing was due"):
        intake.add(FeedFrame("other", 0, IMAGES[0]))
    with pytest.raises(DataError, match=r"the set has \(2, 3\) uint8"):
        intake.add(FeedFrame("set", 0, IMAGES[0].astype(np.uint16)))
    intake.add(FeedFrame("set", 0, IMAGES[0]))
    with pytest.raises(DataError, match="1 of 3 frames of the set set came before its job"):
        intake.claim(FedSet("set"))
    with pytest.raises(DataError, match="no frame of the set"):
        intake.claim(FedSet("set"))


def test_frame_after_the_last_is_refused(intake):
    intake.begin(begin("sum"))
    fill(intake)
    with pytest.raises(DataError, match="frame 3 came where frame 3 of 3 was due"):
        intake.add(FeedFrame("set", 3, IMAGES[0]))


def test_dropped_set_is_forgotten(intake):
    intake.begin(begin("sum"))
    fill(intake)
    intake.drop("set")
    intake.drop("set")
    with pytest.raises(DataError):
        intake.claim(FedSet("set"))
