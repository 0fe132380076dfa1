"""A worker's own copy of the sets that it is fed, and the plug-ins that take their frames while they arrive.

Owns the frames until their job comes; knows no socket. A plug-in that raises in `begin` or `add` is not asked again
for that set: the job's ordinary run of it decides, and tells its error.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, fields

import numpy as np

from fringed.config import validate
from fringed.data import Array, FrameSet
from fringed.errors import DataError
from fringed.hookspecs import FrameSetStart, FrameSink, StreamingProcessor
from fringed.loading import Catalogue
from fringed.messages import FedSet, FeedBegin, FeedFrame, StageCall
from fringed.workers.stages import Early

_log = logging.getLogger(__name__)
Note = Callable[[str], None]


class FeedContext:
    """The `Context` of `begin`: there is no job yet whose progress could be told."""

    def __init__(self, threads: int) -> None:
        self.threads = threads

    def progress(self, fraction: float, text: str = "") -> None:
        """Tell nobody."""

    def check_cancelled(self) -> None:
        """Go on: a set that is given up ends between two frames."""

    def log(self, level: str, text: str) -> None:
        """Log for the developer; what users are to see is told by `finish`."""
        _log.debug("%s: %s", level, text)


@dataclass(eq=False)
class _FedFrames:
    """The frames of one set, as far as they have come, and the stages that took them."""

    begin: FeedBegin
    frames: Array
    sinks: dict[str, tuple[StageCall, FrameSink]] = field(default_factory=dict)
    taken: int = 0


class Intake:
    """Everything that this worker is fed. `note` writes what it is doing where its end does not wipe it out."""

    def __init__(self, catalogue: Catalogue, threads: int, note: Note) -> None:
        self._catalogue = catalogue
        self._threads = threads
        self._note = note
        self._feeds: dict[str, _FedFrames] = {}

    def begin(self, begin: FeedBegin) -> None:
        """Make room for a set, and begin what can be begun before it is complete."""
        shape = (len(begin.sequence.frames), begin.height_px, begin.width_px)
        fed = self._feeds[begin.feed] = _FedFrames(begin, np.empty(shape, begin.dtype))
        for stage in begin.stages:
            try:
                sink = self._sink(begin, stage)
            except (Exception, SystemExit) as error:  # noqa: BLE001  a plug-in call; its run will tell
                _log.debug("stage %s does not begin early: %s: %s", stage.name, type(error).__name__, error)
                continue
            if sink is not None:
                fed.sinks[stage.name] = stage, sink
        self._note("")

    def add(self, message: FeedFrame) -> int:
        """Take the next frame; return how many there are now.

        Raises
        ------
        DataError
            it is not the next frame of a set that has begun.
        """
        fed = self._feeds.get(message.feed)
        if fed is None or message.index != fed.taken or message.index >= len(fed.frames):
            due = "nothing" if fed is None else f"frame {fed.taken} of {len(fed.frames)}"
            raise DataError(f"frame {message.index} came where {due} was due")
        image = fed.frames[message.index]
        if message.image.shape != image.shape or message.image.dtype != image.dtype:
            raise DataError(
                f"a frame of {message.image.shape} {message.image.dtype} came; the set has {image.shape} {image.dtype}"
            )
        image[...] = message.image
        fed.taken += 1
        image = image.view()
        image.flags.writeable = False
        for name, (_, sink) in list(fed.sinks.items()):
            self._note(f"taking frames for stage {name}")
            try:
                sink.add(message.index, image)
            except (Exception, SystemExit) as error:  # noqa: BLE001  a plug-in call; its run will tell
                _log.debug("stage %s takes no more frames: %s: %s", name, type(error).__name__, error)
                del fed.sinks[name]
        self._note("")
        return fed.taken

    def drop(self, feed: str) -> None:
        """Forget a set; harmless for any other."""
        self._feeds.pop(feed, None)

    def claim(self, fed_set: FedSet) -> tuple[FrameSet, dict[str, Early]]:
        """Return a fed set as if it had come whole, and the stages that took its frames; then it is forgotten.

        Raises
        ------
        DataError
            frames of it are missing.
        """
        fed = self._feeds.pop(fed_set.id, None)
        if fed is None or fed.taken != len(fed.frames):
            there = "no frame" if fed is None else f"{fed.taken} of {len(fed.frames)} frames"
            raise DataError(f"{there} of the set {fed_set.id} came before its job")
        rest = {item.name: getattr(fed_set, item.name) for item in fields(fed_set)}
        whole = FrameSet(fed.frames, fed.begin.sequence, **rest)
        return whole, {name: Early(call, sink, whole) for name, (call, sink) in fed.sinks.items()}

    def _sink(self, begin: FeedBegin, stage: StageCall) -> FrameSink | None:
        """Let a stage begin that will take this set and nothing else; None where it cannot."""
        cls = self._catalogue.get(stage.kind, stage.plugin) if stage.kind == "processor" else None
        if cls is None or len(cls.inputs) != 1 or not issubclass(cls, StreamingProcessor):
            return None
        [(name, kind)] = cls.inputs.items()
        if kind is not FrameSet or begin.role not in _sources(begin, stage, name):
            return None
        start = FrameSetStart(
            begin.sequence, begin.settings, (begin.height_px, begin.width_px), begin.dtype, begin.role
        )  # fmt: skip
        params = validate(stage.params, cls.Params, f"{stage.name}.params")
        self._note(f"beginning stage {stage.name}")
        sink: FrameSink = cls().begin(start, params, FeedContext(self._threads))
        return sink


def _sources(begin: FeedBegin, stage: StageCall, name: str) -> tuple[str, ...]:
    """Return the sets that may be a stage's input, as `resolve` will find it when the job has come."""
    if name in stage.inputs:
        return (stage.inputs[name],)
    return (name,) if name in begin.roles else begin.roles if len(begin.roles) == 1 else ()
