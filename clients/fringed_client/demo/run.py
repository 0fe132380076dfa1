"""Run the demonstration: start a station, calibrate it, scan, register, export, draw, report.

Owns the order of things. Pictures are drawn in one thread while the station scans on.
"""

from __future__ import annotations

import json
import os
import platform
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from fringed import __version__
from fringed.messages import ScanState
from fringed_client.demo.calibrate import calibrate
from fringed_client.demo.report import write_html
from fringed_client.demo.scenes import OBJECTS, YAWS_DEG, Shown, rig
from fringed_client.files import make_folder, write_aside
from fringed_client.private import PrivateStation
from fringed_client.saving import copy_recording, recording_of

if TYPE_CHECKING:
    from fringed_client.demo.draw import Artist
    from fringed_client.station import Station


class Progress(Protocol):
    """Where progress is shown."""

    def show(self, name: str, fraction: float, text: str = "", phase: str = "") -> None:
        """Tell how far `name` is."""

    def scan(self, name: str) -> Any:
        """Return a callback for ScanStates."""


@dataclass
class _Work:
    """What every step of the demonstration needs."""

    station: Station
    artist: Artist
    thread: ThreadPoolExecutor
    progress: Progress
    drawing: list[Future[dict[str, Any]]] = field(default_factory=list)

    def draw(self, task: Any, *args: Any) -> Future[dict[str, Any]]:
        """Have something drawn, and show how far the pictures are."""
        future = self.thread.submit(task, *args)
        self.drawing.append(future)
        future.add_done_callback(lambda _: self.show_pictures())
        return future

    def show_pictures(self) -> None:
        """Show how many of all pictures are there."""
        done = sum(future.done() for future in self.drawing)
        total = len(OBJECTS) * (len(YAWS_DEG) + 1)
        self.progress.show("pictures", done / total, f"{done} of {total} sheets", f"{done} of {total} sheets")


def run_demo(folder: Path, quick: bool, progress: Progress) -> dict[str, Any]:
    """Run it all and return the report; `folder` holds everything afterwards.

    Raises
    ------
    FringedError
        a scan, a registration or a file that failed.
    """
    began = time.perf_counter()
    make_folder(folder)
    private = PrivateStation(rig(quick))
    with private as station:
        started_s = time.perf_counter() - began
        calibration = calibrate(station, folder / "calibration", progress)
        found, drawing_s = _with_artist(private.runtime, station, progress, folder)
        state = station.status()
    report = {
        "software": f"fringed {__version__}", "simulated": True, "rig": state.rig, "calibration": calibration,
        "machine": {"cores": os.cpu_count(), "python": platform.python_version(), "system": platform.platform()},
        "camera_px": [464, 348] if quick else [1392, 1040],
        "objects": found,
        "seconds": {"total": time.perf_counter() - began, "start": started_s, "pictures": drawing_s},
    }  # fmt: skip
    write_html(folder, report)
    write_aside(folder / "report.json", json.dumps(report, indent=2, default=str).encode())
    return report


def _with_artist(runtime: Path, station: Station, progress: Progress, folder: Path) -> tuple[dict[str, Any], float]:
    from fringed_client.demo.draw import Artist

    artist = Artist(runtime)
    thread = ThreadPoolExecutor(1, thread_name_prefix="pictures")
    work = _Work(station, artist, thread, progress)
    try:
        shown = [_object(work, item, folder / item.name) for item in OBJECTS]
        found = {item.name: _finished(pending, folder) for item, pending in zip(OBJECTS, shown, strict=True)}
        return found, artist.seconds
    finally:
        for future in work.drawing:
            future.cancel()
        thread.submit(artist.close)  # after the picture that is being drawn
        thread.shutdown()


@dataclass
class _Pending:
    """One object whose pictures are still being drawn."""

    shown: Shown
    states: list[ScanState]
    registered: ScanState
    views: list[Future[dict[str, Any]]]
    model: Future[dict[str, Any]]


def _object(work: _Work, shown: Shown, folder: Path) -> _Pending:
    """Scan the views of one object, register and export them."""
    states, drawn = [], []
    for number, yaw_deg in enumerate(YAWS_DEG, 1):
        own = make_folder(folder / f"view-{number}")
        name = f"{shown.name}, view {number}"
        work.progress.show(name, 0.0, "placing the object", "placing the object")
        work.station.set_scene(shown.view(yaw_deg))
        show = work.progress.scan(name)
        result = work.station.scan("hierarchical", truth=True, on_progress=show)
        states.append(result.state)
        _export(work.station, result.state, "RangeImage", own / "range-image")
        drawn.append(work.draw(work.artist.view, result.state, own))
    images = [_product(state, "RangeImage") for state in states]
    registered = work.station.register(images, on_progress=work.progress.scan(f"{shown.name}, registration"))
    _export(work.station, registered.state, "Model", folder / "model")
    model = work.draw(work.artist.model, registered.model, states, folder)
    return _Pending(shown, states, registered.state, drawn, model)


def _product(state: ScanState, kind: str) -> str:
    from fringed_client.protocol.flows import last_product

    return last_product(state, kind)


def _export(station: Station, state: ScanState, kind: str, path: Path) -> None:
    """Write a product as PLY, and its recording as HDF5."""
    item_id = _product(state, kind)
    station.export(item_id, "ply", path.with_suffix(".ply"))
    recording = recording_of(station, item_id)
    if recording is not None:
        copy_recording(recording, path.with_suffix(".h5"))


def _finished(pending: _Pending, folder: Path) -> dict[str, Any]:
    """Wait for an object's pictures and return its part of the report, paths relative to the folder."""

    def relative(pictures: dict[str, Path]) -> dict[str, str]:
        return {name: str(path.relative_to(folder)) for name, path in pictures.items()}

    views = []
    for yaw_deg, state, future in zip(YAWS_DEG, pending.states, pending.views, strict=True):
        drawn = future.result()
        timings = msgspec.to_builtins(state.timings_s)
        views.append(
            {
                "yaw_deg": yaw_deg, "scan": state.id, "retakes": state.retakes, "timings_s": timings,
                **drawn["figures"],
                "pictures": relative(drawn["pictures"]),
            }
        )  # fmt: skip
    model = pending.model.result()
    return {
        "title": pending.shown.title, "views": views, "registrations": model["registrations"],
        "model": {**model["figures"], "timings_s": dict(pending.registered.timings_s)},
        "pictures": relative(model["pictures"]),
        "files": sorted(str(p.relative_to(folder)) for p in (folder / pending.shown.name).rglob("*.[ph][l5]*")),
    }  # fmt: skip
