"""One cause for what an adjustment leaves: a print that is stretched or bent, a rig that moved, or none with a name.

Owns the candidates, each a few more numbers estimated with all the others to the first order, and the choice among them
by what they explain; `findings` and `consistency` look at views one by one, this at all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.solve.adjustment import Adjusted
from fringed_plugins.calibration.solve.findings import Finding
from fringed_plugins.calibration.solve.observations import Observation
from fringed_plugins.calibration.solve.projection import POSE, SHARED, STEREO
from fringed_plugins.calibration.solve.shape import SHAPE, bend_mm, directions, reach_mm

Float64Array = npt.NDArray[np.float64]
Kind = Literal["none", "stretch", "shape", "drift", "step", "scatter"]

MOVED_DEG, MOVED_MM = 0.02, 0.3  # least that counts as a moved rig
STRETCH, BEND = 5e-4, 0.004  # refused from there on; the bend over the board's half length
_BLIND = 2.5e-4  # deviation of the stretch beyond which nothing can be said of it
_SURE = 20.0  # by which the criterion has to fall
_RANK = 1e-11
_SIGNIFICANT = 5.0
_SQUARE = 0.003


class Cause(NamedTuple):
    """A cause, its numbers and their deviations, and the criterion: the lower, the better it explains.

    `left` is the sum of squares of the `counted` residuals, in their deviations; `numbers` are those it has more, and
    `split` is the first view after a step. `covariance` (24, 24) is that of the adjustment's numbers where these are
    estimated too, None where they cannot be.
    """

    kind: Kind
    values: Float64Array
    deviations: Float64Array
    criterion: float
    left: float = 1.0
    counted: int = 1
    numbers: int = 0
    split: int = 0
    covariance: Float64Array | None = None


class _Part(NamedTuple):
    """One view, in deviations: derivatives (m, 30), residuals (m,), derivatives by projector's place and print."""

    J: Float64Array
    off: Float64Array
    stereo: Float64Array
    shape: Float64Array


def findings_of(seen: Sequence[Observation], found: Adjusted, told: Sequence[Cause]) -> list[Finding]:
    """Say what in the residuals has a cause that no view shows by itself, and what could not be seen."""
    best, stretch = told[0], next(cause for cause in told if cause.kind == "stretch")
    blind = not stretch.deviations[0] < _BLIND
    result = []
    if blind:
        result.append(Finding("", "whether the print is stretched cannot be told; turn the board in its plane by 90 "
                                  "degrees in some poses"))  # fmt: skip
        result += _not_square(found)
    if best.kind in ("drift", "step"):
        result.append(_moved(best, [one.name for one in seen]))
    elif best.kind == "scatter":
        result.append(_scattered(told))
    return result


def causes(seen: Sequence[Observation], found: Adjusted) -> list[Cause]:
    """Return every cause that was looked at, the one that explains best first.

    Each is estimated with all numbers of the adjustment to the first order. They are compared by the Bayesian
    criterion, N log(sum of squares) + k log N for k numbers more, which does not need to know the noise; "none" comes
    first where no other is better by 20.

    References
    ----------
    Schwarz 1978 (the criterion); Rao 1948 (the test by first derivatives only).
    """
    reach = reach_mm(seen)
    parts = [_part(seen[v], found, v, reach) for v in range(len(seen))]
    count, free = len(parts), found.weights.free
    none = [np.zeros((len(part.off), 0)) for part in parts]
    weights = np.linspace(-0.5, 0.5, count)
    told = [
        _tested("none", parts, none, free),
        _tested("stretch", parts, [part.shape[:, :1] for part in parts], free),
        _tested("shape", parts, [part.shape for part in parts], free),
        _tested("drift", parts, [part.stereo * w for part, w in zip(parts, weights, strict=True)], free),
        _tested("scatter", parts, none, free),
    ]
    for split in range(1, count):
        extra = [part.stereo * (v >= split) for v, part in enumerate(parts)]
        told.append(_tested("step", parts, extra, free, split=split))
    return sorted(told, key=lambda cause: cause.criterion - (_SURE if cause.kind == "none" else 0.0))


def _part(observed: Observation, found: Adjusted, v: int, reach: float) -> _Part:
    now, weights = found.residuals[v], found.weights
    moves = found.rig.poses[v, :3, :3] @ directions(observed.board_mm, reach)
    spread = np.repeat(observed.camera_sigma_px[:, None], 2, axis=1) * weights.camera_factor
    lit = observed.projector_sigma_px * weights.projector_factor
    rows = []
    for off, by, sigma, used, lit_only in (
        (now.camera, now.by_camera, spread, weights.camera_used[v], 0.0),
        (now.projector, now.by_projector, lit, weights.projector_used[v], 1.0),
    ):
        shape = by[..., POSE][..., 3:] @ moves
        every = np.concatenate([by, off[..., None], by[..., STEREO] * lit_only, shape], -1)
        rows.append((every[used] / sigma[used][..., None]).reshape(-1, every.shape[-1]))
    table = np.concatenate(rows)
    return _Part(table[:, :30], table[:, 30], table[:, 31:37], table[:, 37:])


def _tested(
    kind: Kind, parts: list[_Part], extra: list[Float64Array], free: npt.NDArray[np.bool_], *, split: int = 0
) -> Cause:
    """Estimate `extra` (m, k) numbers of all views; for "scatter" each view has a projector's place of its own."""
    more = extra[0].shape[1]
    total, side = np.zeros((SHARED + more, SHARED + more)), np.zeros(SHARED + more)
    left = 0.0
    for part, columns in zip(parts, extra, strict=True):
        shared = np.concatenate([part.J[:, :SHARED], columns], -1)
        own = np.concatenate([part.J[:, SHARED:], part.stereo], -1) if kind == "scatter" else part.J[:, SHARED:]
        basis = _basis(own)
        shared, off = shared - basis @ (basis.T @ shared), part.off - basis @ (basis.T @ part.off)
        total, side, left = total + shared.T @ shared, side + shared.T @ off, left + float(off @ off)
    among = np.append(free, np.ones(more, bool))
    if kind == "scatter":
        among[STEREO] = False
    values, covariance = _solved(total[np.ix_(among, among)], side[among])
    left -= float(values @ side[among])
    counted = sum(len(part.off) for part in parts)
    numbers = 6 * (len(parts) - 1) if kind == "scatter" else more + (kind == "step")
    criterion = counted * np.log(max(left, 1e-300)) + numbers * np.log(counted)
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0)) if covariance is not None else np.full(len(values), np.inf)
    places = slice(len(values) - more, None)
    whole = None
    if covariance is not None:
        whole = np.zeros((SHARED + more, SHARED + more))
        whole[np.ix_(among, among)] = covariance
        whole = whole[:SHARED, :SHARED]
    return Cause(kind, values[places], spread[places], float(criterion), left, counted, numbers, split, whole)


def between_views(told: Sequence[Cause]) -> float:
    """Return the variance of what views say of the projector over what the noise of their points leaves; 1 at least.

    Where residuals have a cause that is the same for all points of a view, points are no witnesses of their own: the
    covariance is too small by this factor (Fisher's F, of views against points).
    """
    by_kind = {cause.kind: cause for cause in told}
    none, scatter = by_kind["none"], by_kind["scatter"]
    if told[0].kind == "none" or scatter.numbers == 0:
        return 1.0
    return max((none.left - scatter.left) / scatter.numbers / (none.left / none.counted), 1.0)


def _basis(columns: Float64Array) -> Float64Array:
    """Return an orthonormal basis of what columns span, without those that are none of their own."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]])


def _solved(matrix: Float64Array, side: Float64Array) -> tuple[Float64Array, Float64Array | None]:
    """Return the solution and its covariance, None where some number is not determined."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * scale[:, None] * scale
    values, vectors = np.linalg.eigh(scaled)
    kept = values > _RANK * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T * scale[:, None] * scale
    return inverse @ side, inverse if kept.all() else None


def shape_of(seen: Sequence[Observation], values: Float64Array, deviations: Float64Array) -> list[Finding]:
    """Say what the print is like that has been found, by its numbers and their deviations: `shape.directions`."""
    result = []
    stretch, bend = float(values[0]), bend_mm(seen, values)
    if abs(stretch) > _SIGNIFICANT * deviations[0]:
        text = f"the print is {abs(stretch):.3%} {'longer' if stretch > 0 else 'shorter'} along x than along y"
        text = f"{text} (known to {deviations[0]:.3%})"
        fatal = abs(stretch) >= STRETCH
        told = "was it scaled by the printer? Measure both directions, and print it again" if fatal else "allowed for"
        result.append(Finding("", f"{text}: {told}", fatal))
    if len(values) == SHAPE and (np.abs(values[1:]) > _SIGNIFICANT * deviations[1:]).any():
        limit = BEND * reach_mm(seen)
        fatal = bend > limit
        told = f"at most {limit:.2f} mm are accepted; glue it on glass" if fatal else "allowed for"
        result.append(Finding("", f"the board is bent by {bend:.3f} mm: {told}", fatal))
    return result


def _moved(cause: Cause, names: Sequence[str]) -> Finding:
    angle = float(np.degrees(np.linalg.norm(cause.values[:3])))
    length = float(np.linalg.norm(cause.values[3:]))
    amount = f"turned by {angle:.3f} degrees and moved by {length:.2f} mm against the camera"
    fatal = angle > MOVED_DEG or length > MOVED_MM
    if cause.kind == "drift":
        return Finding("", f"the rig moved little by little: from the first view to the last the projector {amount}; "
                           "let it warm up, fix it, and take the views again", fatal)  # fmt: skip
    before, after = names[cause.split - 1], names[cause.split]
    return Finding(after, f"the rig moved between {before} and {after}: the projector {amount}; fix both, and take the "
                          "views again", fatal)  # fmt: skip


def _scattered(told: Sequence[Cause]) -> Finding:
    factor = float(np.sqrt(between_views(told)))
    text = f"views contradict each other {factor:.1f} times as much as the noise of their points explains"
    return Finding("", f"{text}; is all of the rig tight, and the board flat? The deviations are larger by that factor")


def _not_square(found: Adjusted) -> list[Finding]:
    """Refuse a camera whose pixels are not square where a stretched print would look the same."""
    lens, variance = found.rig.camera, found.covariance
    ratio = lens.matrix[1, 1] / lens.matrix[0, 0]
    deviation = float(np.sqrt(max(variance[0, 0] + variance[1, 1] - 2 * variance[0, 1], 0.0))) / lens.matrix[0, 0]
    if abs(ratio - 1) < max(_SQUARE, 5 * deviation):
        return []
    text = f"the camera's pixels come out {abs(ratio - 1):.2%} off square, or the print is stretched by as much"
    return [Finding("", f"{text}: only boards that are turned in their plane tell which; add such poses", True)]
