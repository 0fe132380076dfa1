"""Whether the times and counters of a set's frames can be right.

Owns this part of the check; knows no pictures. The frames of one shot share one exposure.
"""

from __future__ import annotations

from itertools import pairwise

from fringed.data import CheckFinding, FrameStamp

TICK_S = 1e-6


def timing_findings(
    stamps: tuple[FrameStamp, ...], exposures: tuple[tuple[int, ...], ...], delay_s: float
) -> list[CheckFinding]:
    """Return what is wrong; nothing where there are no stamps. `exposures` are the frames of each exposure."""
    count = sum(map(len, exposures))
    if not stamps:
        return []
    if len(stamps) != count:
        return [CheckFinding("count", f"{len(stamps)} frames were stamped; the sequence has {count}")]
    return [*_shots(stamps, exposures), *_order(stamps, exposures), *_windows(stamps, exposures, delay_s)]


def _shots(stamps: tuple[FrameStamp, ...], exposures: tuple[tuple[int, ...], ...]) -> list[CheckFinding]:
    return [
        CheckFinding("order", f"frames {list(indices)} are of one shot and have several times or counters", indices)
        for indices in exposures
        if len({stamps[i] for i in indices}) > 1
    ]


def _order(stamps: tuple[FrameStamp, ...], exposures: tuple[tuple[int, ...], ...]) -> list[CheckFinding]:
    findings = []
    for before, after in pairwise(indices[0] for indices in exposures):
        one, other = stamps[before], stamps[after]
        if other.counter <= one.counter or other.exposure_start_s <= one.exposure_start_s:
            text = (
                f"frame {after} has counter {other.counter} at {other.exposure_start_s:.4f} s, "
                f"the one before it {one.counter} at {one.exposure_start_s:.4f} s; both have to increase"
            )
            findings.append(CheckFinding("order", text, (after,)))
    return findings


def _windows(
    stamps: tuple[FrameStamp, ...], exposures: tuple[tuple[int, ...], ...], delay_s: float
) -> list[CheckFinding]:
    findings = []
    firsts = [indices[0] for indices in exposures]
    for index, following in zip(firsts, [*firsts[1:], None], strict=True):
        stamp = stamps[index]
        next_flip_s = stamps[following].flip_s if following is not None else float("inf")
        early_s = stamp.flip_s + delay_s - stamp.exposure_start_s
        over_s = stamp.exposure_end_s - next_flip_s
        if not (early_s <= TICK_S and over_s <= TICK_S and stamp.exposure_end_s >= stamp.exposure_start_s):
            text = (
                f"frame {index} was exposed from {stamp.exposure_start_s:.4f} s to {stamp.exposure_end_s:.4f} s; "
                f"its pattern was settled from {stamp.flip_s + delay_s:.4f} s to {next_flip_s:.4f} s"
            )
            findings.append(CheckFinding("exposure", text, (index,)))
    return findings
