"""The USB3 Vision stream: leader, payload transfers, trailer.

Owns the bytes of a block and how transfers become blocks; must not know USB or pixels. Layout as in the
AIA's dissector for Wireshark (packet-u3v.c) and Aravis (arvuvspprivate.h), all little-endian:

    leader   prefix "U3VL", u16, size, block id u64, u16, payload type, time stamp u64, pixel format, width,
             height, x offset, y offset, x padding, u16; 52 bytes
    trailer  prefix "U3VT", u16, size, block id u64, status, u16, valid payload u64, lines u32; 32 bytes
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from fringed.data import UInt8Array
from fringed.errors import ProtocolError
from fringed.protocols.gencp import SUCCESS, status_name

LEADER_PREFIX, TRAILER_PREFIX = b"U3VL", b"U3VT"
LEADER, TRAILER = struct.Struct("<4sHHQHHQIIIIIHH"), struct.Struct("<4sHHQHHQI")
IMAGE, IMAGE_WITH_CHUNKS = 0x0001, 0x4001
MAX_SIDE_PX = 1 << 16


@dataclass(frozen=True)
class Leader:
    """What a block begins with; `time_stamp` in the device's ticks."""

    block_id: int
    time_stamp: int
    pixel_format: int
    width: int
    height: int
    x_offset: int = 0
    y_offset: int = 0
    x_padding: int = 0
    payload_type: int = IMAGE


@dataclass(frozen=True)
class Trailer:
    """What a block ends with."""

    block_id: int
    valid_bytes: int
    height: int
    status: int = SUCCESS


@dataclass(frozen=True)
class Block:
    """A complete block: the leader, and the valid bytes of its payload."""

    leader: Leader
    payload: UInt8Array


def encode_leader(leader: Leader) -> bytes:
    """Return the 52 bytes of a leader."""
    return LEADER.pack(
        LEADER_PREFIX, 0, LEADER.size, leader.block_id, 0, leader.payload_type, leader.time_stamp,
        leader.pixel_format, leader.width, leader.height, leader.x_offset, leader.y_offset, leader.x_padding, 0,
    )  # fmt: skip


def encode_trailer(trailer: Trailer) -> bytes:
    """Return the 32 bytes of a trailer."""
    return TRAILER.pack(
        TRAILER_PREFIX, 0, TRAILER.size, trailer.block_id, trailer.status, 0, trailer.valid_bytes, trailer.height
    )


def decode_leader(data: bytes) -> Leader:
    """Return the leader that `data` is; raises ProtocolError for anything else."""
    if len(data) < LEADER.size or data[:4] != LEADER_PREFIX:
        raise ProtocolError(f"{_seen(data)} came; a leader begins with U3VL and has 52 bytes at least")
    _, _, _, block, _, kind, stamp, pixels, width, height, x, y, padding, _ = LEADER.unpack_from(data)
    if kind not in (IMAGE, IMAGE_WITH_CHUNKS):
        raise ProtocolError(
            f"block {block} has the payload type 0x{kind:04X}; 0x0001 (image) and 0x4001 (image with chunks) can be "
            "read: turn other modes off in the camera"
        )
    if not (0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX):
        raise ProtocolError(f"block {block} is said to be {width} x {height} pixels; 1 to {MAX_SIDE_PX} are possible")
    return Leader(block, stamp, pixels, width, height, x, y, padding, kind)


def decode_trailer(data: bytes) -> Trailer:
    """Return the trailer that `data` is; raises ProtocolError for anything else."""
    if len(data) < TRAILER.size or data[:4] != TRAILER_PREFIX:
        raise ProtocolError(f"{_seen(data)} came; a trailer begins with U3VT and has 32 bytes at least")
    _, _, _, block, status, _, valid, height = TRAILER.unpack_from(data)
    return Trailer(block, valid, height, status)


def _is(data: memoryview, prefix: bytes) -> bool:
    """Whether a transfer is a leader or a trailer by its prefix, and by the size that it tells of itself."""
    return data[:4] == prefix and len(data) >= 8 and int.from_bytes(data[6:8], "little") == len(data)


def _seen(data: bytes) -> str:
    return f"a transfer of {len(data)} bytes that begins with {bytes(data[:4]).hex(' ') or 'nothing'}"


@dataclass(frozen=True)
class TransferPlan:
    """The sizes of a block's transfers, as they are programmed into the stream interface's registers."""

    leader: int
    payload: int
    count: int
    final1: int
    final2: int
    trailer: int

    @property
    def payloads(self) -> tuple[int, ...]:
        """The sizes of the payload transfers in their order."""
        return (self.payload,) * self.count + tuple(size for size in (self.final1, self.final2) if size)


def plan_transfers(required: tuple[int, int, int], alignment: int, transfer_bytes: int) -> TransferPlan:
    """Return the plan for `required` bytes of leader, payload and trailer; sizes are multiples of `alignment`.

    Raises
    ------
    ProtocolError
        the camera asks for sizes that cannot be.
    """
    leader, payload, trailer = required
    if not (0 < payload <= 1 << 31 and leader <= 1 << 20 and trailer <= 1 << 20):
        raise ProtocolError(
            f"the camera asks for transfers of {leader}, {payload} and {trailer} bytes (leader, payload, trailer): "
            "read back its width, height and pixel format"
        )
    whole = max(alignment, transfer_bytes // alignment * alignment)
    count, rest = divmod(payload, whole)
    # Leader and trailer have the same room, so that a leader that comes in a trailer's place is still read.
    ends = -(-max(leader, trailer, LEADER.size) // alignment) * alignment
    return TransferPlan(ends, whole, count, -(-rest // alignment) * alignment, 0, ends)


class BlockAssembler:
    """Blocks out of transfers. Ask the device for `wanted` bytes, then `feed` the transfer that came."""

    def __init__(self, plan: TransferPlan) -> None:
        self.plan = plan
        self.skipped = 0
        self._sizes = plan.payloads
        self._leader: Leader | None = None
        self._buffer = np.empty(0, np.uint8)
        self._next = self._filled = 0

    @property
    def between_blocks(self) -> bool:
        """Whether a leader is what comes next."""
        return self._leader is None

    @property
    def wanted(self) -> int:
        """How many bytes the next transfer may have."""
        if self._leader is None:
            return self.plan.leader
        return self._sizes[self._next] if self._next < len(self._sizes) else self.plan.trailer

    def feed(self, transfer: bytes | bytearray | memoryview) -> Block | None:
        """Return the block that `transfer` completes. Without a leader, transfers are skipped and counted.

        Raises
        ------
        ProtocolError
            a block is incomplete or was discarded by the camera: it is named, and the next one can be fed.
        """
        data = memoryview(transfer)
        awaited = self.wanted
        short = self._leader is not None and (self._next == len(self._sizes) or len(data) != awaited)
        if self._leader is None or (short and _is(data, LEADER_PREFIX)):
            self._begin(data)
            return None
        if short and _is(data, TRAILER_PREFIX):
            return self._end(bytes(data))
        self._payload(data)
        return None

    def lost(self, why: str) -> NoReturn:
        """Say that a transfer could not be taken: what was begun is over.

        Raises
        ------
        ProtocolError
            always; it names the block.
        """
        if self._leader is None:
            self.skipped += 1
            raise ProtocolError(f"a transfer was lost between two blocks: {why}")
        raise self._incomplete(why)

    def _begin(self, data: memoryview) -> None:
        before = self._leader
        if before is None and data[:4] != LEADER_PREFIX:
            self.skipped += 1  # the tail of a block whose leader was lost
            return
        broken = self._incomplete("the next block began") if before is not None else None
        self._leader = decode_leader(bytes(data))
        self._buffer = np.empty(sum(self._sizes), np.uint8)
        self._next = self._filled = 0
        if broken is not None:
            raise broken

    def _payload(self, data: memoryview) -> None:
        if self._next == len(self._sizes):
            raise self._incomplete(f"{len(data)} bytes came instead of its trailer")
        if len(data) > self._sizes[self._next]:
            raise self._incomplete(f"a transfer of {len(data)} bytes came; {self._sizes[self._next]} were asked for")
        self._buffer[self._filled : self._filled + len(data)] = np.frombuffer(data, np.uint8)
        self._filled += len(data)
        self._next += 1

    def _end(self, data: bytes) -> Block:
        leader, filled = self._leader, self._filled
        assert leader is not None
        try:
            trailer = decode_trailer(data)
        except ProtocolError as error:
            raise self._incomplete(error.message) from error
        if trailer.block_id != leader.block_id:
            raise self._incomplete(f"the trailer of block {trailer.block_id} came")
        if trailer.status != SUCCESS:
            raise self._incomplete(f"the camera says: {status_name(trailer.status)}")
        if not 0 < trailer.valid_bytes <= filled:
            raise self._incomplete(f"its trailer says {trailer.valid_bytes} bytes are valid")
        self._leader = None
        return Block(leader, self._buffer[: trailer.valid_bytes])

    def _incomplete(self, why: str) -> ProtocolError:
        leader, self._leader = self._leader, None
        assert leader is not None
        return ProtocolError(
            f"block {leader.block_id} is incomplete, {self._filled} of {sum(self._sizes)} bytes in "
            f"{self._next} of {len(self._sizes)} transfers: {why}; check the USB cable, port and hub"
        )
