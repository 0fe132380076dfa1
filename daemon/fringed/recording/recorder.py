"""The one thread that writes: work in order, answers through callbacks.

Owns the thread and its queue; knows nothing of what the work does.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from fringed.errors import FringedError, StorageError

log = logging.getLogger(__name__)

T = TypeVar("T")
QUEUE_LENGTH = 32


@dataclass(frozen=True)
class _Task:
    work: Callable[[], Any]
    on_done: Callable[[Any], None]
    on_error: Callable[[FringedError], None]


class Recorder:
    """Run work one after the other on a thread of its own. Callbacks run on that thread too."""

    def __init__(self, length: int = QUEUE_LENGTH, name: str = "recorder") -> None:
        self._tasks: queue.Queue[_Task | None] = queue.Queue()
        self._slots = threading.BoundedSemaphore(length)
        self._length = length
        self._state = threading.Lock()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def submit(
        self, work: Callable[[], T], on_done: Callable[[T], None], on_error: Callable[[FringedError], None]
    ) -> None:
        """Queue `work`; never blocks.

        Raises
        ------
        StorageError
            the queue is full, because the disk does not keep up, or the recorder is stopping.
        """
        with self._state:
            if self._stopping:
                raise StorageError("the recorder is stopping; nothing more is recorded")
            if not self._slots.acquire(blocking=False):
                raise StorageError(
                    f"the disk does not keep up: {self._length} recordings wait to be written; slow down, "
                    "or set data_dir to a faster disk"
                )
            self._tasks.put(_Task(work, on_done, on_error))

    def stop(self, timeout: float = 5.0) -> bool:
        """Finish what is queued, then end the thread; return whether it ended in time. Harmless when stopped."""
        with self._state:
            first, self._stopping = not self._stopping, True
        if first:
            self._tasks.put(None)
        if self._thread.ident is None:
            return True
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (task := self._tasks.get()) is not None:
            self._do(task)
            self._slots.release()

    def _do(self, task: _Task) -> None:
        try:
            try:
                result = task.work()
            except FringedError as error:
                task.on_error(error)
            except Exception as error:  # a thread's top: one bad record must not end recording
                log.exception("recording failed unexpectedly")
                task.on_error(StorageError(f"recording failed unexpectedly: {type(error).__name__}: {error}"))
            else:
                task.on_done(result)
        except Exception:
            log.exception("what was to happen after recording failed")
