"""What a running plug-in may ask of its host: progress, cancellation, logging.

Owns the throttle; knows its host by two functions only.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from fringed.errors import Cancelled
from fringed.messages import JobProgress

_PROGRESS_INTERVAL_S = 0.1
_LEVELS = ("debug", "info", "warning", "error")


class JobContext:
    """The `Context` of one stage, the `index`-th of `count`."""

    def __init__(
        self,
        report: Callable[[JobProgress], None],
        is_cancelled: Callable[[], bool],
        threads: int,
        place: tuple[str, str, int, int],
    ) -> None:
        """Take `place` as (job, stage, index, count)."""
        self.threads = threads
        self._report = report
        self._is_cancelled = is_cancelled
        self._job, self._stage, self._index, self._count = place
        self._next_s = 0.0

    def progress(self, fraction: float, text: str = "") -> None:
        """Tell how far the stage is, 0 to 1 (at most ten times a second); raises Cancelled."""
        self.check_cancelled()
        now = time.monotonic()
        if now < self._next_s:
            return
        self._next_s = now + _PROGRESS_INTERVAL_S
        whole = (self._index + min(max(float(fraction), 0.0), 1.0)) / self._count
        self._report(JobProgress(self._job, whole, text or self._stage, "info", self._stage))

    def check_cancelled(self) -> None:
        """Raise Cancelled when somebody asked to stop."""
        if self._is_cancelled():
            raise Cancelled(f"stopped in stage {self._stage!r}, as asked")

    def log(self, level: str, text: str) -> None:
        """Log "debug", "info", "warning" or "error"; anything else counts as "info"."""
        known = next((name for name in _LEVELS if name == level), "info")
        self._report(JobProgress(self._job, -1.0, text, known, self._stage))  # type: ignore[arg-type]
