"""Views of a board to a calibrated rig, or the reason why there is none.

Owns the order: what cannot be is refused before anything is estimated, views that do not fit are left out and named,
and what comes out is looked at again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.projector_points import wrong_orders
from fringed_plugins.calibration.solve import causes, consistency, findings
from fringed_plugins.calibration.solve.adjustment import Adjusted, Tick
from fringed_plugins.calibration.solve.estimate import Settings, estimate
from fringed_plugins.calibration.solve.findings import Finding
from fringed_plugins.calibration.solve.initial import Size, initial_rig
from fringed_plugins.calibration.solve.observations import Observation, Rig
from fringed_plugins.calibration.solve.projection import SHARED, STEREO
from fringed_plugins.calibration.solve.shape import SHAPE, shaped

Float64Array = npt.NDArray[np.float64]

_LEAST_POINTS = 8
_SHAPES = 3
PITCH_NOTE = (
    "a pitch that is wrong everywhere shows in no residual: it scales every length alike; measure the print, and "
    "verify with an artefact of known size"
)


@dataclass(frozen=True)
class Demands:
    """`min_views` that have to fit, and the largest residuals (px RMS) of both sides."""

    min_views: int = 5
    max_camera_rms_px: float = 0.5
    max_projector_rms_px: float = 0.7
    settings: Settings = field(default_factory=Settings)


@dataclass(frozen=True)
class Calibrated:
    """The adjusted rig of the views `used`, why others were `left_out` (by their place), notes, and figures."""

    adjusted: Adjusted
    used: tuple[int, ...]
    left_out: Mapping[int, str]
    notes: tuple[str, ...]
    figures: Mapping[str, float]


def calibrate_rig(
    seen: Sequence[Observation], camera_size: Size, projector_size: Size, demands: Demands | None = None,
    *, tick: Tick | None = None,
) -> Calibrated:  # fmt: skip
    """Return the calibrated rig.

    Raises
    ------
    ValueError
        views that cannot give a calibration that is right, with what is wrong and what to do.
    """
    wanted = demands or Demands()
    given, seen = seen, [without_wrong_orders(one) for one in seen]
    left_out = {v: _few(o) for v, o in enumerate(seen) if o.lit.sum() < _LEAST_POINTS}
    hands = findings.handedness(seen)
    _refuse(hands)
    left_out |= {v: one.text for one in hands for v, o in enumerate(seen) if o.name == one.view and v not in left_out}
    used = _enough(seen, left_out, wanted)
    chosen = [seen[v] for v in used]
    rig, alone = initial_rig(chosen, camera_size, projector_size)
    tilted = findings.tilts(rig.poses)
    _refuse(tilted)
    _refuse(consistency.moved_between(chosen, alone))
    used, adjusted = _consistent(seen, (camera_size, projector_size), (wanted, tick), (rig, used, left_out))
    chosen = [seen[v] for v in used]
    left_out |= {v: consistency.why(seen[v], adjusted.rig) for v, text in left_out.items() if not text}
    adjusted, told, notes = _explained(chosen, adjusted, (camera_size, projector_size), (wanted, tick))
    unequal = causes.between_views(told)
    adjusted = replace(adjusted, covariance=adjusted.covariance * unequal)
    notes += [*causes.findings_of(chosen, adjusted, told), *findings.lenses(adjusted.rig, adjusted.covariance)]
    _refuse(notes)
    figures = figures_of(chosen, adjusted, camera_size)
    figures["between_views_factor"] = float(np.sqrt(unequal))
    figures["points_dropped"] += sum(int(given[v].lit.sum() - seen[v].lit.sum()) for v in used)
    _refuse(_residuals(figures, wanted))
    notes += [*findings.tilts(adjusted.rig.poses), *findings.coverage(chosen, camera_size)[1]]
    notes += findings.duplicates(chosen, adjusted.rig.poses)
    texts = [f"{one.view}: {one.text}" if one.view else one.text for one in notes]
    texts += [f"{seen[v].name} was left out: {text}" for v, text in sorted(left_out.items())]
    return Calibrated(adjusted, tuple(used), left_out, (*texts, PITCH_NOTE), figures)


def _consistent(
    seen: Sequence[Observation], sizes: tuple[Size, Size], how: tuple[Demands, Tick | None],
    begun: tuple[Rig, list[int], dict[int, str]],
) -> tuple[list[int], Adjusted]:  # fmt: skip
    """Estimate, and leave out what does not fit, until everything does; `left_out` gets the places, without reasons."""
    wanted, tick = how
    rig, used, left_out = begun
    start: Rig | None = rig
    while True:
        chosen = [seen[v] for v in used]
        adjusted = estimate(chosen, *sizes, wanted.settings, start=start, tick=tick)
        wrong = consistency.deviating(chosen, adjusted)
        if not wrong:
            return used, adjusted
        names = ", ".join(chosen[k].name for k in wrong)
        if len(used) - len(wrong) < wanted.min_views:
            reason = consistency.why(chosen[wrong[0]], adjusted.rig)
            raise ValueError(
                f"{names} of {len(used)} views contradict the others, and the {len(used) - len(wrong)} that are left "
                f"are too few (at least {wanted.min_views}); {chosen[wrong[0]].name}: {reason}"
            )
        left_out |= {used[k]: "" for k in wrong}
        used = [v for k, v in enumerate(used) if k not in wrong]
        start = None


def _explained(
    seen: Sequence[Observation], adjusted: Adjusted, sizes: tuple[Size, Size], how: tuple[Demands, Tick | None]
) -> tuple[Adjusted, list[causes.Cause], list[Finding]]:
    """Allow for a print that is stretched or bent, where residuals say so; return the causes of what is left, too.

    The covariance is then that of an estimation which has the print's numbers among its own.
    """
    values, deviations = np.zeros(SHAPE), np.full(SHAPE, np.inf)
    told = causes.causes(seen, adjusted)
    for _ in range(_SHAPES):
        best = told[0]
        if best.kind not in ("stretch", "shape") or best.covariance is None:
            break
        count = len(best.values)
        values[:count] += best.values
        deviations[:count] = best.deviations
        found = causes.shape_of(seen, values, deviations)
        if any(one.fatal for one in found):
            return adjusted, told, found
        board = shaped(seen, values)
        adjusted = estimate(board, *sizes, how[0].settings, start=adjusted.rig, tick=how[1])
        told = causes.causes(board, adjusted)
    if not np.isfinite(deviations).any():
        return adjusted, told, []
    whole = next(cause for cause in told if cause.kind == ("shape" if np.isfinite(deviations[-1]) else "stretch"))
    if whole.covariance is not None:
        adjusted = replace(adjusted, covariance=whole.covariance + _half_stretch(adjusted.rig, float(values[0])))
        deviations[: len(whole.values)] = whole.deviations
    return adjusted, told, causes.shape_of(seen, values, deviations)


def _half_stretch(rig: Rig, stretch: float) -> Float64Array:
    """Return what is unknown of lengths where a print is stretched: which of its directions is the right one."""
    along = np.zeros(SHARED)
    along[STEREO.start + 3 : STEREO.stop] = rig.T_projector_camera[:3, 3] * stretch / 2
    return np.outer(along, along)


def without_wrong_orders(observed: Observation) -> Observation:
    """Return a view without the projector's pixels that are off the smooth grid of the others."""
    columns, rows = observed.projector_px.T
    wrong = wrong_orders(observed.board_mm[:, :2], columns, rows)
    if not wrong.any():
        return observed
    return replace(observed, projector_px=np.where(wrong[:, None], np.nan, observed.projector_px))


def _few(observed: Observation) -> str:
    return f"{int(observed.lit.sum())} of its points are known in the projector's picture, {_LEAST_POINTS} are needed"


def _enough(seen: Sequence[Observation], left_out: Mapping[int, str], wanted: Demands) -> list[int]:
    used = [v for v in range(len(seen)) if v not in left_out]
    if len(used) < wanted.min_views:
        why = "; ".join(f"{seen[v].name}: {text}" for v, text in sorted(left_out.items()))
        more = f" ({why})" if why else ""
        raise ValueError(
            f"{len(used)} views can be used{more}; at least {wanted.min_views} are needed, 12 are good: take more poses"
        )
    return used


def _refuse(found: list[Finding]) -> None:
    fatal = [one.text for one in found if one.fatal]
    if fatal:
        raise ValueError("; ".join(fatal))


def _residuals(figures: Mapping[str, float], wanted: Demands) -> list[Finding]:
    found = []
    for name, most in (("camera", wanted.max_camera_rms_px), ("projector", wanted.max_projector_rms_px)):
        rms = figures[f"{name}_rms_px"]
        if rms > most:
            text = f"the {name}'s residuals are {rms:.2f} px RMS, at most {most:g} are accepted"
            found.append(Finding("", f"{text}: is the board flat, and is it the one that is configured?", True))
    return found


def figures_of(seen: Sequence[Observation], found: Adjusted, camera_size: Size) -> dict[str, float]:
    """Return the figures of a calibration: residuals, points, spreads."""
    camera = np.concatenate([p.camera[u] for p, u in zip(found.residuals, found.weights.camera_used, strict=True)])
    lit = np.concatenate([p.projector[u] for p, u in zip(found.residuals, found.weights.projector_used, strict=True)])
    every = sum(len(o.board_mm) + int(o.lit.sum()) for o in seen)
    depths = found.rig.poses[:, 2, 3]
    return {
        "camera_rms_px": float(np.sqrt((camera**2).sum(axis=1).mean())),
        "projector_rms_px": float(np.sqrt((lit**2).sum(axis=1).mean())),
        "views": float(len(seen)),
        "points": float(len(camera)),
        "points_dropped": float(every - len(camera) - len(lit)),
        "camera_factor": found.weights.camera_factor,
        "projector_factor": found.weights.projector_factor,
        "tilt_spread_deg": findings.tilt_spread_deg(found.rig.poses),
        "coverage": findings.coverage(seen, camera_size)[0],
        "near_mm": float(depths.min()),
        "far_mm": float(depths.max()),
    }
