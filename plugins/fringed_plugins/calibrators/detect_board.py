"""Phase maps of a board to its view: the points in both pictures, or why there are none.

Owns the translation between the contract's board and detection, and the small picture that a view keeps.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from fringed import __version__, boards, hookspecs
from fringed.data import Array, BoardView, Float64Array, PhaseMap, Reject
from fringed.errors import DataError
from fringed.hookspecs import Context

if TYPE_CHECKING:
    from fringed_plugins.calibration.detect.board_spec import BoardSpec, Detection

_PX = {"units": "px"}
_PICTURE_PX = 700
_WINDOW_PITCHES = 0.5  # radius of the window in which the projector's place is fitted: neighbours share no pixel


class DetectBoard:
    """Absolute phase of both directions to the view of a calibration board.

    The picture of the board is the phase maps' background, which has no fringes. A view in which no board is found is
    a result as well: it says why. With one phase map alone the camera's side is found, and the projector's is not.

    References
    ----------
    Zhang & Huang 2006 (the projector sees by its phase); Heikkila 2000 (circles); thesis.md, section 1.
    """

    name: ClassVar[str] = "detect-board"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "phase of both directions to the points of a calibration board"
    inputs: ClassVar[Mapping[str, Any]] = {"columns": PhaseMap, "rows": PhaseMap}
    optional: ClassVar[frozenset[str]] = frozenset({"rows"})
    output: ClassVar[type] = BoardView

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        board: Annotated[boards.Board, Meta(description="what is printed on it")] = boards.Board()
        name: Annotated[str, Meta(max_length=200, description="of the pose, for people")] = ""
        max_blur_px: Annotated[
            float, Meta(gt=0, le=100, description="widest edge, as a Gaussian's sigma", extra_json_schema=_PX)
        ] = 3.0
        min_diameter_px: Annotated[
            float, Meta(ge=3, le=1e4, description="of the small circles", extra_json_schema=_PX)
        ] = 8.0
        max_tilt_deg: Annotated[
            float, Meta(gt=0, lt=90, description="of the board", extra_json_schema={"units": "degrees"})
        ] = 65.0
        max_saturated: Annotated[float, Meta(ge=0, le=1, description="share of the board's pixels")] = 0.02
        min_points: Annotated[int, Meta(ge=6, le=10_000, description="that are found")] = 12

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> BoardView:
        """Return the view.

        Raises
        ------
        DataError
            phase maps that are not absolute, differ in size, or count the same direction.
        """
        from fringed_plugins.calibration.detect.board_spec import Limits
        from fringed_plugins.calibration.detect.detect import detect_board

        columns, rows = _maps(inputs)
        both = [columns] if rows is None else [columns, rows]
        picture: Array = np.asarray(sum(one.background for one in both) / np.float32(len(both)))
        saturated: Array = np.asarray(sum(one.rejected & int(Reject.SATURATED) for one in both)) > 0
        limits = Limits(
            min_diameter_px=params.min_diameter_px, max_blur_px=params.max_blur_px, max_tilt_deg=params.max_tilt_deg,
            max_saturated=params.max_saturated, min_points=params.min_points,
        )  # fmt: skip
        context.progress(0.1, "looking for the board")
        found = detect_board(picture, _spec(params.board), saturated=saturated, limits=limits, threads=context.threads)
        context.progress(0.6, "projector")
        return _view(found, params, (columns, rows), picture, context.threads)

    @classmethod
    def compile_kernels(cls) -> None:
        """Compile or load the kernels; half a minute at first.

        Not a `warm_up`: every station would compile them when it starts, and its first scan would wait for that.
        """
        from fringed_plugins.calibration.detect.ellipses import find_ellipses
        from fringed_plugins.calibration.detect.projector_points import projector_at

        y, x = np.mgrid[:64, :64].astype(np.float32)
        find_ellipses(100 - 80 / (1 + np.exp(np.hypot(x - 31, y - 33) - 14)).astype(np.float32), True, 1)
        ones = np.ones((64, 64), np.float32)
        projector_at(np.array([[32.0, 32.0]]), np.array([20.0]), (x, ones, np.zeros((64, 64), np.uint16)), threads=1)


def _maps(inputs: Mapping[str, Any]) -> tuple[PhaseMap, PhaseMap | None]:
    columns, rows = inputs.get("columns"), inputs.get("rows")
    if not isinstance(columns, PhaseMap) or not (rows is None or isinstance(rows, PhaseMap)):
        raise DataError(
            f"detect-board takes the PhaseMaps 'columns' and 'rows'; it was given {type(columns).__name__} and "
            f"{type(rows).__name__}"
        )
    for name, phase in (("columns", columns), ("rows", rows)):
        if phase is None:
            continue
        if phase.kind != "absolute":
            raise DataError(
                f"detect-board needs absolute phases; {name!r} is {phase.kind}: project several frequencies"
            )
        if phase.orientation != name:
            raise DataError(
                f"the phase map given as {name!r} counts {phase.orientation}: columns and rows are swapped, or were "
                f"projected along one direction only"
            )
    if rows is not None and rows.phase_rad.shape != columns.phase_rad.shape:
        raise DataError(f"the phase maps have shapes {columns.phase_rad.shape} and {rows.phase_rad.shape}: two poses?")
    return columns, rows


def _spec(board: boards.Board) -> BoardSpec:
    from fringed_plugins.calibration.detect.board_spec import BoardSpec

    return BoardSpec(
        board.kind, board.columns, board.rows, board.pitch_mm, boards.points_mm(board), boards.diameters_mm(board),
        boards.is_big(board), board.polarity == "dark-on-light",
        boards.charuco(board) if board.kind == "charuco" else None,
    )  # fmt: skip


def _view(
    found: Detection, params: DetectBoard.Params, maps: tuple[PhaseMap, PhaseMap | None], picture: Array, threads: int
) -> BoardView:
    columns, rows = maps
    step = max(1, -(-picture.shape[1] // _PICTURE_PX))
    board = msgspec.to_builtins(params.board)
    size = (picture.shape[1], picture.shape[0])
    common: dict[str, Any] = {
        "board": board, "camera_size_px": size,
        "projector_size_px": (columns.projector_px, rows.projector_px if rows is not None else 0),
        "quality": found.quality, "problems": found.problems, "picture": _small(picture, step), "picture_step": step,
        "name": params.name,
    }  # fmt: skip
    if not found.found:
        return BoardView(found=False, reason=found.reason, **common)
    place, spread, slope = _projector(found, maps, params.board, threads)
    seen: Array = np.asarray(np.isfinite(place).all(axis=1))
    lost = int((~seen).sum()) if rows is not None else 0
    if lost:
        common["problems"] = (*found.problems, f"the projector's place is unknown at {lost} of {len(seen)} points")
    return BoardView(
        found=True, index=found.index, camera_px=found.px, camera_sigma_px=found.sigma_px, ellipses=found.ellipses,
        projector_px=place, projector_sigma_px=spread, projector_jacobian=slope, light=_light(found, columns), **common,
    )  # fmt: skip


def _projector(
    found: Detection, maps: tuple[PhaseMap, PhaseMap | None], board: boards.Board, threads: int
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the projector's pixels (n, 2), their deviations (n, 2) and derivatives (n, 2, 2); NaN where unknown."""
    from fringed_plugins.calibration.detect.projector_points import projector_at, wrong_orders

    count = len(found.index)
    place, spread = np.full((count, 2), np.nan), np.full((count, 2), np.nan)
    slope = np.full((count, 2, 2), np.nan)
    radius = np.full(count, _WINDOW_PITCHES * _pitch_px(found, board))
    for axis, phase in enumerate(maps):
        if phase is None:
            return place, spread, slope
        scale = np.float32(phase.period_px / (2 * np.pi))
        value = (phase.phase_rad - np.float32(phase.initial_phase_rad)) * scale
        noise = phase.sigma_rad if phase.sigma_rad is not None else np.ones_like(phase.phase_rad)
        values = projector_at(found.px, radius, (value, noise * scale, phase.rejected), threads=threads)
        place[:, axis], spread[:, axis], slope[:, axis] = values.value, values.sigma, values.gradient
    points = boards.points_mm(board)[found.index, :2]
    wrong = wrong_orders(points, place[:, 0], place[:, 1]) | ~np.isfinite(place).all(axis=1)
    place[wrong], spread[wrong], slope[wrong] = np.nan, np.nan, np.nan
    return place, spread, slope


def _pitch_px(found: Detection, board: boards.Board) -> float:
    """Return how long a pitch is in the picture: the middle distance of neighbours."""
    from scipy.spatial import cKDTree

    if len(found.px) < 2:
        return 10.0
    near, _ = cKDTree(found.px).query(found.px, k=2)
    step = np.sqrt(0.5) if board.kind == "asymmetric-circles" else 1.0
    return float(np.median(near[:, 1]) / step)


def _light(found: Detection, columns: PhaseMap) -> Float64Array:
    """Return the grey level of the ground beside each circle, 0 where unknown: blur does not change it."""
    if not len(found.ellipses):
        return np.zeros(len(found.index))
    height, width = columns.background.shape
    light = np.zeros(len(found.index))
    for k, (x, y, long, short, angle) in enumerate(found.ellipses):
        turn = np.arange(24) * (2 * np.pi / 24)
        along, across = 1.45 * long * np.cos(turn), 1.45 * short * np.sin(turn)
        c = np.rint(x + along * np.cos(angle) - across * np.sin(angle)).astype(int)
        r = np.rint(y + along * np.sin(angle) + across * np.cos(angle)).astype(int)
        inside = (c >= 0) & (c < width) & (r >= 0) & (r < height)
        kept = columns.rejected[r[inside], c[inside]] == 0
        if kept.sum() >= 12:
            light[k] = float(np.mean(columns.background[r[inside], c[inside]][kept]))
    return light


def _small(picture: Array, step: int) -> Array:
    small = picture[::step, ::step]
    finite = small[np.isfinite(small)]
    top = float(np.percentile(finite, 99.5)) if finite.size else 0.0
    return np.clip(np.nan_to_num(small) * (255 / top if top > 0 else 0.0), 0, 255).astype(np.uint8)
