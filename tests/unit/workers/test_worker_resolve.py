"""Which object an input gets."""

import numpy as np
import pytest

from fringed.data import Artifact, Calibration, Lens, Mesh
from fringed.errors import DataError
from fringed.workers.resolve import Pool, resolve


def mesh(name: str = "m") -> Mesh:
    return Mesh(np.zeros((3, 3)), np.zeros((1, 3), np.int32), id=name)


def artifact(name: str = "a") -> Artifact:
    return Artifact(name, "text/plain", np.zeros(1, np.uint8))


LENS = Lens(8, 6, np.eye(3), np.zeros(5))
CALIBRATION = Calibration(LENS, LENS, np.eye(4), "rig", "test")
M1, M2, M3, A1 = mesh("1"), mesh("2"), mesh("3"), artifact()


@pytest.mark.parametrize(
    ("wanted", "optional", "sources", "given", "made", "expected"),
    [
        ({"x": Mesh}, (), {}, {"object": M1}, {}, {"x": M1}),
        ({"x": Mesh}, (), {"x": "two"}, {"one": M1, "two": M2}, {}, {"x": M2}),
        ({"one": Mesh}, (), {}, {"one": M1, "two": M2}, {}, {"one": M1}),
        ({"x": Mesh}, (), {}, {"one": M1}, {"s1": M2, "s2": M3}, {"x": M3}),
        ({"x": Mesh}, (), {"x": "s1"}, {"one": M1}, {"s1": M2, "s2": M3}, {"x": M2}),
        ({"x": Mesh, "cal": Calibration}, (), {}, {"o": M1, "c": CALIBRATION}, {}, {"x": M1, "cal": CALIBRATION}),
        ({"a": Mesh, "b": Mesh}, (), {"a": "one", "b": "two"}, {"one": M1, "two": M2}, {}, {"a": M1, "b": M2}),
        ({"a": Mesh, "b": Mesh}, (), {"a": "one"}, {"one": M1}, {"s": M2}, {"a": M1, "b": M2}),
        ({"x": Mesh, "extra": Artifact}, ("extra",), {}, {"o": M1}, {}, {"x": M1}),
        ({"x": Mesh, "extra": Artifact}, ("extra",), {}, {"o": M1, "a": A1}, {}, {"x": M1, "extra": A1}),
        ({"x": Mesh, "dark": Mesh}, ("dark",), {}, {"o": M1}, {}, {"x": M1}),
        ({"x": Mesh, "dark": Mesh}, ("dark",), {}, {"o": M1, "dark": M2}, {}, None),
        ({"views": (Mesh,)}, (), {}, {"v": [M1, M2]}, {}, {"views": (M1, M2)}),
        ({"views": (Mesh,)}, (), {}, {"v": M1, "w": M2, "c": CALIBRATION}, {"s": M3}, {"views": (M1, M2, M3)}),
        ({"views": (Mesh,)}, (), {"views": "w"}, {"v": M1, "w": M2}, {}, {"views": (M2,)}),
        ({"x": Mesh | Artifact}, (), {}, {"c": CALIBRATION, "a": A1}, {}, {"x": A1}),
    ],
)  # fmt: skip
def test_inputs_are_found(wanted, optional, sources, given, made, expected):
    pool = Pool(given, made)
    if expected is None:  # two of a type and only the optional one is named: the other one is ambiguous
        with pytest.raises(DataError, match=r"'x' could be o or dark"):
            resolve(wanted, optional, sources, pool, "s")
    else:
        assert resolve(wanted, optional, sources, pool, "s") == expected


@pytest.mark.parametrize(
    ("wanted", "sources", "given", "made", "text"),
    [
        ({"x": Mesh}, {}, {}, {}, r"stage 's' needs Mesh for its input 'x'; there is: nothing"),
        ({"x": Mesh}, {}, {"c": CALIBRATION}, {}, r"needs Mesh .*there is: c \(Calibration\)"),
        ({"x": Mesh}, {}, {"one": M1, "two": M2}, {}, r"could be one or two"),
        ({"a": Mesh, "b": Mesh}, {}, {"one": M1}, {"s": M2}, r"several inputs of type Mesh \(a, b\)"),
        ({"x": Mesh}, {"x": "nowhere"}, {"one": M1}, {}, r"from 'nowhere'; there is: one"),
        ({"x": Mesh}, {"x": "c"}, {"c": CALIBRATION}, {}, r"which is Calibration; it needs Mesh"),
        ({"x": Mesh}, {"y": "one"}, {"one": M1}, {}, r"maps the inputs y; its plug-in has: x"),
        ({"views": (Mesh,)}, {}, {"c": CALIBRATION}, {}, r"needs one or more Mesh"),
        ({"views": (Mesh,)}, {}, {"v": []}, {}, r"there is: v \(an empty list\)"),
        ({"views": (Mesh,)}, {"views": "v"}, {"v": [M1, A1]}, {}, r"1 x Mesh and 1 x Artifact; it needs one or more"),
    ],
)
def test_missing_ambiguous_and_wrong_inputs_are_told(wanted, sources, given, made, text):
    with pytest.raises(DataError, match=text):
        resolve(wanted, (), sources, Pool(given, made), "s")
