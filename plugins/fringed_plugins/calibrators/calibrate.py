"""Views of a board to a calibration of camera and projector.

Owns which views are looked at, and what a calibration remembers of them; the estimation is `calibration.solve`'s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__, boards, hookspecs
from fringed.data import BoardView, Calibration, Float64Array, Lens, Provenance, ViewFit
from fringed.errors import DataError
from fringed.hookspecs import Context

if TYPE_CHECKING:
    from fringed_plugins.calibration.solve.calibrate import Calibrated
    from fringed_plugins.calibration.solve.observations import Observation, Rig

_MM, _PX = {"units": "mm"}, {"units": "px"}
_NOT_USED = ("blurred", "saturated")
_DEPTHS = 3


class Calibrate:
    """Views of a board, five and more, to lenses, the projector's place, and how well all of it is known.

    Camera, projector (an inverse camera), their places and every pose are adjusted at once; the images of circles are
    taken for what they are, ellipses off the images of the circles' centres. Points and views that do not fit are left
    out and named, each with the reason; views that cannot give a right calibration are refused. Tone curve, crosstalk
    and phase errors of a `calibration` of the same rig are kept.

    References
    ----------
    Zhang 2000; Zhang & Huang 2006; Heikkila 2000; Triggs et al. 2000; thesis.md, sections 1 and 3.
    """

    name: ClassVar[str] = "calibrate"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "views of a board to a calibration of camera and projector"
    inputs: ClassVar[Mapping[str, Any]] = {"views": (BoardView,), "calibration": Calibration}
    optional: ClassVar[frozenset[str]] = frozenset({"calibration"})
    output: ClassVar[type] = Calibration

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        min_views: Annotated[int, Meta(ge=3, le=1000, description="that have to fit")] = 5
        max_camera_rms_px: Annotated[
            float, Meta(gt=0, le=100, description="largest residual of the camera, RMS", extra_json_schema=_PX)
        ] = 0.5
        max_projector_rms_px: Annotated[
            float, Meta(gt=0, le=100, description="largest residual of the projector, RMS", extra_json_schema=_PX)
        ] = 0.7
        k3: Annotated[
            bool | None, Meta(description="estimate the third radial coefficient; unset: where the data show it")
        ] = None
        use_poor_views: Annotated[bool, Meta(description="views that are blurred or saturated as well")] = False
        reference_plane_mm: Annotated[
            float,
            Meta(ge=0, le=1e5, description="depth of a plane that faces the camera; 0: none", extra_json_schema=_MM),
        ] = 0.0
        temperature_c: Annotated[
            Annotated[float, Meta(ge=-60, le=100)] | None,
            Meta(description="of the room", extra_json_schema={"units": "degrees C"}),
        ] = None

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Calibration:
        """Return the calibration.

        Raises
        ------
        DataError
            views that cannot give a calibration that is right; the message says why, and what to do.
        """
        from fringed_plugins.calibration.solve.calibrate import Demands, calibrate_rig
        from fringed_plugins.calibration.solve.estimate import Settings

        views = _given(inputs)
        chosen, left_out = _chosen(views, params.use_poor_views, params.min_views)
        demands = Demands(
            params.min_views, params.max_camera_rms_px, params.max_projector_rms_px, Settings(k3=params.k3)
        )
        first = views[chosen[0]]

        def tick(done: float) -> None:
            context.progress(0.05 + 0.85 * done, f"adjusting {len(chosen)} views")

        try:
            found = calibrate_rig(
                [observed(views[v], v) for v in chosen],
                first.camera_size_px,
                first.projector_size_px,
                demands,
                tick=tick,
            )
        except ValueError as error:
            raise DataError(f"no calibration: {_with_left_out(str(error), left_out)}") from error
        for text in found.notes[:-1]:
            context.log("warning", text)
        return _calibration(views, (chosen, left_out), found, params, inputs.get("calibration"))


def name_of(view: BoardView, number: int) -> str:
    """Return how a view is called: by its name, or its number from 1."""
    return view.name or f"view {number + 1}"


def _given(inputs: Mapping[str, Any]) -> Sequence[BoardView]:
    views = inputs.get("views")
    if not isinstance(views, (list, tuple)) or not views or not all(isinstance(v, BoardView) for v in views):
        raise DataError(f"calibrate takes board views named 'views'; it was given {type(views).__name__}")
    return views


def _chosen(views: Sequence[BoardView], poor: bool, least: int) -> tuple[list[int], dict[int, str]]:
    """Return the views that can be used, and why the others cannot."""
    left_out: dict[int, str] = {}
    sizes = [
        (v.camera_size_px, v.projector_size_px, tuple(sorted(map(str, v.board.items())))) for v in views if v.found
    ]
    usual = max(sizes, key=sizes.count) if sizes else None
    for number, view in enumerate(views):
        bad = [text for text in view.problems if text.startswith(_NOT_USED)]
        if not view.found:
            left_out[number] = view.reason or "no board was found"
        elif usual is not None and (text := _differs(view, usual)):
            left_out[number] = text
        elif bad and not poor:
            left_out[number] = "; ".join(bad)
    chosen = [number for number in range(len(views)) if number not in left_out]
    if len(chosen) < least:
        raise DataError(
            _with_left_out(
                f"no calibration: {len(chosen)} of {len(views)} views can be used, at least {least} are needed",
                {name_of(views[k], k): text for k, text in left_out.items()},
            )
        )
    return chosen, left_out


def _differs(view: BoardView, usual: tuple[Any, Any, Any]) -> str:
    if view.camera_size_px != usual[0]:
        return f"its picture is {_size(view.camera_size_px)} px, that of the others {_size(usual[0])}"
    if view.projector_size_px != usual[1]:
        return f"its projector is {_size(view.projector_size_px)} px, that of the others {_size(usual[1])}"
    if tuple(sorted(map(str, view.board.items()))) != usual[2]:
        return "it was looked at for another board than the others"
    return ""


def _size(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"


def _with_left_out(text: str, left_out: Mapping[Any, str]) -> str:
    more = "; ".join(f"{key if isinstance(key, str) else f'view {key + 1}'}: {why}" for key, why in left_out.items())
    return f"{text} (left out: {more})" if more else text


def observed(view: BoardView, number: int) -> Observation:
    """Return a view as estimation wants it."""
    from fringed_plugins.calibration.solve.observations import Observation

    board = boards.board_of(view.board)
    return Observation(
        name_of(view, number), boards.points_mm(board)[view.index], view.camera_px, view.projector_px,
        np.maximum(view.camera_sigma_px, 1e-3), np.maximum(view.projector_sigma_px, 1e-3), view.projector_jacobian,
        boards.diameters_mm(board)[view.index] / 2 if len(view.ellipses) else np.zeros(len(view.index)), view.light,
    )  # fmt: skip


def _calibration(
    views: Sequence[BoardView], which: tuple[list[int], dict[int, str]], found: Calibrated, params: Calibrate.Params,
    old: Any,
) -> Calibration:  # fmt: skip
    from fringed_plugins.calibration.pixel.derivatives import NUMBERS
    from fringed_plugins.calibration.solve.falloff import falloffs

    chosen, left_out = which
    rig = found.adjusted.rig
    dark = falloffs([observed(views[chosen[k]], chosen[k]) for k in found.used], rig)
    named = {name_of(views[k], k): text for k, text in left_out.items()}
    notes = (*(f"{name} was left out: {text}" for name, text in named.items()), *found.notes)
    first = views[chosen[0]]
    plane = np.array([0.0, 0.0, -1.0, -params.reference_plane_mm]) if params.reference_plane_mm > 0 else None
    calibration = Calibration(
        camera=_lens(rig.camera),
        projector=_lens(rig.projector),
        T_projector_camera=rig.T_projector_camera,
        rig=first.provenance.rig,
        source="calibrated",
        reference_plane=plane,
        residuals={**found.figures, **_trueness(found)},
        covariance=found.adjusted.covariance,
        parameters=NUMBERS,
        views=_fits(views, which, found),
        camera_falloff=dark[0] if dark else None,
        projector_falloff=dark[1] if dark else None,
        temperature_c=params.temperature_c,
        notes=notes,
        provenance=replace(
            Provenance(), rig=first.provenance.rig, simulated=any(v.provenance.simulated for v in views)
        ),
    )
    return _with_light(calibration, old)


def _lens(lens: Any) -> Lens:
    return Lens(lens.width_px, lens.height_px, lens.matrix, lens.distortion)


def _with_light(new: Calibration, old: Any) -> Calibration:
    """Keep what an older calibration of the same devices knows of light: it does not depend on geometry.

    The simulator's own lends nothing: what is made of images must not know the truth.
    """
    if not isinstance(old, Calibration) or old.source == "exact-simulated":
        return new
    sizes = [(c.projector.width_px, c.projector.height_px) for c in (new, old)]
    if sizes[0] != sizes[1] or (old.rig and new.rig and old.rig != new.rig):
        return new
    tone = {key: value for key, value in old.residuals.items() if key.startswith("tone_")}
    plane = new.reference_plane if new.reference_plane is not None else old.reference_plane
    return replace(
        new, tone_curve=old.tone_curve, crosstalk=old.crosstalk, phase_errors=old.phase_errors, reference_plane=plane,
        residuals={**new.residuals, **tone},
    )  # fmt: skip


def _fits(
    views: Sequence[BoardView], which: tuple[list[int], dict[int, str]], found: Calibrated
) -> tuple[ViewFit, ...]:
    chosen, left_out = which
    fits: dict[int, ViewFit] = {}
    for k, place in enumerate(found.used):
        number, part = chosen[place], found.adjusted.residuals[k]
        view = views[number]
        used = found.adjusted.weights.camera_used[k]
        fits[number] = ViewFit(
            view.id, found.adjusted.rig.poses[k], view.camera_px, part.camera, view.projector_px, part.projector,
            used.astype(np.uint8), name_of(view, number),
        )  # fmt: skip
    reasons = {**left_out, **{chosen[place]: text for place, text in found.left_out.items()}}
    for number, text in reasons.items():
        view, nothing = views[number], np.full((len(views[number].index), 2), np.nan)
        fits[number] = ViewFit(
            view.id, np.eye(4), view.camera_px, nothing, view.projector_px, nothing,
            np.zeros(len(view.index), np.uint8), name_of(view, number), text,
        )  # fmt: skip
    return tuple(fits[number] for number in sorted(fits))


def _trueness(found: Calibrated) -> dict[str, float]:
    """Return the deviation of points that the covariance leaves, RMS and largest, over the depths of the poses."""
    from fringed_plugins.calibration.pixel.derivatives import NUMBERS
    from fringed_plugins.calibration.pixel.uncertainty import trueness_mm

    rig: Rig = found.adjusted.rig
    depths: Float64Array = np.linspace(found.figures["near_mm"], found.figures["far_mm"], _DEPTHS)
    sigma = trueness_mm(
        rig.camera, rig.projector, rig.T_projector_camera, found.adjusted.covariance, NUMBERS, depths_mm=depths
    )
    whole = np.sqrt((sigma**2).sum(axis=-1))
    if not np.isfinite(whole).any():
        return {}
    return {"trueness_rms_mm": float(np.sqrt(np.nanmean(whole**2))), "trueness_max_mm": float(np.nanmax(whole))}
