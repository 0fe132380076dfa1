"""A pytest plug-in: the fixture `plugin_contract` checks that a plug-in keeps the contract.

    def test_decoder_keeps_the_contract(plugin_contract, frame_set):
        plugin_contract.processor(MyDecoder, {"frames": frame_set})

Owns the rules that hookspecs.py states in words. A rule that is broken fails the test with what to do.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
import pytest

from fringed import hookspecs
from fringed.config import describe, validate
from fringed.data import Array, FrameSet, Mesh, PatternSequence
from fringed.errors import Cancelled, ConfigurationError, FringedError
from fringed.hookspecs import FrameSetStart, ProjectorTarget
from fringed.tree import split
from fringed.wire import checksum

_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_SUMMARY_MAX = 100
_TOLERANCE = 1e-4  # of an array's largest value: sums in another order round otherwise
_DIFFERENT_MAX = 1e-3  # of the pixels may lie on the other side of a threshold for that
_LIMITS = {"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"}


class RecordingContext:
    """A `Context` that notes what a plug-in says, and stops it when told to."""

    def __init__(self, threads: int = 2, cancelled: bool = False) -> None:
        self.threads = threads
        self.cancelled = cancelled
        self.fractions: list[float] = []
        self.logged: list[tuple[str, str]] = []

    def progress(self, fraction: float, text: str = "") -> None:
        """Note the fraction; raise Cancelled when told to."""
        self.check_cancelled()
        self.fractions.append(fraction)

    def check_cancelled(self) -> None:
        """Raise Cancelled when told to."""
        if self.cancelled:
            raise Cancelled("stopped by the test")

    def log(self, level: str, text: str) -> None:
        """Note the text."""
        self.logged.append((level, text))


class PluginContract:
    """Checks, one method for each kind of plug-in; each fails with an AssertionError that says what to do."""

    def processor(self, cls: Any, inputs: Mapping[str, Any], params: Mapping[str, Any] | None = None) -> Any:
        """Check a processor on good `inputs`, and on missing and wrong ones; return its product."""
        self.metadata(cls, hookspecs.Processor)
        _check_inputs_declared(cls, inputs)
        values = validate(params or {}, cls.Params)
        before = digest(inputs)
        product = cls().run(inputs, values, RecordingContext())
        assert isinstance(product, cls.output), (
            f"{cls.name} returned a {type(product).__name__}; it declares {cls.output}: return a new product"
        )
        again = cls().run(inputs, values, RecordingContext(threads=1))
        assert digest(product) == digest(again), f"{cls.name} gave two results for the same inputs; it must not"
        assert digest(inputs) == before, f"{cls.name} changed its inputs; copy before writing"
        _check_refusals(cls, inputs, values)
        _check_cancellation(cls, inputs, values)
        if issubclass(cls, hookspecs.StreamingProcessor):
            self.streaming(cls, inputs, params)
        return product

    def streaming(self, cls: Any, inputs: Mapping[str, Any], params: Mapping[str, Any] | None = None) -> Any:
        """Check that frames one by one give what the whole set gives; return that product."""
        assert cls.begin.__doc__, f"{cls.name}.begin has no docstring"
        sets = [value for value in inputs.values() if isinstance(value, FrameSet)]
        assert len(cls.inputs) == len(sets) == 1, (
            f"{cls.name} offers `begin`, and has the inputs {sorted(cls.inputs)}; only a processor of one FrameSet can"
        )
        values = validate(params or {}, cls.Params)
        whole = cls().run(inputs, values, RecordingContext())
        product = _streamed(cls(), sets[0], values)
        assert isinstance(product, cls.output), f"{cls.name}'s finish returned a {type(product).__name__}"
        different = _differences(whole, product)
        assert not different, f"{cls.name}: `finish` and `run` differ in {', '.join(different)}; both return the same"
        return product

    def encoder(
        self, cls: Any, params: Mapping[str, Any] | None = None, target: ProjectorTarget | None = None
    ) -> PatternSequence:
        """Check an encoder; return its sequence."""
        self.metadata(cls, hookspecs.Encoder)
        target = target or ProjectorTarget(1024, 768)
        values = validate(params or {}, cls.Params)
        sequence = cls().encode(values, target)
        assert isinstance(sequence, PatternSequence), f"{cls.name} returned a {type(sequence).__name__}"
        assert (sequence.width_px, sequence.height_px) == (target.width_px, target.height_px), (
            f"{cls.name} made patterns for {sequence.width_px} x {sequence.height_px}; the target has "
            f"{target.width_px} x {target.height_px}"
        )
        assert cls.decoders, f"{cls.name} names no decoder that understands its patterns"
        assert digest(sequence) == digest(cls().encode(values, target)), f"{cls.name} gave two different sequences"
        return sequence

    def exporter(self, cls: Any, product: Any, params: Mapping[str, Any] | None = None) -> bytes:
        """Check an exporter on a good product and on a wrong one; return the file's content."""
        self.metadata(cls, hookspecs.Exporter)
        assert cls.suffix.startswith("."), f"{cls.name}: suffix {cls.suffix!r} must start with a dot"
        assert re.fullmatch(r"[\w.+-]+/[\w.+-]+", cls.media_type), f"{cls.name}: {cls.media_type!r} is no media type"
        assert isinstance(product, tuple(cls.accepts)), f"{cls.name} does not accept a {type(product).__name__}"
        values = validate(params or {}, cls.Params)
        before = digest(product)
        content = cls().export(product, values)
        assert isinstance(content, bytes) and content, f"{cls.name} must return the file's content as bytes"
        assert content == cls().export(product, values), f"{cls.name} wrote two different files"
        assert digest(product) == before, f"{cls.name} changed its input; copy before writing"
        with expected_refusal(f"{cls.name} given an object of a foreign type"):
            cls().export(object(), values)
        return content

    def scene(self, cls: Any, params: Mapping[str, Any] | None = None) -> Mesh:
        """Check a maker of objects; return its mesh."""
        self.metadata(cls, hookspecs.SceneMaker)
        values = validate(params or {}, cls.Params)
        mesh = cls().make(values)
        assert isinstance(mesh, Mesh), f"{cls.name} returned a {type(mesh).__name__}"
        assert digest(mesh) == digest(cls().make(values)), f"{cls.name} made two different meshes"
        return mesh

    def metadata(self, cls: Any, contract: Any) -> None:
        """Check names, texts and parameters."""
        wanted = [*contract.__annotations__, *(n for n, v in vars(contract).items() if _is_method(n, v))]
        missing = [name for name in wanted if not hasattr(cls, name)]
        assert not missing, f"{cls.__name__} lacks {', '.join(missing)}; see {contract.__name__} in hookspecs.py"
        assert _NAME.fullmatch(cls.name), f"name {cls.name!r} must be lower-case words joined by hyphens"
        assert isinstance(cls.version, str) and cls.version, f"{cls.name} has no version"
        assert 0 < len(cls.summary) <= _SUMMARY_MAX and "\n" not in cls.summary, (
            f"{cls.name}: the summary must be one line of at most {_SUMMARY_MAX} characters"
        )
        assert cls.__doc__, f"{cls.name} has no docstring; say what it does and where that is published"
        for name in wanted:
            if inspect.isfunction(getattr(cls, name)):
                assert getattr(cls, name).__doc__, f"{cls.name}.{name} has no docstring"
        check_params(cls)


def check_params(cls: Any) -> None:
    """Check that all parameters have defaults, help, and numbers limits and units; unknown ones are refused.

    Counts and fractions, integers and numbers up to 1, need no units.
    """
    params = cls.Params
    assert isinstance(params, type) and issubclass(params, hookspecs.Params), (
        f"{cls.name}.Params must derive from fringed.hookspecs.Params"
    )
    with pytest.raises(ConfigurationError):
        validate({"no_such_parameter": 1}, params)
    schema = describe(params)
    if "$ref" in schema:
        schema = schema["$defs"][schema["$ref"].rsplit("/", 1)[1]]
    required = schema.get("required", [])
    assert not required, f"{cls.name}: give {', '.join(required)} a default, so that the plug-in runs as it is"
    for name, entry in schema.get("properties", {}).items():
        assert entry.get("description"), f"{cls.name}.Params.{name} has no description; annotate it with msgspec.Meta"
        numbers = [kind for kind in (entry, *entry.get("anyOf", ())) if kind.get("type") in ("number", "integer")]
        if numbers:
            where = f"{cls.name}.Params.{name}"
            assert any(_LIMITS & set(kind) for kind in (entry, *numbers)), f"{where} has no limits; add ge= or le="
            plain = all(kind["type"] == "integer" or kind.get("maximum", 2) <= 1 for kind in numbers)
            assert plain or "units" in entry or any("units" in kind for kind in numbers), (
                f"{where} has no units; add extra_json_schema={{'units': 'mm'}}, or '1' for a ratio"
            )


def digest(value: Any) -> Any:
    """Return `value` as plain types, with a checksum in each array's place and without identities and times."""
    if isinstance(value, Mapping):
        return {key: digest(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [digest(item) for item in value]
    arrays: dict[str, Any] = {}
    tree = split(value, "", arrays)
    if isinstance(tree, dict):
        tree = {key: item for key, item in tree.items() if key not in ("id", "scan", "provenance")}
    described = {path: (array.dtype.str, array.shape, checksum(array)) for path, array in arrays.items()}
    return msgspec.to_builtins({"tree": repr(tree), "arrays": described})


class expected_refusal:  # noqa: N801  reads like pytest.raises
    """Expect a FringedError, and say so when something else comes."""

    def __init__(self, what: str) -> None:
        self._what = what

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> bool:
        """Swallow a FringedError."""
        assert error is not None, f"{self._what} raised nothing; it must raise DataError"
        if isinstance(error, Exception) and not isinstance(error, FringedError):
            raise AssertionError(
                f"{self._what} raised {type(error).__name__}; it must raise DataError with a clear text"
            ) from error
        return isinstance(error, FringedError)


def _streamed(plugin: Any, frame_set: FrameSet, values: Any) -> Any:
    """Bring a set frame by frame, each in memory that is used again, beside another set at the same plug-in."""
    frames = frame_set.frames
    start = FrameSetStart(
        frame_set.sequence, frame_set.settings, frames.shape[1:], frames.dtype.name, frame_set.role
    )  # fmt: skip
    sink, other = (plugin.begin(start, values, RecordingContext()) for _ in range(2))
    scratch = np.empty_like(frames[0])
    seen = scratch.view()
    seen.flags.writeable = False
    for index, image in enumerate(frames):
        scratch[...] = image
        sink.add(index, seen)
        scratch[...] = image[::-1]
        other.add(index, seen)
    scratch[...] = np.iinfo(scratch.dtype).max
    return sink.finish(frame_set, RecordingContext())


def _differences(one: Any, other: Any) -> list[str]:
    """Name what differs by more than rounding, identities and times left out."""
    mine: dict[str, Array] = {}
    others: dict[str, Array] = {}
    trees = [split(value, "", arrays) for value, arrays in ((one, mine), (other, others))]
    plain = [{k: repr(v) for k, v in tree.items() if k not in ("id", "scan", "provenance")} for tree in trees]
    named = [key for key in plain[0] if plain[0][key] != plain[1].get(key)]
    return named + [path for path in mine if path in others and not _alike(mine[path], others[path])]


def _alike(one: Array, other: Array) -> bool:
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    if one.dtype.kind != "f":
        return float(np.mean(one != other)) <= _DIFFERENT_MAX
    largest = float(np.max(np.abs(one), initial=0.0, where=np.isfinite(one)))
    close = np.isclose(one, other, rtol=_TOLERANCE, atol=_TOLERANCE * largest, equal_nan=True)
    return float(np.mean(~close)) <= _DIFFERENT_MAX


def _is_method(name: str, value: Any) -> bool:
    return inspect.isfunction(value) and not name.startswith("_")


def _check_inputs_declared(cls: Any, inputs: Mapping[str, Any]) -> None:
    unknown = set(inputs) - set(cls.inputs)
    assert not unknown, f"{cls.name} declares the inputs {sorted(cls.inputs)}; the test gives {sorted(unknown)} too"
    foreign = set(cls.optional) - set(cls.inputs)
    assert not foreign, f"{cls.name}.optional names {sorted(foreign)}, which are no inputs"


def _check_refusals(cls: Any, inputs: Mapping[str, Any], values: Any) -> None:
    for name in sorted(set(inputs) - set(cls.optional)):
        less = {key: value for key, value in inputs.items() if key != name}
        with expected_refusal(f"{cls.name} without its input {name!r}"):
            cls().run(less, values, RecordingContext())
        foreign = (object(),) if isinstance(cls.inputs[name], tuple) else object()
        with expected_refusal(f"{cls.name} given a foreign object as {name!r}"):
            cls().run({**inputs, name: foreign}, values, RecordingContext())


def _check_cancellation(cls: Any, inputs: Mapping[str, Any], values: Any) -> None:
    try:
        cls().run(inputs, values, RecordingContext(cancelled=True))
    except Cancelled:
        return
    raise AssertionError(
        f"{cls.name} ran to its end although it was cancelled; call context.check_cancelled() or progress() now and "
        "then, and let Cancelled pass"
    )


@pytest.fixture
def plugin_contract() -> PluginContract:
    """Return the checks of the plug-in contract."""
    return PluginContract()
