"""One fixed message of each important kind, for the golden bytes."""

from __future__ import annotations

from typing import Any

import numpy as np

from fringed import data, messages

ID = "20260102T030405.678901Z-1f0c"


def examples() -> dict[str, tuple[Any, str, int]]:
    """Map the golden file's name to content, topic and sequence number."""
    patterns = tuple(np.full((1, 4, 1), 80 * k, np.uint8) for k in range(3))
    pattern_frames = tuple(data.PatternFrame("sine", "columns", 4.0, k * 2.0, 0.5, k, 3, 0, "green") for k in range(3))
    sequence = data.PatternSequence("phase-shift", 4, 2, pattern_frames, patterns, parameters={"periods": 1})
    made = data.Provenance(
        (ID,), "triangulate", "0.1", {"sigma": 2.5}, "00112233aabbccdd", "rig-1", "fringed 0.1", "2026-01-02", True,
    )  # fmt: skip
    stamps = tuple(data.FrameStamp(k + 0.0, k + 0.25, k + 0.5, k) for k in range(3))
    check = data.CheckReport(True, (data.CheckFinding("late", "frame 1", (1,)),), 0.01, 0.0, 0.9)
    frames = np.arange(18, dtype=np.uint16).reshape(3, 2, 3)
    frame_set = data.FrameSet(frames, sequence, "object", ID, "scan", stamps, data.CameraSettings(), check, 1, made)
    xyz = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
    xyz[0, 0] = np.nan
    image = np.arange(6, dtype=np.uint8).reshape(2, 3)
    phase = image.astype(np.float32)
    registration = data.Registration(
        "a", "b", np.eye(4), False, "too few pairs", float("inf"), 0.5,
        history=(data.IterationRecord(float("nan"), 0, 1.0, 0.0, 0.0, "coarse"),), id=ID,
    )  # fmt: skip
    lens = data.Lens(3, 2, np.eye(3), np.zeros(5))
    calibration = data.Calibration(lens, lens, np.eye(4), "rig-1", "exact-simulated", residuals={"rms_px": 0.0}, id=ID)
    range_image = data.RangeImage(xyz, image, image, calibration=calibration.hash, id=ID, provenance=made)
    error = messages.ErrorInfo("NotFound", "no pipeline 'x'", ("one", "two"))
    job = messages.Job(
        ID, (messages.StageCall("phase", "processor", "phase-shift", {"steps": 3}, {"frames": "object"}),),
        {"object": frame_set, "calibration": calibration}, "hierarchical",
    )  # fmt: skip
    fed = messages.FedSet(ID, "object", "scan", stamps, data.CameraSettings(), check, 1, made)
    fed_job = messages.Job(ID, job.stages, {"object": fed, "calibration": calibration}, "hierarchical", "scan")
    feed = messages.FeedBegin(
        ID, "scan", "object", ("object",), job.stages, sequence, data.CameraSettings(), 2, 3, "uint16"
    )
    idle = messages.DeviceState("IDLE", "sim", "simulated camera")
    state = messages.StationState("simulated", "0.1", 42, 1.5, True, False, "rig-1", "", idle, idle)
    scan = messages.ScanState(ID, "done", "hierarchical", 1.0, products=({"id": ID, "kind": "RangeImage"},))
    awkward = {"a/b": image, "$array": "no array", "deep": [{"set": frame_set}, None, True, 1, 0.5, "ü"]}
    return {
        "frame-set": (frame_set, "frameset", 7),
        "phase-map": (data.PhaseMap(phase, phase, phase, image, "wrapped", 4.0), "product/phase-map", 1),
        "calibration": (calibration, "product/calibration", 2),
        "range-image": (range_image, "product/range-image", 3),
        "registration": (registration, "product/registration", 4),
        "request": (messages.Request("r1", "process", awkward, 2.5, "token", "fringe"), "", 0),
        "reply": (messages.Reply("r1", {"id": ID, "product": range_image}), "", 0),
        "reply-error": (messages.Reply("r2", None, error), "", 0),
        "station-state": (state, "state", 9),
        "scan-state": (scan, "event", 10),
        "event": (messages.Event("scan.progress", "2026-01-02T03:04:05Z", "info", "half", {"done": 0.5}), "event", 11),
        "preview": (messages.Preview(image, "object", 1, 3, ID), "preview", 12),
        "job": (job, "", 0),
        "job-of-a-fed-set": (fed_job, "", 0),
        "feed-begin": (feed, "", 0),
        "feed-frame": (messages.FeedFrame(ID, 1, frames[1]), "", 0),
        "feed-drop": (messages.FeedDrop(ID, "its set is taken again"), "", 0),
        "feed-taken": (messages.FeedTaken(ID, 2), "", 0),
        "feed-lost": (messages.FeedLost(ID, "its set is taken again", "job"), "", 0),
        "job-failed": (messages.JobFailed(ID, "phase", error, False), "", 0),
        "worker-ready": (
            messages.WorkerReady("w1", 43, 1, (messages.PluginInfo("phase", "fringed", "0.1", 1),)),
            "",
            0,
        ),
    }
