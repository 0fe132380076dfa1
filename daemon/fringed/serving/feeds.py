"""A scan's sets on their way to a worker while they are taken.

Owns which set of each role is being fed; who is fed is the dispatcher's decision, and whether a set is worth it the
check's. In the reactor's thread.
"""

from __future__ import annotations

from fringed.data import Array
from fringed.messages import FeedBegin, StageCall
from fringed.serving.ports import Jobs, SetUnderWay


class ScanFeed:
    """Feed the sets of one scan; `roles` are all that its job takes."""

    def __init__(self, jobs: Jobs, stages: tuple[StageCall, ...], roles: tuple[str, ...]) -> None:
        self._jobs = jobs
        self._stages = stages
        self._roles = roles
        self._begun: dict[str, str] = {}  # role to the set's id

    def frame(self, of: SetUnderWay, index: int, image: Array) -> None:
        """Send a frame on; the first one of a set that is taken again ends the feed of the one before."""
        if not self._stages:
            return
        if self._begun.get(of.role) != of.id:
            self.drop(of.role, "its set is taken again")
            self._begun[of.role] = of.id
            self._jobs.feed_begin(self._first_word(of, image))
        self._jobs.feed_frame(of.id, index, image)

    def drop(self, role: str, reason: str) -> None:
        """Have the frames of a role forgotten; harmless when there are none, or when their job has them."""
        feed = self._begun.pop(role, None)
        if feed is not None:
            self._jobs.feed_drop(feed, reason)

    def end(self, reason: str) -> None:
        """Have everything forgotten that no job has taken."""
        for role in list(self._begun):
            self.drop(role, reason)

    def _first_word(self, of: SetUnderWay, image: Array) -> FeedBegin:
        height_px, width_px = image.shape
        return FeedBegin(
            of.id, of.scan, of.role, self._roles, self._stages, of.sequence, of.settings, height_px, width_px,
            "uint8" if image.dtype.itemsize == 1 else "uint16",
        )  # fmt: skip
