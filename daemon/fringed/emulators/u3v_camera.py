"""An emulated USB3 Vision camera: what its control and stream endpoints do. No USB yet; see u3v.py.

It has no thread: frames are exposed by the clock, and made when they are fetched. Used by any thread.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

import numpy as np

from fringed.data import Array
from fringed.emulators import u3v_memory as at
from fringed.emulators.u3v_faults import Faults, Part
from fringed.emulators.u3v_memory import CameraMemory, EmulatedIdentity, Refused
from fringed.errors import ProtocolError
from fringed.protocols import u3v_registers as reg
from fringed.protocols.gencp import (
    STATUS_OF,
    Acknowledge,
    Pending,
    ReadDone,
    ReadRequest,
    Refusal,
    Request,
    RequestDecoder,
    WriteDone,
    encode_acknowledge,
)
from fringed.protocols.u3v import Leader, Trailer, encode_leader, encode_trailer
from fringed.protocols.u3v_pixels import BY_CODE, PixelFormat, encode_image

Picture = Callable[[float, float], Array]
"""`picture(exposure_start_s, exposure_s)`, on the machine's monotonic clock: `(height, width)`, with or without 3."""


class EmulatedU3vCamera:
    """A camera with `picture` in front of its lens, `period_s` from frame to frame, `buffers` finished frames waiting.

    The picture's numbers are those of the bits in force; grey ones are spread over the channels of an RGB format, and
    of colour ones the green goes to a monochrome format. `bits` and `gain_db` tell what is in force.
    """

    def __init__(
        self,
        picture: Picture | None = None,
        identity: EmulatedIdentity | None = None,
        period_s: float = 0.1335,
        buffers: int = 3,
    ) -> None:
        self.identity = identity or EmulatedIdentity()
        self.faults = Faults()
        self.memory = CameraMemory(self.identity)
        self.plugged = True
        self.blocks_dropped = 0
        self._picture = picture or self._gradient
        self._period_s, self._buffers = period_s, buffers
        self._changed = threading.Condition()
        self._decoder = RequestDecoder()
        self._answers: deque[bytes] = deque()
        self._boot_s = time.monotonic() - 1000.0
        self._exposures: deque[float] = deque()
        self._running, self._next_start_s, self._block_id, self._late_s = False, 0.0, 0, 0.0
        self._transfers: Iterator[tuple[Part, bytes]] = iter(())
        self._refresh()

    @property
    def pixels(self) -> PixelFormat:
        """The pixel format in force."""
        return BY_CODE[self.memory.whole(at.PIXEL_FORMAT)]

    @property
    def bits(self) -> int:
        """The bits in force."""
        return self.pixels.bits

    @property
    def gain_db(self) -> float:
        """The gain in force."""
        return self.memory.gain_db()

    @property
    def exposure_s(self) -> float:
        """The exposure in force."""
        return self.memory.whole(at.EXPOSURE_TICKS) * at.TICK_US * 1e-6

    @property
    def period_s(self) -> float:
        """From frame to frame: as long as the exposure at least."""
        return max(self._period_s, self.exposure_s)

    def unplug(self) -> None:
        """Pull the cable: whoever waits learns it at once, and the camera forgets what it was told."""
        with self._changed:
            self.plugged = False
            self._stop()
            self._answers.clear()
            self._changed.notify_all()

    def plug(self) -> None:
        """Plug it in again: it has started afresh."""
        with self._changed:
            self.memory = CameraMemory(self.identity)
            self._decoder = RequestDecoder()
            self._refresh()
            self.plugged = True

    def pulse(self) -> None:
        """Give a pulse on the trigger line."""
        with self._changed:
            if self._triggered() and self.memory.whole(at.TRIGGER_SOURCE) > 0:
                self._trigger()

    def command(self, data: bytes) -> None:
        """Take bytes of the control endpoint."""
        with self._changed:
            try:
                requests = self._decoder.feed(data)
            except ProtocolError:
                return  # a real camera is silent to what it cannot read
            for request in requests:
                if self.faults.take("silent"):
                    continue
                if self.faults.take("pending"):
                    self._answers.append(encode_acknowledge(Pending(request.request_id, 300)))
                self._answers.append(encode_acknowledge(self._execute(request)))

    def answer(self) -> bytes | None:
        """Return the next acknowledge, if there is one."""
        with self._changed:
            return self._answers.popleft() if self._answers else None

    def transfer(self, timeout_s: float) -> bytes | None:
        """Return the next transfer of the stream; None after `timeout_s`, or once unplugged (`plugged` tells)."""
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while self.plugged:
                found = next(self._transfers, None)
                if found is None and (begun := self._begin_block()) is not None:
                    self._transfers = begun
                    continue
                if found is None:
                    now = time.monotonic()
                    if now >= deadline:
                        return None
                    self._changed.wait(min(deadline, max(self._ready_s(), now + 1e-4)) - now)
                elif self.faults.unplugs():
                    self.unplug()
                elif not self.faults.loses(found[0]):
                    return found[1]
            return None

    def _execute(self, request: Request) -> Acknowledge:
        try:
            if isinstance(request, ReadRequest):
                return ReadDone(request.request_id, self.memory.read(request.address, request.count))
            self.memory.write(request.address, request.data)
            self._wrote(request.address)
        except Refused as refused:
            code = 0x0800 if isinstance(request, ReadRequest) else 0x0802
            return Refusal(request.request_id, code, refused.status)
        return WriteDone(request.request_id, len(request.data))

    def _wrote(self, address: int) -> None:
        if address == reg.TIME_STAMP_LATCH:
            self.memory.put(reg.TIME_STAMP, self._ticks(time.monotonic()), 8)
        elif address == at.TRIGGER_SOFTWARE:
            if self._triggered() and self.memory.whole(at.TRIGGER_SOURCE) == 0:
                self._trigger()
        elif address in (at.ACQUISITION, at.SIRM_AT + reg.STREAM_CONTROL):
            self._start_or_stop()
        elif address in (at.WIDTH, at.HEIGHT, at.PIXEL_FORMAT, at.EXPOSURE_TICKS):
            if self.memory.whole(at.PIXEL_FORMAT) not in BY_CODE or self._running:
                raise Refused("invalid parameter" if not self._running else "access denied")
            self._refresh()

    def _refresh(self) -> None:
        size = self.pixels.payload_bytes(self.memory.whole(at.WIDTH), self.memory.whole(at.HEIGHT))
        self.memory.put(at.PAYLOAD, size)
        self.memory.put(at.SIRM_AT + reg.REQUIRED_PAYLOAD, size, 8)
        self.memory.put(at.PERIOD_US, round(self.period_s * 1e6))

    def _triggered(self) -> bool:
        return bool(self.memory.whole(at.TRIGGER) & 1)

    def _trigger(self) -> None:
        """Expose one frame now; a trigger during an exposure is missed, as by a real camera."""
        now = time.monotonic()
        if self._running and (not self._exposures or now >= self._exposures[-1] + self.exposure_s):
            self._exposures.append(now)
            self._changed.notify_all()

    def _start_or_stop(self) -> None:
        running = bool(self.memory.whole(at.ACQUISITION) & 1 and self.memory.whole(at.SIRM_AT + reg.STREAM_CONTROL) & 1)
        if running and not self._running:
            if sum(self._sizes()) < self.memory.whole(at.PAYLOAD):
                raise Refused("stream registers inconsistent")
            self._running, self._block_id, self._next_start_s = True, 0, time.monotonic()
            self._late_s = self.faults.late_s()
        elif not running:
            self._stop()

    def _stop(self) -> None:
        self._running = False
        self._exposures.clear()
        self._transfers = iter(())

    def _sizes(self) -> tuple[int, ...]:
        one, count, first, second = (
            self.memory.whole(at.SIRM_AT + offset)
            for offset in (reg.PAYLOAD_SIZE, reg.PAYLOAD_COUNT, reg.FINAL1_SIZE, reg.FINAL2_SIZE)
        )
        return (one,) * count + tuple(size for size in (first, second) if size)

    def _expose(self) -> None:
        """Note the exposures that the clock has finished; what nobody fetched in time is dropped."""
        now = time.monotonic()
        while not self._triggered() and self._next_start_s + self.exposure_s <= now:
            self._exposures.append(self._next_start_s)
            self._next_start_s += self.period_s
        while len(self._exposures) > self._buffers:
            self._exposures.popleft()
            self._block_id += 1
            self.blocks_dropped += 1

    def _ready_s(self) -> float:
        if not self._running:
            return float("inf")
        if self._exposures:
            return self._exposures[0] + self.exposure_s + self._late_s
        return float("inf") if self._triggered() else self._next_start_s + self.exposure_s + self._late_s

    def _begin_block(self) -> Iterator[tuple[Part, bytes]] | None:
        if not self._running:
            return None
        self._expose()
        if not self._exposures or time.monotonic() < self._ready_s():
            return None
        start_s, block_id = self._exposures.popleft(), self._block_id
        self._block_id += 1
        self._late_s = self.faults.late_s()
        return self._block(block_id, start_s)

    def _block(self, block_id: int, start_s: float) -> Iterator[tuple[Part, bytes]]:
        pixels, width, height = self.pixels, self.memory.whole(at.WIDTH), self.memory.whole(at.HEIGHT)
        sent = self.faults.wrong_format or pixels.code
        leader = encode_leader(Leader(block_id, self._ticks(start_s), sent, width, height))
        data = encode_image(self._fitted(self._picture(start_s, self.exposure_s)), pixels)
        valid = len(data)
        if self.faults.take("short_next"):
            data = data[: len(data) // 2]
        yield "leader", leader
        offset = 0
        for size in self._sizes():
            if offset < len(data):
                yield "payload", data[offset : offset + size].tobytes()
            offset += size
        status = STATUS_OF["data discarded"] if self.faults.take("discard_next") else 0
        yield "trailer", encode_trailer(Trailer(block_id, valid, height, status))

    def _fitted(self, image: Array) -> Array:
        wanted = np.uint8 if self.bits <= 8 else np.uint16
        if self.pixels.channels == 3 and image.ndim == 2:
            image = np.repeat(image[:, :, None], 3, axis=2)
        elif self.pixels.channels == 1 and image.ndim == 3:
            image = image[:, :, 1]
        return image.astype(wanted, copy=False)

    def _gradient(self, start_s: float, exposure_s: float) -> Array:
        """Return what is seen where nothing is in front of the lens: a ramp from left to right."""
        width, height = self.memory.whole(at.WIDTH), self.memory.whole(at.HEIGHT)
        line = np.linspace(0, 2**self.bits - 1, width).astype(np.uint8 if self.bits <= 8 else np.uint16)
        return np.broadcast_to(line, (height, width))

    def _ticks(self, time_s: float) -> int:
        return round((time_s - self._boot_s) * 1e9 / at.INCREMENT_NS)
