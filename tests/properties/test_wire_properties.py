"""What is sent arrives, for every kind; what is not a message is refused, whatever its bytes."""

from __future__ import annotations

import dataclasses
import json
from contextlib import suppress
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from fringed.data import FrameSet, PatternFrame, PatternSequence, PhaseErrorTable, PhaseMap, PixelModel, RangeImage
from fringed.errors import DataError, VersionMismatch, WireError
from fringed.messages import Pixels, Reply, Request
from fringed.wire import DTYPES, KINDS, checksum, decode, encode, peek, prepare

FEW = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
MORE = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])

any_array = arrays.arrays(
    st.sampled_from(sorted(DTYPES)).map(np.dtype), arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)
)
scalars = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=8)
keys = st.text(max_size=4) | st.sampled_from(["$array", "$kind", "$float", "$$", "a/b", "~1", ".", "", "a"])
anything = st.recursive(
    scalars | any_array,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3),
    max_leaves=6,
)


def parts(content: Any, topic: str = "t", seq: int = 1) -> list[bytes]:
    return [memoryview(part).tobytes() for part in encode(content, topic, seq)]


def same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    if dataclasses.is_dataclass(one):
        names = [field.name for field in dataclasses.fields(one)]
        return type(one) is type(other) and all(same(getattr(one, n), getattr(other, n)) for n in names)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same, one, other))
    return bool((one == other and type(one) is type(other)) or (one != one and other != other))


def of_hint(hint: Any) -> st.SearchStrategy[Any]:
    """Return a strategy for a field's type."""
    origin, args = get_origin(hint), get_args(hint)
    if hint is Any:
        return anything
    if origin is np.ndarray:
        (scalar,) = get_args(args[1]) or (Any,)
        return any_array if scalar is Any else arrays.arrays(scalar, st.just((4, 4)))
    if origin is Literal:
        return st.sampled_from(args)
    if origin is tuple and Ellipsis not in args:
        return st.tuples(*map(of_hint, args))
    if origin is tuple:
        return st.lists(of_hint(args[0]), max_size=2).map(tuple)
    if origin is Union or type(hint).__name__ == "UnionType":
        return st.one_of(*map(of_hint, args))
    if "Mapping" in str(origin):
        return st.dictionaries(keys, of_hint(args[1]), max_size=2)
    if dataclasses.is_dataclass(hint):
        return of_class(hint)
    simple = {str: st.text(max_size=6), bool: st.booleans(), float: st.floats(), type(None): st.none()}
    return simple.get(hint, st.integers(-(2**53), 2**53))


def of_class(cls: Any) -> st.SearchStrategy[Any]:
    """Return a strategy for a dataclass whose arrays fit together."""
    if cls in SHAPED:
        return SHAPED[cls]()
    hints = get_type_hints(cls)
    return st.builds(cls, **{field.name: of_hint(hints[field.name]) for field in dataclasses.fields(cls)})


def with_arrays(cls: Any, shapes: dict[str, tuple[int, ...]], fixed: dict[str, Any]) -> st.SearchStrategy[Any]:
    hints = get_type_hints(cls)

    def strategy(name: str) -> st.SearchStrategy[Any]:
        if name in fixed:
            return st.just(fixed[name])
        if name not in shapes:
            return of_hint(hints[name])
        alias = next(h for h in (hints[name], *get_args(hints[name])) if get_origin(h) is np.ndarray)
        filled = arrays.arrays(get_args(get_args(alias)[1])[0], st.just(shapes[name]))
        return filled | st.none() if type(None) in get_args(hints[name]) else filled

    return st.builds(cls, **{field.name: strategy(field.name) for field in dataclasses.fields(cls)})


def images(names: str, **more: tuple[int, ...]) -> dict[str, tuple[int, ...]]:
    return {**dict.fromkeys(names.split(), (3, 2)), **more}


def sequences(count: int = 2) -> st.SearchStrategy[Any]:
    patterns = st.tuples(*[arrays.arrays(np.uint8, st.sampled_from([(1, 5, 1), (4, 1, 3), (1, 1, 1)]))] * count)
    frames = st.tuples(*[of_class(PatternFrame)] * count)
    return st.builds(
        PatternSequence, family=st.text(max_size=5), width_px=st.just(5), height_px=st.just(4), frames=frames,
        patterns=patterns, parameters=st.dictionaries(keys, anything, max_size=2), grey_low=st.floats(),
    )  # fmt: skip


def frame_sets() -> st.SearchStrategy[Any]:
    frames = arrays.arrays(st.sampled_from([np.uint8, np.dtype("<u2"), np.dtype(">u2")]), st.just((2, 3, 4)))
    hints = get_type_hints(FrameSet)
    rest = {name: of_hint(hints[name]) for name in ("role", "id", "scan", "settings", "check", "provenance")}
    stamps = st.just(()) | st.tuples(*[of_hint(get_args(hints["stamps"])[0])] * 2)
    return st.builds(FrameSet, frames=frames, sequence=sequences(), stamps=stamps, **rest)


def shaped(name: str, shapes: dict[str, tuple[int, ...]], **fixed: Any) -> Any:
    return lambda: with_arrays(KINDS.get(name) or LENS, shapes, fixed)


LENS = get_type_hints(KINDS["Calibration"])["camera"]
PHASE_IMAGES = "phase_rad modulation background rejected sigma_rad wrapped_rad confidence"
SHAPED: dict[Any, Any] = {
    PatternSequence: sequences,
    FrameSet: frame_sets,
    LENS: shaped("Lens", {"matrix": (3, 3), "distortion": (5,)}),
    PhaseErrorTable: lambda: st.builds(
        PhaseErrorTable, steps=st.integers(3, 99), period_px=st.floats(), error_rad=arrays.arrays(float, 8)
    ),
    KINDS["Calibration"]: shaped(
        "Calibration",
        {
            "T_projector_camera": (4, 4),
            "reference_plane": (4,),
            "tone_curve": (256,),
            "crosstalk": (3, 3),
            "covariance": (2, 2),
        },
        parameters=("camera.fx", "camera.fy"),
        model="stereo",
    ),
    KINDS["BoardView"]: shaped(
        "BoardView",
        {
            "index": (3,),
            "camera_px": (3, 2),
            "camera_sigma_px": (3,),
            "ellipses": (3, 5),
            "projector_px": (3, 2),
            "projector_sigma_px": (3, 2),
            "projector_jacobian": (3, 2, 2),
            "light": (3,),
            "picture": (2, 4),
        },
    ),
    PixelModel: lambda: st.builds(
        PixelModel,
        coefficients=arrays.arrays(np.float32, (3, 2, 2)),
        form=st.just("rational"),
        orientation=st.just("rows"),
        period_px=st.floats(),
        initial_phase_rad=st.floats(),
        z_range_mm=st.tuples(st.floats(), st.floats()),
    ),
    PhaseMap: shaped("PhaseMap", images(PHASE_IMAGES)),
    RangeImage: shaped("RangeImage", images("rejected intensity sigma_mm", xyz_mm=(3, 2, 3))),
    KINDS["Model"]: shaped(
        "Model",
        {
            "points_mm": (2, 3),
            "normals": (2, 3),
            "intensity": (2,),
            "view_index": (2,),
            "confidence": (2,),
            "T_model_view": (1, 4, 4),
            "faces": (0, 3),
        },
    ),
    KINDS["Truth"]: shaped(
        "Truth", images("visible lit is_object", xyz_mm=(3, 2, 3), projector_px=(3, 2, 2), T_camera_object=(4, 4))
    ),
    KINDS["Mesh"]: shaped("Mesh", {"vertices_mm": (3, 3), "faces": (1, 3), "albedo": (3,)}),
}


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_arrives_as_it_was_sent(kind: str) -> None:
    @settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
    @given(of_class(KINDS[kind]), st.text(max_size=9), st.integers(0, 2**63))
    def check(content: Any, topic: str, seq: int) -> None:
        envelope = decode(parts(content, topic, seq))
        assert (envelope.topic, envelope.seq, envelope.kind) == (topic, seq, kind)
        assert same(content, envelope.content)

    check()


@MORE
@given(st.dictionaries(keys, anything, max_size=4))
def test_requests_may_hold_anything_at_any_depth(params: dict[str, Any]) -> None:
    assert same(decode(parts(Request("1", "v", params))).content.params, params)


@FEW
@given(of_class(RangeImage) | of_class(PhaseMap) | of_class(FrameSet))
def test_replies_may_hold_data_objects(content: Any) -> None:
    assert same(decode(parts(Reply("1", content))).content.result, content)
    assert same(decode(parts(Reply("1", {"deep": [content]}))).content.result["deep"][0], content)


def test_arrays_are_views_of_what_came_and_read_only() -> None:
    raw = parts(Pixels(np.arange(12, dtype=np.uint8)))
    array = decode(raw).content.array
    assert np.shares_memory(array, np.frombuffer(raw[2], np.uint8))
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1


def test_an_object_encoded_once_is_sent_many_times_without_copies() -> None:
    image = np.arange(12, dtype=np.uint8)
    encoded = prepare(Pixels(image))
    one, two = encoded.frames("a", 1), encoded.frames("b", 2)
    assert one[2] is two[2] and np.shares_memory(one[2], image)
    assert [decode([memoryview(p).tobytes() for p in m]).seq for m in (one, two)] == [1, 2]
    assert encoded.nbytes == 12


# What is no message is refused with WireError (or VersionMismatch, which is one), and with nothing else.


def refused_or_read(frames: list[Any]) -> None:
    for read in (decode, peek):
        with suppress(WireError):
            read(frames)


@MORE
@given(st.lists(st.binary(max_size=200), max_size=6))
def test_random_parts_never_do_more_than_be_refused(frames: list[bytes]) -> None:
    refused_or_read(frames)


odd_keys = st.sampled_from(["$array", "$kind", "$float", "v", "frames", "id"]) | st.text(max_size=3)
json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(odd_keys, inner, max_size=3),
    max_leaves=6,
)
odd_shapes = st.lists(st.integers(-2, 2**70) | st.just(0), max_size=40)
odd_buffers = st.fixed_dictionaries(
    {
        "path": st.text(max_size=5) | st.just("array"),
        "dtype": st.sampled_from(
            [*sorted(DTYPES), "|O", "|V8", "<U4", ">f8", "<M8[s]", "<c16", "f4,f4", "", "x" * 999]
        ),
        "shape": odd_shapes,
        "xxh3": st.text(max_size=17),
    }
)
odd_headers = st.fixed_dictionaries(
    {
        "v": st.just(1),
        "kind": st.sampled_from([*sorted(KINDS), "Os", ""]),
        "body": json_like | st.just({"array": {"$array": "array"}}),
    },
    optional={"seq": st.integers() | st.text(max_size=3), "buffers": st.lists(odd_buffers, max_size=3) | json_like},
)


@MORE
@given(odd_headers, st.lists(st.binary(max_size=64), max_size=3))
def test_headers_of_odd_values_never_do_more_than_be_refused(header: dict[str, Any], buffers: list[bytes]) -> None:
    refused_or_read([b"", json.dumps(header).encode(), *buffers])


MESSAGE = parts(Request("1", "process", {"a": np.arange(50, dtype=np.uint16), "b": [{"$x": 1.5}, "text"]}))


@MORE
@given(st.data())
def test_flipped_truncated_and_shuffled_messages_never_do_more_than_be_refused(data: st.DataObject) -> None:
    frames = [bytearray(part) for part in MESSAGE]
    for _ in range(data.draw(st.integers(1, 4))):
        part = frames[data.draw(st.integers(0, len(frames) - 1))]
        position = data.draw(st.integers(0, max(0, len(part) - 1)))
        if data.draw(st.booleans()):
            del part[position:]
        elif part:
            part[position] ^= 1 << data.draw(st.integers(0, 7))
    refused_or_read(data.draw(st.permutations(frames)) if data.draw(st.booleans()) else list(frames))


def test_a_damaged_buffer_is_found() -> None:
    frames = [bytearray(part) for part in MESSAGE]
    frames[2][10] ^= 4
    with pytest.raises(WireError, match="checksum"):
        decode(frames)
    assert decode(frames, verify=False).kind == "Request"


def with_buffer(buffer: bytes = bytes(4), **changes: Any) -> list[bytes]:
    described = {"path": "array", "dtype": "|u1", "shape": [4], "xxh3": checksum(np.zeros(4, np.uint8)), **changes}
    body = {"array": {"$array": "array"}}
    return [b"", json.dumps({"v": 1, "kind": "Pixels", "body": body, "buffers": [described]}).encode(), buffer]


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"shape": [2**62, 2**62]}, "has 4 bytes"),
        ({"shape": [2**80]}, ""),
        ({"shape": [-1]}, "shape"),
        ({"shape": [1] * 33}, "shape"),
        ({"shape": [5]}, "has 4 bytes"),
        ({"dtype": "|O"}, "dtype '|O'"),
        ({"dtype": ">f4", "shape": [1]}, "dtype '>f4'"),
        ({"dtype": "|V4", "shape": [1]}, "dtype"),
        ({"path": "other"}, "names the array 'array'"),
        ({"xxh3": "f" * 16}, "checksum"),
    ],
)
def test_impossible_buffers_are_refused_with_the_reason(changes: dict[str, Any], why: str) -> None:
    with pytest.raises(WireError) as caught:
        decode(with_buffer(**changes))
    assert why in str(caught.value)


@pytest.mark.parametrize("shape", [[0, 2**62], [2**62, 0, 2**62], [0] * 32])
def test_empty_arrays_of_huge_shapes_cost_nothing(shape: list[int]) -> None:
    refused_or_read(with_buffer(b"", shape=shape))


@pytest.mark.parametrize("depth", [100, 10_000, 1_000_000])
def test_deep_nesting_is_refused(depth: int) -> None:
    for opening, closing in ((b"[", b"]"), (b'{"a":', b"}")):
        deep = opening * depth + b"1" + closing * depth
        with pytest.raises(WireError):
            decode([b"", b'{"v":1,"kind":"Request","body":{"id":"","verb":"","params":{"x":' + deep + b"}}}"])


def test_too_deep_content_is_not_sent() -> None:
    deep: Any = 1
    for _ in range(5000):
        deep = [deep]
    with pytest.raises(WireError, match="deeper"):
        encode(Request("1", "v", {"x": deep}))


@pytest.mark.parametrize(
    "value", [{1, 2}, b"bytes", 2**64, -(2**63) - 1, object(), np.array(["text"]), np.array([None]), "\ud800", 1j]
)
def test_what_does_not_travel_is_refused_by_the_sender(value: Any) -> None:
    with pytest.raises(WireError, match="Request"):
        encode(Request("1", "v", {"x": value}))
    with pytest.raises(WireError, match="does not travel; the wire carries"):
        encode(value)


@pytest.mark.parametrize("header", [{"v": 2, "kind": "Request"}, {"v": 0, "kind": 5, "other": []}, {"v": 99}])
def test_other_versions_are_told_apart_whatever_their_header_holds(header: dict[str, Any]) -> None:
    with pytest.raises(VersionMismatch, match=f"version {header['v']}; this side speaks 1: install"):
        decode([b"", json.dumps(header).encode()])


def test_unknown_header_keys_and_fields_are_ignored() -> None:
    header = json.loads(MESSAGE[1])
    header["new"] = {"x": 1}
    header["body"]["new"] = [1]
    header["buffers"][0]["new"] = 1
    assert decode([MESSAGE[0], json.dumps(header).encode(), *MESSAGE[2:]]).content.verb == "process"


def test_number_of_parts_is_limited() -> None:
    for frames in ([], [b""], [b""] * 5000):
        with pytest.raises(WireError, match="parts"):
            decode(frames)
    with pytest.raises(WireError, match="at most 4096"):
        encode(Request("1", "v", {str(k): np.zeros(1) for k in range(4097)}))


def test_contradictory_content_is_refused_as_a_wire_error() -> None:
    raw = parts(PhaseMap(*[np.zeros((2, 3), np.float32)] * 3, np.zeros((2, 3), np.uint8), "wrapped", 8.0))
    header = json.loads(raw[1])
    header["buffers"][0]["shape"] = [3, 2]
    with pytest.raises(WireError, match="siblings have"):
        decode([raw[0], json.dumps(header).encode(), *raw[2:]])


def test_arrays_of_another_declared_type_are_kept_only_where_no_value_is_lost() -> None:
    zeros = np.zeros((2, 3))
    image = PhaseMap(zeros, zeros, zeros, np.zeros((2, 3), bool), "wrapped", 8.0)
    assert (image.phase_rad.dtype, image.rejected.dtype) == (np.float32, np.uint16)
    for wrong in (np.full((2, 3), 65536), np.full((2, 3), 0.5), np.full((2, 3), -1)):
        with pytest.raises(DataError, match=r"PhaseMap\.rejected is of type"):
            PhaseMap(zeros, zeros, zeros, wrong, "wrapped", 8.0)
