"""Requests out, replies in: ids, matching, errors brought back to life.

Owns what is under way between a client and a station's control socket; does no I/O and knows no
clock. The sync and the asyncio driver are thin around it.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fringed import wire
from fringed.errors import FringedError, WireError, error_classes
from fringed.messages import ErrorInfo, Reply, Request

DEFAULT_TIMEOUT_S = 10.0


@dataclass(frozen=True)
class Call:
    """One question: `timeout_s` is how long the client waits for its answer."""

    verb: str
    params: Mapping[str, Any] = field(default_factory=dict)
    timeout_s: float = DEFAULT_TIMEOUT_S


def revive(info: ErrorInfo) -> FringedError:
    """Return the exception that an error on the wire stands for; its `detail` becomes notes."""
    cls = error_classes().get(info.code)
    error = cls(info.message) if cls is not None else FringedError(f"{info.code}: {info.message}")
    for note in info.detail:
        error.add_note(note)
    return error


class RequestCore:
    """Match replies to requests."""

    def __init__(self, client: str) -> None:
        self.client = client
        self.strays = 0
        self._prefix = f"{os.getpid():x}-{os.urandom(3).hex()}"
        self._numbers = itertools.count(1)
        self._waiting: set[str] = set()

    def request(self, call: Call, lease: str = "") -> tuple[str, list[wire.Buffer]]:
        """Return the id of a new request and its message.

        Raises
        ------
        WireError
            a parameter that the wire does not carry.
        """
        request_id = f"{self._prefix}-{next(self._numbers)}"
        message = Request(request_id, call.verb, dict(call.params), call.timeout_s, lease, self.client)
        frames = wire.encode(message)
        self._waiting.add(request_id)
        return request_id, frames

    def forget(self, request_id: str) -> None:
        """Drop a request; its answer, should it still come, is a stray."""
        self._waiting.discard(request_id)

    def receive(self, frames: Sequence[wire.Buffer]) -> Reply | None:
        """Return the reply to a request that is waited for, None for a stray one.

        Raises
        ------
        WireError
            not a reply; VersionMismatch where the station speaks another version.
        """
        content = wire.decode(frames).content
        if not isinstance(content, Reply):
            raise WireError(f"the station answered with a {type(content).__name__}; expected a Reply")
        if content.id not in self._waiting:
            if content.error is not None and not content.id:  # it could not read what we sent
                raise revive(content.error)
            self.strays += 1
            return None
        self._waiting.discard(content.id)
        return content

    @staticmethod
    def result(reply: Reply) -> Any:
        """Return the reply's result, or raise its error."""
        if reply.error is not None:
            raise revive(reply.error)
        return reply.result
