"""Ways to get the poses of a session: a simulated rig places the board itself, a person does, or a folder has them.

Owns when the board moves and what is told meanwhile; each way hands over board views, found or not, as they come.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

from fringed.data import BoardView
from fringed.errors import ConfigurationError, Problem, QualityError, UsageError
from fringed_client.calibration.poses import Pose, plan, scene_of
from fringed_client.calibration.session import Session

ATTEMPTS = 10


class Progress(Protocol):
    """Where progress is shown."""

    def show(self, name: str, fraction: float, text: str = "", phase: str = "") -> None:
        """Tell how far `name` is."""

    def scan(self, name: str) -> Any:
        """Return a callback for ScanStates."""


def simulated_poses(session: Session, poses: Sequence[Pose], progress: Progress) -> Iterator[BoardView]:
    """Place the board before a simulated rig in each pose, and take it; the former scene comes back at the end.

    While the station looks for the board of one pose, the next one is taken already.

    Raises
    ------
    UsageError
        the rig is not simulated.
    """
    if not session.station.hello.get("simulated"):
        raise UsageError("--simulated needs a simulated rig; this one is real: leave it out and hold the board")
    simulation = session.config["simulation"]
    sensor = simulation["sensor"]
    before: tuple[str, str] | None = None
    former: dict[str, Any] | None = None
    try:
        for pose in poses:
            scene = scene_of(pose, session.board, simulation["geometry"], sensor["height_px"] / sensor["width_px"])
            placed = session.station.request("simulate.scene", timeout_s=120.0, scene=scene)
            former = former or placed["before"]
            scan = session.begin(pose.name)
            session.until_taken(scan, progress.scan(pose.name))
            if before is not None:
                yield session.finish(before[1], progress.scan(before[0]))
            before = pose.name, scan
        if before is not None:
            yield session.finish(before[1], progress.scan(before[0]))
    finally:
        if former is not None:
            session.station.set_scene(former)


def simulated_ramp(session: Session, progress: Progress) -> str:
    """Project grey levels on a plane before a simulated rig, and return the id of their frames."""
    placed = session.station.request("simulate.scene", timeout_s=120.0, scene={"object": "plane"})
    try:
        return session.ramp(progress.scan("tone"))
    finally:
        session.station.set_scene(placed["before"])


def held_poses(
    session: Session, poses: Sequence[Pose], ready: Callable[[Pose], bool], progress: Progress
) -> Iterator[BoardView]:
    """Take each pose once `ready` says that the board is there; a pose whose board is not found is taken again.

    `ready` returns False to end the session before all poses are taken.

    Raises
    ------
    QualityError
        the board of one pose was not found ten times.
    """
    for pose in poses:
        for _ in range(ATTEMPTS):
            if not ready(pose):
                return
            view = session.take(pose.name, progress.scan(pose.name))
            yield view
            if view.found:
                break
        else:
            raise QualityError(
                f"{pose.name}: no board was found {ATTEMPTS} times, the last time because of this: {view.reason}; is "
                "it the board that is configured ([board], --board)? What was found is kept: go on with --resume"
            )


def every(seconds: float, say: Callable[[str], None], where: Callable[[Pose], str]) -> Callable[[Pose], bool]:
    """Return a `ready` that tells where the board should be, and waits."""

    def ready(pose: Pose) -> bool:
        say(f"{pose.name} in {seconds:g} s: {where(pose)}")
        time.sleep(seconds)
        return True

    return ready


def folder_poses(session: Session, folder: Path, progress: Progress) -> Iterator[BoardView]:
    """Look for the board in each set of a capture folder, one set in memory at a time.

    Raises
    ------
    ConfigurationError
        its capture.toml or its images are wrong, or the fringes are not along both directions.
    """
    from fringed_client.capture import DESCRIPTION, WRAPPED, load_description
    from fringed_client.capture_images import load_capture

    described = load_description(folder)
    problems = []
    if sorted(described.orientations()) != ["columns", "rows"]:
        there = " and ".join(described.orientations())
        problems.append(Problem("group", f"fringes along {there}", "both: groups with orientation columns and rows"))
    if described.capture.family in WRAPPED or described.capture.one_shot:
        allowed = "a family of absolute phase, such as multi-frequency or gray-phase-shift"
        problems.append(Problem("capture.family", described.capture.family, allowed))
    if problems:
        raise ConfigurationError(f"{folder / DESCRIPTION} describes no poses of a board:", tuple(problems))
    for role in described.sets:
        progress.show(role, 0.0, "reading images", "reading images")
        _, sets = load_capture(folder, role)
        yield session.view_of(role, sets[role], progress.scan(role))


def remaining(count: int, taken: Sequence[BoardView] = ()) -> list[Pose]:
    """Return the planned poses that are not taken yet."""
    there = {view.name for view in taken}
    return [pose for pose in plan(count) if pose.name not in there]
