"""Pictures of dark and bright stripes, judged without complements.

Owns four tests: white is nowhere darker and black nowhere brighter than another frame; the edges of a picture do not
coincide with those of the one before; wide stripes are dark or bright, except at their edges; and along a line the
code counts in one direction, since a surface shows the projector's columns in their order. Each needs enough in
view to tell. Arrays in, findings out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringed.acquisition.sampling import per_band
from fringed.data import Array, CheckFinding, Float32Array, PatternSequence

EDGES = 30  # that a picture must show for its edges to tell
COINCIDE, APART = 0.5, 0.1  # the share of edges in one place: of late pictures, of patterns that can be told apart
GREY = (0.2, 0.8)  # between dark and bright
GREY_MAX = 0.3  # the share of grey pixels above which a picture of wide stripes is a mixture
WIDE_PX = 24.0  # stripes that blur leaves dark and bright
COUNTED_PX = 16.0  # stripes that the grid resolves
BACKWARDS = 0.25  # the share of a code's steps against its direction above which a bit is wrong
BEYOND, BEYOND_MAX = 0.15, 0.05  # of the swing; of the pixels


@dataclass(frozen=True)
class Coded:
    """A code's frames on the grid: `indices`, and for all pixels of the set what is dark and bright `(p,)`."""

    sequence: PatternSequence
    indices: tuple[int, ...]
    grid: Float32Array
    low: Float32Array
    swing: Float32Array
    valid: Array

    def relative(self, index: int) -> Array:
        """Return frame `index` between dark, 0, and bright, 1 `(p,)`."""
        share: Array = (self.grid[index].ravel() - self.low) / self.swing
        return share

    @property
    def axis(self) -> int:
        """The axis of the grid along which the code counts."""
        return 1 if self.sequence.frames[self.indices[0]].orientation == "columns" else 0


def extremes(coded: Coded, flat: tuple[int, int]) -> list[CheckFinding]:
    """Judge the black and the white frame by the others."""
    others = [coded.relative(i) for i in coded.indices]
    found = []
    for index, word, beyond in (
        (flat[0], "black", coded.relative(flat[0]) - np.min(others, axis=0)),
        (flat[1], "white", np.max(others, axis=0) - coded.relative(flat[1])),
    ):
        wrong = (beyond > BEYOND) & coded.valid
        share = float(wrong.sum()) / float(coded.valid.sum())
        if share > BEYOND_MAX:
            text = f"frame {index} should be {word} all over and is not on {share:.0%} of the pixels that see the code"
            found.append(CheckFinding("blended", f"{text}; raise acquisition.latency_s or settle_s", (index,)))
    return found


def picture(coded: Coded, index: int, earlier: int) -> list[CheckFinding]:
    """Judge a frame by its greyness, and by the edges of the picture before it, -1 for none."""
    if earlier >= 0 and coded.sequence.frames[earlier].style == "gray":
        share = _coincidence(coded, index, earlier)
        told = share[~np.isnan(share)]
        if len(told) and told.mean() > COINCIDE:
            return [CheckFinding("late", f"frame {index} has the edges that frame {earlier} showed", (index,))]
        if len(told) and np.any(told > COINCIDE):
            text = f"frame {index} has the edges of frame {earlier} in {np.mean(told > COINCIDE):.0%} of its bands"
            return [CheckFinding("torn", text, (index,))]
    grey = _greyness(coded, index) if _stripe_px(coded.sequence, index) >= WIDE_PX else 0.0
    if grey <= GREY_MAX:
        return []
    text = (
        f"{grey:.0%} of what frame {index} shows is neither dark nor bright, though its stripes are wide; it holds "
        "some of what was shown before: raise acquisition.latency_s or settle_s"
    )
    return [CheckFinding("blended", text, (index,))]


def _greyness(coded: Coded, index: int) -> float:
    """Return the share of grey pixels, of all rows or of those up to or from any band that hold a quarter of them."""
    now = coded.relative(index)
    grey = (now > GREY[0]) & (now < GREY[1]) & coded.valid
    rows = coded.grid.shape[1]
    part, whole = (per_band(flags.astype(np.float32), rows) for flags in (grey, coded.valid))
    shares = []
    for p, w in ((part, whole), (part[::-1], whole[::-1])):
        sums, counts = np.cumsum(p), np.cumsum(w)
        shares.append(np.where(counts >= whole.sum() / 4, sums / np.maximum(counts, 1), 0.0).max())
    return float(max(shares))


def _coincidence(coded: Coded, index: int, earlier: int) -> Array:
    """Return, by band, the share of an earlier picture's edges where this one has an edge too, NaN where untold."""
    lines = [np.diff(_line(coded.sequence, i)) != 0 for i in (index, earlier)]
    if (lines[0] & lines[1]).sum() > APART * max(lines[1].sum(), 1):
        return np.full(1, np.nan)
    now, then = (_flips(coded, coded.relative(i) > 0.5) for i in (index, earlier))
    sums = [per_band(flags.astype(np.float32).reshape(-1), flags.shape[0]) for flags in (now & then, then)]
    if sums[1].sum() < EDGES:
        return np.full(1, np.nan)
    return np.where(sums[1] < EDGES / 4, np.nan, sums[0] / np.maximum(sums[1], 1.0))


def _flips(coded: Coded, bright: Array) -> Array:
    """Return where neighbours along the code differ, of those that are both valid."""
    flips: Array = (_steps(coded, bright.astype(np.int32)) != 0) & _both_valid(coded)
    return flips


def _steps(coded: Coded, values: Array) -> Array:
    steps: Array = np.diff(values.reshape(coded.grid.shape[1:]), axis=coded.axis)
    return steps


def _both_valid(coded: Coded) -> Array:
    valid = coded.valid.reshape(coded.grid.shape[1:])
    both: Array = valid[:, 1:] & valid[:, :-1] if coded.axis == 1 else valid[1:] & valid[:-1]
    return both


def order(coded: Coded) -> list[CheckFinding]:
    """Judge the code as a whole: a missing or doubled edge makes it count backwards where it should go on."""
    frames = coded.sequence.frames
    chosen = {
        frames[i].bit: i
        for i in coded.indices
        if frames[i].bit >= 0 and not frames[i].inverted and _stripe_px(coded.sequence, i) >= COUNTED_PX
    }
    if len(chosen) < 2 or sorted(chosen) != list(range(len(chosen))):
        return []
    word = parity = np.zeros(coded.low.shape, np.int32)
    for _, index in sorted(chosen.items()):
        parity = parity ^ (coded.relative(index) > 0.5)
        word = 2 * word + parity
    steps = _steps(coded, word)
    steps = np.where(_both_valid(coded), np.sign(steps), 0)
    sums = [per_band((steps == sign).astype(np.float32).reshape(-1), steps.shape[0]) for sign in (1, -1)]
    forwards = 0 if sums[0].sum() >= sums[1].sum() else 1
    total = sums[0] + sums[1]
    share = np.where(total >= EDGES / 3, sums[1 - forwards] / np.maximum(total, 1), 0.0)
    wrong = float(np.mean(share > BACKWARDS)) if total.sum() >= EDGES else 0.0
    if wrong < 0.15:
        return []
    text = (
        f"the code of frames {coded.indices[0]} to {coded.indices[-1]} counts backwards in {wrong:.0%} of the bands; "
        "one of them is late, blended or torn, or the object is in pieces"
    )
    return [CheckFinding("misfit", text, coded.indices)]


def _line(sequence: PatternSequence, index: int) -> Array:
    """Return the middle line of a pattern along its phase."""
    pattern = sequence.patterns[index].max(axis=2)
    columns = sequence.frames[index].orientation == "columns"
    line: Array = (pattern[pattern.shape[0] // 2] if columns else pattern[:, pattern.shape[1] // 2]).astype(np.int32)
    return line


def _stripe_px(sequence: PatternSequence, index: int) -> float:
    """Return the mean width of a pattern's stripes, projector pixels."""
    line = _line(sequence, index)
    return len(line) / (1 + float((np.diff(line) != 0).sum()))
