"""A calibration session on a station: poses taken, boards found, a calibration made of them.

Owns the names of stages and what goes into them; a person, a simulated rig or a folder of images says where the board
is. Every pose is a recorded board view, so that a session that ended early can go on.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from fringed.boards import Board, board_of
from fringed.data import BoardView, Calibration, FrameSet
from fringed.errors import FringedError, NotFound, UsageError
from fringed.messages import ScanState

if TYPE_CHECKING:
    from fringed_client.station import Station

OnProgress = Callable[[ScanState], None]
PIPELINE, DETECTOR, SOLVER = "board", "detect-board", "calibrate"
POSES_MIN = 5
_FEW = 4  # views, before the next pose is worked out
_LOOKED_AT = 200  # recordings that `earlier` goes through


@dataclass(frozen=True)
class Wish:
    """What a session was asked for: `board` over the station's own, `camera` settings, `solver` parameters."""

    board: Mapping[str, Any] = field(default_factory=dict)
    pipeline: str = PIPELINE
    camera: Mapping[str, Any] = field(default_factory=dict)
    solver: Mapping[str, Any] = field(default_factory=dict)
    timeout_s: float = 300.0


class Session:
    """Take poses on one station, and make a calibration of them.

    Raises
    ------
    ConfigurationError
        no such board.
    NotFound, UsageError
        the station has no such pipeline, or it looks for no board.
    """

    def __init__(self, station: Station, wish: Wish) -> None:
        self.station, self.wish = station, wish
        self.config = station.config()
        self._stage, configured = _detector(self.config["pipelines"], wish.pipeline)
        self.board: Board = board_of({**self.config.get("board", {}), **configured, **wish.board})

    def begin(self, name: str) -> str:
        """Begin to take a pose and return its scan's id at once; raises LeaseError where somebody else has the rig."""
        state: ScanState = self.station.request(
            "scan", timeout_s=60.0, pipeline=self.wish.pipeline, camera=dict(self.wish.camera) or None,
            stages={self._stage: self._look_for(name)},
        )  # fmt: skip
        return state.id

    def until_taken(self, scan: str, on_progress: OnProgress) -> None:
        """Wait until the rig has taken the frames: what stands before it may change while they are processed."""
        self._guarded(scan, on_progress, "processing")

    def finish(self, scan: str, on_progress: OnProgress) -> BoardView:
        """Wait for the view of a pose that was begun; an interruption cancels it on the station."""
        view: BoardView = self._guarded(scan, on_progress).last("BoardView")
        return view

    def take(self, name: str, on_progress: OnProgress) -> BoardView:
        """Take one pose and return what was seen of the board."""
        return self.finish(self.begin(name), on_progress)

    def view_of(self, name: str, frames: FrameSet, on_progress: OnProgress) -> BoardView:
        """Return what a set of images, with fringes along both directions, shows of the board."""
        family = frames.sequence.family
        given = {"frames": "board"}
        stages: list[dict[str, Any]] = [
            {"name": one, "plugin": family, "inputs": given, "keep": False, "params": {"orientation": one}}
            for one in ("columns", "rows")
        ]
        detector = {"name": "view", "plugin": DETECTOR, "inputs": {"columns": "columns", "rows": "rows"}}
        stages.append(detector | {"params": self._look_for(name, whole=True)})
        result = self.station.process(
            {"board": frames}, stages=stages, on_progress=on_progress, timeout_s=self.wish.timeout_s
        )
        view: BoardView = result.last("BoardView")
        return view

    def solve(self, views: Sequence[BoardView], on_progress: OnProgress) -> tuple[Calibration, tuple[str, ...]]:
        """Return the calibration of recorded views, and what the solver doubts.

        Raises
        ------
        DataError
            the views do not determine one, with what is wrong and with which view.
        """
        stage = {"name": "calibration", "plugin": SOLVER, "params": {**self._nominal(views), **self.wish.solver}}
        return self._calibration({"views": [view.id for view in views]}, stage, on_progress)

    def suggestion(self, views: Sequence[BoardView]) -> str:
        """Return where the board tells most next, once a few views are there; empty where that cannot be told."""
        if len(views) < _FEW:
            return ""
        stages = [{"name": "next", "plugin": "suggest-pose"}]
        try:
            made = self.station.process({"views": [view.id for view in views]}, stages=stages).last("Artifact")
        except FringedError:  # views that do not fit together are told by the solver, at the end
            return ""
        return str(json.loads(made.content.tobytes())["text"])

    def lacks_tone(self) -> bool:
        """Tell whether the calibration in force has no measured tone curve that a new one could take over."""
        in_force = self.station.status().calibration
        return not in_force or "tone_levels" not in self.station.get(in_force).residuals

    def ramp(self, on_progress: OnProgress) -> str:
        """Project grey levels on what stands before the rig, and return the id of their frames."""
        camera = dict(self.wish.camera) or None
        result = self.station.scan("tone", camera=camera, process=False, on_progress=on_progress)
        return result.state.frame_sets["object"]

    def with_tone(
        self, calibration: Calibration, ramp: str, on_progress: OnProgress
    ) -> tuple[Calibration, tuple[str, ...]]:
        """Return a calibration with the projector's tone curve that a ramp's frames show."""
        stage = {"name": "response", "plugin": "tone-response"}
        return self._calibration({"frames": ramp, "calibration": calibration.id}, stage, on_progress)

    def corrected(
        self, views: Sequence[BoardView], calibration: Calibration, on_progress: OnProgress
    ) -> tuple[Calibration, tuple[str, ...]]:
        """Return a calibration with the projector where a few poses say that it stands now; raises DataError."""
        inputs = {"views": [view.id for view in views], "calibration": calibration}
        return self._calibration(inputs, {"name": "corrected", "plugin": "infield-correction"}, on_progress)

    def _calibration(
        self, inputs: Mapping[str, Any], stage: Mapping[str, Any], on_progress: OnProgress
    ) -> tuple[Calibration, tuple[str, ...]]:
        result = self.station.process(inputs, stages=[stage], on_progress=on_progress, timeout_s=self.wish.timeout_s)
        found: Calibration = result.last("Calibration")
        return found, result.state.warnings

    def earlier(self) -> list[BoardView]:
        """Return the found views of the last session on this station, the oldest first."""
        kept: list[BoardView] = []
        names: set[str] = set()
        for row in self.station.list(kind="BoardView", limit=_LOOKED_AT):
            view = self._got(row["id"])
            if view is None or board_of(view.board) != self.board:
                continue
            if view.name in names:  # taken again in that session, or of the one before
                continue
            names.add(view.name)
            if view.found:
                kept.append(view)
            if view.name == "pose-01":  # with it a session begins
                break
        return kept[::-1]

    def named(self, ids: Sequence[str]) -> list[BoardView]:
        """Return recorded views by their ids; raises UsageError for what is none."""
        found = [self.station.get(item) for item in ids]
        wrong = [item for item, view in zip(ids, found, strict=True) if not isinstance(view, BoardView)]
        if wrong:
            raise UsageError(
                f"{', '.join(wrong)} is no board view; `fringe list --kind BoardView` shows those recorded"
            )
        return found

    def _got(self, item: str) -> BoardView | None:
        try:
            found = self.station.get(item)
        except FringedError:  # a damaged or removed recording does not keep the others from being used
            return None
        return found if isinstance(found, BoardView) else None

    def _nominal(self, views: Sequence[BoardView]) -> dict[str, Any]:
        """Return where a simulated rig of this station has its reference plane, as a person tells of a real one."""
        rig = self.station.status().rig
        if not self.station.hello.get("simulated") or any(view.provenance.rig != rig for view in views):
            return {}
        return {"reference_plane_mm": self.config["simulation"]["scene"]["backdrop_distance_mm"]}

    def _look_for(self, name: str, whole: bool = False) -> dict[str, Any]:
        import msgspec

        board = msgspec.to_builtins(self.board) if whole else dict(self.wish.board)
        return {"name": name, **({"board": board} if board else {})}

    def _guarded(self, scan: str, on_progress: OnProgress, until: str = "") -> Any:
        try:
            return self.station.wait(scan, on_progress, self.wish.timeout_s, until)
        except KeyboardInterrupt:
            with contextlib.suppress(FringedError):  # what cannot be stopped does not keep the user from leaving
                self.station.cancel(scan)
            raise


def _detector(pipelines: Mapping[str, Any], name: str) -> tuple[str, Mapping[str, Any]]:
    """Return the name of the stage that looks for the board, and the board that the pipeline itself names."""
    if name not in pipelines:
        raise NotFound(f"no pipeline is called {name!r}; there are {', '.join(sorted(pipelines))}")
    for stage in pipelines[name]["stages"]:
        if stage["processor"] == DETECTOR:
            return stage["name"] or DETECTOR, stage["params"].get("board", {})
    raise UsageError(f"the pipeline {name!r} has no stage {DETECTOR!r}, so it sees no board; use {PIPELINE!r}")
