"""Run one stage of a job: find the plug-in, check its parameters, give it its inputs, stamp what it returns.

Owns what a plug-in may rely on; knows no socket and no process. How the four kinds are called:

- processor: `run(inputs, params, context)`, inputs as `resolve` finds them.
- encoder: `encode(params, ProjectorTarget)`; the job input "projector" is a Calibration or a table of
  `width_px`, `height_px` and, where known, `tone_curve` (256 values).
- exporter: `export(product, params)`; its input is called "product". It becomes an Artifact.
- scene: `make(params)`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from typing import Any, Union

import msgspec
import numpy as np

from fringed import __version__
from fringed.config import validate
from fringed.data import Artifact, Calibration, FrameSet, Mesh, PatternSequence, Provenance, new_id
from fringed.errors import DataError, PluginError
from fringed.hookspecs import Context, FrameSink, ProjectorTarget
from fringed.loading import Catalogue
from fringed.messages import Job, StageCall
from fringed.workers.resolve import Pool, resolve, type_name

_STATION_ID = re.compile(r"(.+Z-)([0-9a-f]{4})")


@dataclass(frozen=True)
class Early:
    """A stage that took the frames of a set while they arrived."""

    call: StageCall
    sink: FrameSink
    frame_set: FrameSet

    def fits(self, stage: StageCall, inputs: Mapping[str, Any]) -> bool:
        """Tell whether it was told what it is asked for now: the same call, of that set and nothing else."""
        return self.call == stage and [id(value) for value in inputs.values()] == [id(self.frame_set)]


def run_stage(
    catalogue: Catalogue, job: Job, stage: StageCall, pool: Pool, context: Context, early: Early | None = None
) -> Any:
    """Return the stage's product, its identity and provenance filled in; `early` has begun it.

    Raises
    ------
    NotFound
        no such plug-in.
    ConfigurationError
        with every wrong parameter.
    DataError
        inputs that are missing, ambiguous or of another type.
    PluginError
        what it returned is not what it declares.
    """
    cls = catalogue.get(stage.kind, stage.plugin)
    params = validate(stage.params, cls.Params, f"{stage.name}.params")
    plugin = cls()
    inputs = _inputs(plugin, stage, pool)
    if early is not None and early.fits(stage, inputs):
        product: Any = early.sink.finish(early.frame_set, context)
    else:
        product = _CALLS[stage.kind](plugin, inputs, params, context)
    expected = {"processor": getattr(cls, "output", None), "encoder": PatternSequence, "scene": Mesh}.get(stage.kind)
    if expected is not None and not isinstance(product, expected):
        raise PluginError(
            f"the {stage.kind} {stage.plugin!r} returned a {type(product).__name__}; it declares {type_name(expected)}"
        )
    return stamp(product, plugin, params, list(inputs.values()), job, record_id=product_id(job, stage.name))


def product_id(job: Job, stage: str) -> str:
    """Return the id of a stage's product: in every attempt at the job the same.

    A worker may die between two products of a job. The first one, recorded by then, names the other by the id that
    the next attempt gives it.
    """
    match = _STATION_ID.fullmatch(job.id)
    if match is None:
        return new_id()
    place = 1 + [call.name for call in job.stages].index(stage)
    return f"{match[1]}{(int(match[2], 16) + place) % 0x10000:04x}"


def stamp(product: Any, plugin: Any, params: msgspec.Struct, inputs: list[Any], job: Job, *, record_id: str) -> Any:
    """Return `product` with its id, scan and provenance."""
    plain = msgspec.to_builtins(params)
    if isinstance(product, PatternSequence):
        told = {**product.parameters, **plain}  # an encoder may add what it has chosen itself
        return replace(product, encoder=plugin.name, encoder_version=plugin.version, parameters=told)
    used = [item for value in inputs for item in (value if isinstance(value, (list, tuple)) else (value,))]
    calibration = _calibration(used)
    provenance = Provenance(
        inputs=tuple(item.id for item in used if getattr(item, "id", "")),
        plugin=plugin.name,
        plugin_version=plugin.version,
        parameters=plain,
        calibration=calibration,
        rig=_first(getattr(item, "rig", "") or _origin(item).rig for item in used),
        software=f"fringed {__version__}",
        created=datetime.now(UTC).isoformat(timespec="milliseconds"),
        simulated=job.simulated or any(_origin(item).simulated for item in used),
        replayed=job.replayed or any(_origin(item).replayed for item in used),
    )
    changes: dict[str, Any] = {"id": record_id, "provenance": provenance}
    names = {item.name for item in fields(product)}
    if "scan" in names:
        changes["scan"] = job.scan or _first(getattr(item, "scan", "") for item in used)
    if "calibration" in names and not product.calibration:
        changes["calibration"] = calibration
    return replace(product, **changes)


def _inputs(plugin: Any, stage: StageCall, pool: Pool) -> dict[str, Any]:
    if stage.kind == "processor":
        return resolve(plugin.inputs, plugin.optional, stage.inputs, pool, stage.name)
    if stage.kind == "exporter":
        accepted: Any = Union[tuple(plugin.accepts)]  # noqa: UP007  built at run time
        return resolve({"product": accepted}, (), stage.inputs, pool, stage.name)
    if stage.kind == "encoder":
        return {"target": _target(pool.all().get(stage.inputs.get("projector", "projector")))}
    return {}


def _target(given: Any) -> ProjectorTarget:
    if isinstance(given, Calibration):
        return ProjectorTarget(given.projector.width_px, given.projector.height_px, given.tone_curve)
    if isinstance(given, Mapping):
        try:
            curve = given.get("tone_curve")
            curve = None if curve is None else np.asarray(curve, np.float64)
            return ProjectorTarget(int(given["width_px"]), int(given["height_px"]), curve)
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(f"the job's input 'projector' is {str(given)[:80]}; {error!r}") from error
    raise DataError(
        f"an encoder needs the job input 'projector': a Calibration or a table of width_px, height_px and "
        f"tone_curve; it got {type(given).__name__}"
    )


def _process(plugin: Any, inputs: dict[str, Any], params: Any, context: Context) -> Any:
    return plugin.run(inputs, params, context)


def _encode(plugin: Any, inputs: dict[str, Any], params: Any, _: Context) -> Any:
    return plugin.encode(params, inputs["target"])


def _export(plugin: Any, inputs: dict[str, Any], params: Any, _: Context) -> Any:
    product = inputs["product"]
    content = plugin.export(product, params)
    if not isinstance(content, (bytes, bytearray, memoryview)):
        raise PluginError(f"the exporter {plugin.name!r} returned a {type(content).__name__}; it has to return bytes")
    stem = getattr(product, "id", "") or type(product).__name__.lower()
    return Artifact(f"{stem}{plugin.suffix}", plugin.media_type, np.frombuffer(content, np.uint8))


def _make(plugin: Any, _: dict[str, Any], params: Any, __: Context) -> Any:
    return plugin.make(params)


_CALLS = {"processor": _process, "encoder": _encode, "exporter": _export, "scene": _make}


def _calibration(used: list[Any]) -> str:
    for item in used:
        if isinstance(item, Calibration):
            return item.hash
    return _first(getattr(item, "calibration", "") or _origin(item).calibration for item in used)


def _origin(item: Any) -> Provenance:
    origin = getattr(item, "provenance", None)
    return origin if isinstance(origin, Provenance) else Provenance()


def _first(texts: Any) -> str:
    return next((text for text in texts if isinstance(text, str) and text), "")
