"""Pictures of patterns: all of them on one sheet, and the grey levels along a line.

Owns these two drawings; the exact pictures are `fringed_client.pattern_files`'.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fringed.data import Array, PatternFrame, PatternSequence
from fringed_client.pattern_files import file_names, full_picture
from fringed_client.pictures import figures

_MOST_THUMBS = 96
_ACROSS = 6
_THUMB_PX = 200
_MOST_GROUPS = 8
_PERIODS = 2.2
_COLOURS = ("red", "green", "blue")
_LIGHT = {"white": None, "red": "#c23b22", "green": "#2e8b57", "blue": "#3465a4"}


def draw_sheet(path: Path, sequence: PatternSequence) -> Path:
    """Draw every picture small, with its period and shift; the first 96 of more. Frames of one shot share theirs."""
    names = file_names(sequence)
    pictures = [index for index, name in enumerate(names) if name not in names[:index]]
    count = min(len(pictures), _MOST_THUMBS)
    across = max(3, min(_ACROSS, count))
    rows = -(-count // across)
    shape = sequence.height_px / sequence.width_px
    drawn = figures.figure(1.95 * across, (1.78 * shape + 0.32) * rows + 0.35)
    more = f", the first {count} pictures of {len(pictures)}" if count < len(pictures) else ""
    drawn.suptitle(f"{title(sequence)}{more}", x=0.01, ha="left", fontsize=11, color=figures.INK)
    for place, axes in enumerate(drawn.subplots(rows, across, squeeze=False).ravel()):
        if place >= count:
            axes.set_axis_off()
            continue
        index = pictures[place]
        axes.imshow(_thumb(full_picture(sequence, index)), cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        figures.titled(axes, "", simulated=False)
        axes.set_title(label(sequence, index), loc="left", fontsize=7, color=figures.INK, pad=2.5)
        axes.set_xticks([])
        axes.set_yticks([])
    return figures.save(drawn, path)


def draw_lines(path: Path, sequence: PatternSequence) -> Path:
    """Draw the grey levels along the phase's direction, two periods of each group; of 2-D patterns the mean.

    Of uniform pictures, such as a grey ramp, each one's level is drawn.
    """
    groups = list(sequence.groups().items())[:_MOST_GROUPS]
    uniform = all(_line(sequence, i).std() == 0 for i in range(len(sequence.frames)))
    across = 1 if uniform else min(2, len(groups))
    rows = 1 if uniform else -(-len(groups) // across)
    drawn = figures.figure(max(6.2 * across, 7.0), 2.3 * rows + 0.5)
    drawn.suptitle(title(sequence), x=0.01, ha="left", fontsize=11, color=figures.INK)
    all_axes = drawn.subplots(rows, across, squeeze=False).ravel()
    if uniform:
        _draw_levels(all_axes[0], sequence)
    for axes, (group, indices) in zip(all_axes, () if uniform else groups, strict=False):
        _draw_group(axes, sequence, group, indices)
    for axes in () if uniform else all_axes[len(groups) :]:
        axes.set_axis_off()
    return figures.save(drawn, path)


def _draw_levels(axes: Any, sequence: PatternSequence) -> None:
    for index, frame in enumerate(sequence.frames):
        colour = _LIGHT[frame.channel] or figures.INK
        axes.bar(index, float(_line(sequence, index)[0]), color=colour, width=0.8)
    figures.titled(axes, "each frame's grey level", simulated=False)
    figures.labelled(axes, "frame", "grey level")
    axes.set_ylim(0, 261)


def title(sequence: PatternSequence) -> str:
    """Return what the sequence is in a few words."""
    compensated = ", compensated for the tone curve" if sequence.precompensated else ""
    size = f"{sequence.width_px} x {sequence.height_px}"
    return f"{sequence.encoder or sequence.family}: {len(sequence.frames)} patterns, {size}{compensated}"


def label(sequence: PatternSequence, index: int) -> str:
    """Return what one frame, or the frames of its shot, are in a few words."""
    frame = sequence.frames[index]
    if frame.shot >= 0:
        mates = [i for i, other in enumerate(sequence.frames) if other.shot == frame.shot]
        return f"{mates[0]} to {mates[-1]}  one shot"
    words = [f"{index}", f"{frame.period_px:.5g} px" if frame.period_px else frame.style]
    if frame.bit >= 0:
        words.append(f"bit {frame.bit}")
    elif frame.period_px:
        words.append(f"{np.degrees(frame.shift_rad):.4g}°")
    words += [f"level {frame.level:g}"] * (frame.level != 1) + ["inverse"] * frame.inverted
    words += [frame.channel] * (frame.channel != "white")
    return "  ".join(words)


def _draw_group(axes: Any, sequence: PatternSequence, group: int, indices: tuple[int, ...]) -> None:
    first = sequence.frames[indices[0]]
    columns = first.orientation == "columns"
    length = sequence.width_px if columns else sequence.height_px
    lines = [np.broadcast_to(_line(sequence, i), (length,)) for i in indices]
    shown = min(length, max(24, int(_PERIODS * first.period_px) or length))
    if any(len(np.unique(line)) > 2 for line in lines):
        _draw_together(axes, sequence, indices, [line[:shown] for line in lines])
    else:
        shown = length if first.bit >= 0 else shown
        _draw_stacked(axes, sequence, indices, [line[:shown] for line in lines])
    what = f"group {group}: {first.style}, {first.orientation}"
    what += f", period {first.period_px:.5g} px" if first.period_px else ""
    what += f", level {first.level:g}" if first.level != 1 else ""
    figures.titled(axes, f"{what}, {len(indices)} frames", simulated=False)
    axes.set_xlabel(f"projector {'column' if columns else 'row'} (px)", fontsize=9, color=figures.INK)
    axes.set_xlim(0, shown - 1)


def _draw_together(axes: Any, sequence: PatternSequence, indices: tuple[int, ...], lines: list[Array]) -> None:
    hues = _colours(len(indices))
    for place, (index, line) in enumerate(zip(indices, lines, strict=True)):
        frame = sequence.frames[index]
        colour = _LIGHT[frame.channel] if frame.shot >= 0 else hues[place]
        style = (0, (3, 1.5)) if frame.inverted else "solid"
        axes.step(np.arange(len(line)), line, where="mid", color=colour or figures.INK, lw=1.0, ls=style)
    axes.set_ylabel("grey level", fontsize=9, color=figures.INK)
    axes.set_ylim(-6, 261)


def _draw_stacked(axes: Any, sequence: PatternSequence, indices: tuple[int, ...], lines: list[Array]) -> None:
    """Draw frames of two levels one below the other, as one draws signals."""
    for place, line in enumerate(lines):
        bright = line > 127 if line.max() > 127 else line > line.min()
        top = -place + 0.8 * bright
        axes.fill_between(np.arange(len(line)), -place, top, step="mid", color=figures.INK, lw=0)
    axes.set_yticks([0.4 - place for place in range(len(lines))], [_short(sequence.frames[i], i) for i in indices])
    axes.set_ylim(0.2 - len(lines), 1.1)


def _short(frame: PatternFrame, index: int) -> str:
    if frame.bit >= 0:
        return f"bit {frame.bit}{' inverse' * frame.inverted}"
    return f"{np.degrees(frame.shift_rad):.4g}°" if frame.period_px else str(index)


def _line(sequence: PatternSequence, index: int) -> Array:
    """Return the grey levels along the phase's direction, of lines that differ their mean.

    Of a shot it is the frame's own channel, else the one that is lit.
    """
    frame, pattern = sequence.frames[index], sequence.patterns[index]
    own = frame.shot >= 0 and pattern.shape[2] == 3
    lit = pattern[..., _COLOURS.index(frame.channel)] if own else pattern.max(axis=2)
    return np.asarray(lit.mean(axis=0 if frame.orientation == "columns" else 1))


def _colours(count: int) -> list[Any]:
    from matplotlib import colormaps

    ramp = colormaps["viridis"]
    return [ramp(0.05 + 0.85 * i / max(count - 1, 1)) for i in range(count)]


def _thumb(picture: Array) -> Array:
    """Return the picture small, each pixel the mean of what it stands for: thin fringes turn grey, not into moire."""
    height, width = picture.shape[:2]
    scale = _THUMB_PX / width
    if scale < 1:
        size = (_THUMB_PX, max(1, round(height * scale)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return picture[..., 0] if picture.ndim == 3 and picture.shape[2] == 1 else picture
