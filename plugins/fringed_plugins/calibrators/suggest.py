"""Views of a board so far to where it should be held next.

Owns what is said before enough is known to work it out; the working out is `calibration.solve.suggest`'s.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__, boards, hookspecs
from fringed.data import Artifact, BoardView
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.calibrators.calibrate import observed

LEAST = 4
_FIRST = (
    "in the middle of the picture, tilted by 25 degrees to face right",
    "at the upper left of the picture, nearer, tilted by 30 degrees to face down",
    "at the lower right of the picture, nearer, tilted by 25 degrees to face left",
    "at the upper right of the picture, farther, turned by 90 degrees, tilted by 30 degrees to face up",
)


class SuggestPose:
    """Views of a board so far to the pose that would tell most, and what points would then be known to.

    From four views on a rig can be estimated, and its covariance says what is not yet known; before, four poses that
    differ as much as can be are named in their order.

    References
    ----------
    Fedorov 1972; Rojtberg & Kuijper 2018.
    """

    name: ClassVar[str] = "suggest-pose"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "views of a board to where it should be held next"
    inputs: ClassVar[Mapping[str, Any]] = {"views": (BoardView,)}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Artifact

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        enough_mm: Annotated[
            float,
            Meta(gt=0, le=100, description="RMS of points that needs no more poses", extra_json_schema={"units": "mm"}),
        ] = 0.01

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Artifact:
        """Return JSON: `text`, `T_camera_board` (4 x 4, null before four views), `before_mm`, `after_mm`, `enough`.

        Raises
        ------
        DataError
            no views, views of several boards or sizes, or none that fit together.
        """
        from fringed_plugins.calibration.solve.estimate import estimate
        from fringed_plugins.calibration.solve.suggest import next_pose

        views = _found(inputs.get("views"))
        if len(views) < LEAST:
            text = f"hold the board {_FIRST[len(views)]}"
            return _document(text=text, T_camera_board=None, before_mm=None, after_mm=None, enough=False)
        first = views[0]
        board = boards.board_of(first.board)
        seen = [observed(view, number) for number, view in enumerate(views)]
        try:
            found = estimate(
                seen, first.camera_size_px, first.projector_size_px, tick=lambda done: context.progress(0.8 * done)
            )
            best = next_pose(seen, found, boards.points_mm(board))
        except ValueError as error:
            raise DataError(f"no pose can be suggested from {len(views)} views: {error}") from error
        enough = best.before_mm <= params.enough_mm
        text = f"points are known to {best.before_mm:.3f} mm RMS, with one pose more to {best.after_mm:.3f}"
        text = f"{text}: enough" if enough else f"hold the board {best.words} ({text})"
        return _document(
            text=text, T_camera_board=best.T_camera_board.tolist(), before_mm=best.before_mm, after_mm=best.after_mm,
            enough=enough,
        )  # fmt: skip


def _found(views: Any) -> Sequence[BoardView]:
    if not isinstance(views, (list, tuple)) or not all(isinstance(view, BoardView) for view in views):
        raise DataError(f"suggest-pose takes board views named 'views'; it was given {type(views).__name__}")
    found = [view for view in views if view.found]
    kinds = {(view.camera_size_px, view.projector_size_px, str(sorted(view.board.items()))) for view in found}
    if len(kinds) > 1:
        raise DataError("the views are of several boards or picture sizes; give those of one session")
    return found


def _document(**table: Any) -> Artifact:
    return Artifact("pose.json", "application/json", np.frombuffer(json.dumps(table).encode(), np.uint8))
