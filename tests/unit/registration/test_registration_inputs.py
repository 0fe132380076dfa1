"""What registration is given wrongly, in other units, or in great numbers: an error or an honest answer."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_relief import errors, head, pose, see

from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.surface import prepare

TURN = pose((0, 20, 0))


@pytest.fixture(scope="module")
def seen():
    return see(head, noise_mm=0.05, seed=1), see(head, TURN, noise_mm=0.05, seed=2)


def run(a, b, **options):
    return register(prepare(a, name="reference"), prepare(b, name="model"), Options(**options))


def only(points, rows, columns):
    out = np.full_like(points, np.nan)
    out[rows, columns] = points[rows, columns]
    return out


@pytest.mark.parametrize(("spoil", "told"), [
    (lambda x: np.full_like(x, np.nan), "0 valid points"), (lambda x: np.full_like(x, np.inf), "0 valid points"),
    (lambda x: only(x, 100, 100), "1 valid points"), (lambda x: only(x, slice(None), 96), "at least 200"),
    (lambda x: np.broadcast_to(x[100, 100], x.shape), "all of them coincide"),
    (lambda x: x.reshape(-1, 3), "expected"), (lambda x: x[..., :2], "expected"),
    (lambda x: np.nan_to_num(x).astype(np.int32), "of floats"), (lambda x: x / np.float32(1000), "different units"),
])  # fmt: skip
def test_input_that_cannot_be_registered_is_refused_by_name(seen, spoil, told):
    with pytest.raises(ValueError, match=told):
        run(seen[0].xyz_mm, spoil(seen[1].xyz_mm))


def test_collinear_points_are_refused():
    x = np.linspace(0, 50, 40)
    line = (x[:, None] + x)[..., None] * np.float32([1, 2, 0.5])
    with pytest.raises(ValueError, match="lie on one line"):
        prepare(line.astype(np.float32))


@pytest.mark.parametrize("spoil", [lambda x: x * np.float32([-1, 1, 1]), lambda x: x[::-1], lambda x: x[:, ::-1]])
def test_mirrored_view_does_not_converge_and_is_called_so(seen, spoil):
    found = run(seen[0].xyz_mm, np.ascontiguousarray(spoil(seen[1].xyz_mm)))
    assert not found.converged and "normals of the model face away" in found.reason


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_units_need_no_setting(seen, unit, dtype):
    a, b = (view.xyz_mm.astype(dtype) * dtype(unit) for view in seen)
    found = run(a, b)
    assert found.converged, found.reason
    T = found.T_reference_model.copy()
    T[:3, 3] /= unit
    degrees, mm = errors(T, *seen)
    assert degrees < 0.02 and mm < 0.02


def test_double_precision_far_from_the_origin_loses_nothing(seen):
    far = np.array([1e6, -2e6, 5e5])
    found = run(*(view.xyz_mm.astype(np.float64) + far for view in seen))
    shift = np.eye(4)
    shift[:3, 3] = far
    assert found.converged
    assert errors(np.linalg.inv(shift) @ found.T_reference_model @ shift, *seen)[1] < 0.02


def test_duplicated_points_do_no_harm(seen):
    """Every second column twice: steps of no length, which no surface has."""
    twice = seen[1].xyz_mm.copy()
    twice[:, 1::4] = twice[:, 0::4]
    assert run(seen[0].xyz_mm, twice).converged


def test_single_column_of_the_overlap_is_no_overlap(seen):
    apart = see(head, noise_mm=0.05, seed=1, columns=(0, 0.3)), see(head, TURN, noise_mm=0.05, seed=2, columns=(0.7, 1))
    found = run(*(view.xyz_mm for view in apart))
    assert not found.converged and found.reason


def test_work_reports_often_enough_to_be_cancelled(seen):
    """Each report may raise; between two of them is no more than one iteration or one preparation."""
    heard = []
    surfaces = prepare(seen[0].xyz_mm), prepare(seen[1].xyz_mm)
    register(*surfaces, Options(), lambda part, text: heard.append((part, text)))
    stages = {text.split(":")[0] for _, text in heard}
    assert len(heard) > 10 and {"medium", "fine", "registered"} <= stages
    assert all(0 <= part <= 1 for part, _ in heard)
