"""One request at a time: numbers it, and finds its answer among what comes.

Must not know how bytes travel, nor how long to wait: it says when the device asks for more time.
"""

from __future__ import annotations

from fringed.errors import ProtocolError
from fringed.protocols.gencp import (
    Acknowledge,
    AcknowledgeDecoder,
    Pending,
    ReadDone,
    ReadRequest,
    Refusal,
    Request,
    WriteDone,
    WriteRequest,
    encode_request,
)


class Conversation:
    """Ask with `read` or `write`, then `feed` what comes until it returns the answer."""

    def __init__(self) -> None:
        self.stale = 0
        self.pending_ms = 0
        self._decoder = AcknowledgeDecoder()
        self._last_id = 0
        self._asked: Request | None = None

    @property
    def discarded(self) -> int:
        """How many bytes were no part of a message."""
        return self._decoder.discarded

    def read(self, address: int, count: int) -> bytes:
        """Return the bytes that ask for `count` bytes at `address`."""
        return self._ask(ReadRequest(self._next_id(), address, count))

    def write(self, address: int, data: bytes) -> bytes:
        """Return the bytes that ask to write `data` at `address`."""
        return self._ask(WriteRequest(self._next_id(), address, data))

    def give_up(self) -> None:
        """Forget the request: its answer, should it come late, is dropped and counted in `stale`."""
        self._asked = None
        self._decoder.reset()

    def feed(self, data: bytes) -> bytes | None:
        """Return what was read (nothing of a write) once the answer is complete; None while it is not.

        `pending_ms` is then more than 0 if the device asked for that much more time.

        Raises
        ------
        ProtocolError
            the device refused, or answered something else than it was asked; the request is over.
        """
        self.pending_ms = 0
        answer: bytes | None = None
        try:
            for acknowledge in self._decoder.feed(data):
                if self._asked is None or acknowledge.request_id != self._asked.request_id:
                    self.stale += 1
                elif isinstance(acknowledge, Pending):
                    self.pending_ms = acknowledge.timeout_ms
                else:
                    answer = _answer(self._asked, acknowledge)
                    self._asked = None
        except ProtocolError:
            self._asked = None
            raise
        return answer

    def _next_id(self) -> int:
        self._last_id = self._last_id % 0xFFFF + 1  # 0 is left out: some devices answer 0 to what they cannot read
        return self._last_id

    def _ask(self, request: Request) -> bytes:
        if self._asked is not None:
            raise ProtocolError("the camera was asked before its answer to the last request: give that up first")
        data = encode_request(request)
        self._asked = request
        return data


def _answer(asked: Request, acknowledge: Acknowledge) -> bytes:
    what = (
        f"read {asked.count} bytes at 0x{asked.address:X}"
        if isinstance(asked, ReadRequest)
        else f"write {len(asked.data)} bytes at 0x{asked.address:X}"
    )
    if isinstance(acknowledge, Refusal):
        raise ProtocolError(f"the camera refused to {what}: {acknowledge.reason}")
    if isinstance(asked, ReadRequest) and isinstance(acknowledge, ReadDone):
        if len(acknowledge.data) != asked.count:
            raise ProtocolError(f"the camera was asked to {what} and sent {len(acknowledge.data)}")
        return acknowledge.data
    if isinstance(asked, WriteRequest) and isinstance(acknowledge, WriteDone):
        if acknowledge.count not in (None, len(asked.data)):
            raise ProtocolError(f"the camera was asked to {what} and wrote {acknowledge.count}")
        return b""
    raise ProtocolError(f"the camera was asked to {what} and answered {type(acknowledge).__name__}")
