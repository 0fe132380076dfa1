"""What arrives on the stream: typed messages, numbered, with the count of those missed.

Owns the bookkeeping of one subscription; does no I/O.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fringed import wire
from fringed.errors import UsageError, VersionMismatch, WireError


@dataclass(frozen=True)
class Message:
    """One announcement.

    `content` is a frozen dataclass of `fringed.data` or `fringed.messages`, its arrays views of the
    received bytes. `seq` numbers the messages of its topic, `missed` counts those of the same topic
    that were published since the previous one that this subscriber was given.
    """

    content: Any
    topic: str
    seq: int
    missed: int
    nbytes: int = 0

    def _repr_html_(self) -> str:
        from fringed_client.html import show

        missed = f" · {self.missed} missed before it" if self.missed else ""
        return f"<div><code>{self.topic}</code> #{self.seq}{missed}</div>{show(self.content)}"


def check_topics(topics: Sequence[str]) -> tuple[str, ...]:
    """Return the prefixes to subscribe to, all topics for none.

    Raises
    ------
    UsageError
        a name that no topic begins with.
    """
    for topic in topics:
        if not any(known.startswith(topic) for known in wire.TOPICS):
            raise UsageError(f"no topic begins with {topic!r}; there are {', '.join(wire.TOPICS)}")
    return tuple(topics) or ("",)


class SubscriptionCore:
    """Count, and drop what came twice.

    Late joiners are sent the last value of each topic again under its old number; whoever was there
    already drops it. `state` is followed as the station's heartbeat even when nobody asked for it.
    """

    def __init__(self, topics: Sequence[str] = ()) -> None:
        self.wanted = check_topics(topics)
        self.received = 0
        self.missed = 0
        self.malformed = 0
        self.bytes = 0
        self._last: dict[str, int] = {}

    @property
    def prefixes(self) -> tuple[str, ...]:
        """What the socket subscribes to: the wanted topics and the heartbeat."""
        beats = any(wire.TOPIC_STATE.startswith(prefix) for prefix in self.wanted)
        return self.wanted if beats else (*self.wanted, wire.TOPIC_STATE)

    def receive(self, frames: Sequence[wire.Buffer]) -> Message | None:
        """Return the message, or None for one that is a duplicate, malformed or only a heartbeat."""
        try:
            topic, header = wire.peek(frames)
            if not topic.startswith(self.wanted) or header.seq <= self._last.get(topic, -1):
                return None
            content = wire.decode(frames).content
        except VersionMismatch:
            raise
        except WireError:
            self.malformed += 1
            return None
        missed = header.seq - self._last.get(topic, header.seq - 1) - 1
        self._last[topic] = header.seq
        nbytes = sum(memoryview(part).nbytes for part in frames)
        self.received, self.missed, self.bytes = self.received + 1, self.missed + missed, self.bytes + nbytes
        return Message(content, topic, header.seq, missed, nbytes)
