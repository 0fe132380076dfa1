"""One stage: parameters, inputs, output type and provenance."""

from dataclasses import replace
from typing import Annotated, ClassVar

import msgspec
import numpy as np
import pytest

from fringed.data import (
    Artifact,
    Calibration,
    FrameSet,
    Lens,
    Mesh,
    PatternFrame,
    PatternSequence,
    PhaseMap,
    Provenance,
    RangeImage,
    new_id,
)
from fringed.errors import Cancelled, ConfigurationError, DataError, NotFound, PluginError
from fringed.hookspecs import Params, ProjectorTarget
from fringed.loading import Catalogue
from fringed.messages import Job, JobProgress, StageCall
from fringed.workers.context import JobContext
from fringed.workers.describe import schemas_of
from fringed.workers.resolve import Pool
from fringed.workers.stages import run_stage

LENS = Lens(64, 48, np.eye(3), np.zeros(5))
CALIBRATION = Calibration(LENS, LENS, np.eye(4), "rig-1", "test", tone_curve=np.linspace(0, 1, 256), id="cal")
SEQUENCE = PatternSequence("toy", 64, 48, (PatternFrame("white"),), (np.zeros((1, 1, 1), np.uint8),))


SILENT = (lambda _: None, lambda: False, 1)


class Named:
    version = "2.1"
    summary = "toy"

    class Params(Params, frozen=True, kw_only=True):
        level: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.5
        count: Annotated[int, msgspec.Meta(ge=1)] = 1


class Decode(Named):
    name = "decode"
    inputs: ClassVar = {"frames": FrameSet}
    optional: ClassVar = frozenset()
    output = PhaseMap

    def run(self, inputs, params, context):
        shape = inputs["frames"].frames.shape[1:]
        plane = np.full(shape, params.level, np.float32)
        return PhaseMap(plane, plane, plane, np.zeros(shape, np.uint8), "wrapped", 16.0)


class Triangulate(Named):
    name = "triangulate"
    inputs: ClassVar = {"phase": PhaseMap, "calibration": Calibration}
    optional: ClassVar = frozenset()
    output = RangeImage

    def run(self, inputs, params, context):
        shape = inputs["phase"].phase_rad.shape
        return RangeImage(np.zeros((*shape, 3), np.float32), np.zeros(shape, np.uint8), np.zeros(shape, np.uint8))


class Liar(Decode):
    name = "liar"

    def run(self, inputs, params, context):
        return 42


class Encode(Named):
    name = "encode"
    decoders: ClassVar = ("decode",)
    seen: ClassVar[list[ProjectorTarget]] = []

    def encode(self, params, target):
        self.seen.append(target)
        return SEQUENCE


class Export(Named):
    name = "export"
    suffix = ".txt"
    media_type = "text/plain"
    accepts: ClassVar = (RangeImage, PhaseMap)
    content = b"points"

    def export(self, product, params):
        return self.content


class BadExport(Export):
    name = "bad-export"
    content = "a str"


class Scene(Named):
    name = "scene"

    def make(self, params):
        return Mesh(np.zeros((3, 3)), np.zeros((1, 3), np.int32))


CATALOGUE = Catalogue(
    provided={
        "processor": {cls.name: cls for cls in (Decode, Triangulate, Liar)},
        "encoder": {"encode": Encode},
        "exporter": {"export": Export, "bad-export": BadExport},
        "scene": {"scene": Scene},
    }
)


def frames(**provenance: object) -> FrameSet:
    return FrameSet(np.zeros((1, 4, 5), np.uint8), SEQUENCE, id="set-1", provenance=Provenance(**provenance))


def run(stage: StageCall, pool: Pool, **job: object) -> object:
    context = JobContext(lambda _: None, lambda: False, 1, ("j", stage.name, 0, 1))
    return run_stage(CATALOGUE, Job("j", (stage,), pool.given, scan="scan-1", **job), stage, pool, context)


def test_another_attempt_gives_products_their_ids_again():
    stages = (StageCall("phase", "processor", "decode"), StageCall("again", "processor", "decode"))
    pool = Pool({"object": frames()})

    def ids(job: Job) -> list[str]:
        made = (run_stage(CATALOGUE, job, stage, pool, JobContext(*SILENT, ("j", "", 0, 1))) for stage in stages)
        return [product.id for product in made]

    first = Job("20260102T030405.678901Z-ffff", stages, pool.given)
    assert ids(first) == ids(replace(first, attempt=2))
    assert ids(first) == ["20260102T030405.678901Z-0000", "20260102T030405.678901Z-0001"]
    assert not set(ids(first)) & set(ids(replace(first, id=new_id())))


def test_product_carries_its_provenance():
    pool = Pool({"object": frames(simulated=True, rig="rig-1"), "calibration": CALIBRATION})
    phase = run(StageCall("phase", "processor", "decode", {"level": 0.25}), pool)
    pool.made["phase"] = phase
    image = run(StageCall("range", "processor", "triangulate"), pool)
    assert phase.id != image.id
    assert (phase.scan, image.scan) == ("scan-1", "scan-1")
    assert phase.provenance.inputs == ("set-1",)
    assert phase.provenance.parameters == {"level": 0.25, "count": 1}
    assert (phase.provenance.plugin, phase.provenance.plugin_version) == ("decode", "2.1")
    assert phase.provenance.rig == image.provenance.rig == "rig-1"
    assert image.provenance.inputs == (phase.id, "cal")
    assert image.calibration == image.provenance.calibration == CALIBRATION.hash
    assert phase.provenance.simulated and image.provenance.simulated
    assert not image.provenance.replayed
    assert image.provenance.software.startswith("fringed ")


def test_simulated_and_replayed_come_from_the_job_too():
    phase = run(StageCall("p", "processor", "decode"), Pool({"o": frames()}), simulated=True, replayed=True)
    assert phase.provenance.simulated and phase.provenance.replayed
    assert not run(StageCall("p", "processor", "decode"), Pool({"o": frames()})).provenance.simulated


def test_every_wrong_parameter_is_listed():
    stage = StageCall("phase", "processor", "decode", {"level": 7, "count": 0, "colour": "red"})
    with pytest.raises(ConfigurationError) as caught:
        run(stage, Pool({"object": frames()}))
    assert [problem.path for problem in caught.value.problems] == [
        "phase.params.level", "phase.params.count", "phase.params.colour",
    ]  # fmt: skip


def test_wrong_output_type_is_the_plugins_fault():
    with pytest.raises(PluginError, match="'liar' returned a int; it declares PhaseMap"):
        run(StageCall("s", "processor", "liar"), Pool({"object": frames()}))


def test_unknown_plugin_lists_those_that_exist():
    with pytest.raises(NotFound, match="decode, liar, triangulate"):
        run(StageCall("s", "processor", "nonsense"), Pool({}))


@pytest.mark.parametrize(
    "given", [CALIBRATION, {"width_px": 64, "height_px": 48, "tone_curve": CALIBRATION.tone_curve}]
)
def test_encoder_gets_the_projector(given):
    sequence = run(StageCall("e", "encoder", "encode", {"count": 3}), Pool({"projector": given}))
    target = Encode.seen.pop()
    assert (target.width_px, target.height_px) == (64, 48)
    np.testing.assert_array_equal(target.tone_curve, CALIBRATION.tone_curve)
    assert (sequence.encoder, sequence.encoder_version) == ("encode", "2.1")
    assert sequence.parameters == {"level": 0.5, "count": 3}


@pytest.mark.parametrize("given", [None, 5, {"width_px": 64}, {"width_px": "x", "height_px": 1}])
def test_encoder_without_a_projector_is_refused(given):
    with pytest.raises(DataError, match="projector"):
        run(StageCall("e", "encoder", "encode"), Pool({} if given is None else {"projector": given}))


def test_exporter_makes_an_artifact_of_the_newest_product():
    phase = run(StageCall("phase", "processor", "decode"), Pool({"object": frames()}))
    artifact = run(StageCall("x", "exporter", "export"), Pool({"object": frames()}, {"phase": phase}))
    assert isinstance(artifact, Artifact)
    assert (artifact.name, artifact.media_type) == (f"{phase.id}.txt", "text/plain")
    assert artifact.content.tobytes() == b"points"
    assert artifact.provenance.inputs == (phase.id,)


def test_exporter_refuses_what_it_does_not_accept():
    with pytest.raises(DataError, match=r"needs RangeImage or PhaseMap for its input 'product'"):
        run(StageCall("x", "exporter", "export"), Pool({"object": frames()}))


def test_exporter_that_returns_no_bytes_broke_its_contract():
    phase = run(StageCall("phase", "processor", "decode"), Pool({"object": frames()}))
    with pytest.raises(PluginError, match="has to return bytes"):
        run(StageCall("x", "exporter", "bad-export"), Pool({}, {"phase": phase}))


def test_scene_is_made():
    assert isinstance(run(StageCall("s", "scene", "scene"), Pool({})), Mesh)


def test_schemas_tell_limits_inputs_and_output():
    schema = schemas_of(CATALOGUE)["processor"]["triangulate"]
    [struct] = schema["$defs"].values()
    assert struct["properties"]["level"]["maximum"] == 1
    assert schema["x-plugin"]["inputs"] == {"phase": "PhaseMap", "calibration": "Calibration"}
    assert schema["x-plugin"]["output"] == "RangeImage"


def test_progress_is_of_the_whole_job_and_throttled():
    sent: list[JobProgress] = []
    context = JobContext(sent.append, lambda: False, 1, ("j", "second", 1, 2))
    for step in range(1000):
        context.progress(step / 1000, "working")
    assert sent[0] == JobProgress("j", 0.5, "working", "info", "second")
    assert len(sent) < 1000
    context.log("nonsense", "text")
    assert sent[-1] == JobProgress("j", -1.0, "text", "info", "second")


def test_progress_raises_when_cancelled():
    context = JobContext(lambda _: None, lambda: True, 1, ("j", "s", 0, 1))
    with pytest.raises(Cancelled):
        context.progress(0.1)
