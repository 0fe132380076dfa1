"""The MS3100's memory behind its serial line, without the line: bytes in, answers out, faults on request.

Owns gains, offsets and integration times. What the real camera answers to a set, and to an opcode that it does not
know, nobody has confirmed: here a set is answered by its arguments and a status, an unknown opcode by nothing.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field

from fringed.errors import ProtocolError, UsageError
from fringed.protocols.duncantech import (
    Command,
    Dialect,
    GetGain,
    GetIntegration,
    SetGain,
    SetIntegration,
    SetOffset,
    decode_command,
)
from fringed.protocols.duncantech_frames import Frame, FrameDecoder

FAULTS = ("drop", "garble", "junk", "late", "lose", "refuse", "unplug")
"""What may go wrong with the next answers: none, a wrong byte, noise before it, too late, the command lost before it
was done, a status of failure, and the cable pulled in the middle of it."""

LATE_S = 0.3
REFUSED = 1


@dataclass
class Ccd:
    """The settings of one CCD."""

    gain: int = 256
    offset: int = 10
    lines: int = 64


@dataclass(frozen=True)
class Answer:
    """Bytes for the line; `delay_s` before them; `then_unplug`: half of them, and the cable is out."""

    data: bytes
    delay_s: float = 0.0
    then_unplug: bool = False


@dataclass
class Counts:
    """What came in."""

    commands: int = 0
    bad_checksums: int = 0
    not_understood: int = 0


@dataclass
class EmulatedMs3100:
    """The camera. `changed` hears of every new setting; `faults` says how many of the next answers are struck."""

    dialect: Dialect = field(default_factory=lambda: Dialect(unverified=True))
    changed: Callable[[EmulatedMs3100], None] | None = None
    seed: int = 0
    ccds: dict[int, Ccd] = field(default_factory=lambda: {channel: Ccd() for channel in (1, 2, 3)})
    faults: dict[str, int] = field(default_factory=lambda: dict.fromkeys(FAULTS, 0))
    counts: Counts = field(default_factory=Counts)
    _decoder: FrameDecoder = field(default_factory=FrameDecoder)

    def __post_init__(self) -> None:
        """Seed what faults look like."""
        self._random = random.Random(f"ms3100/{self.seed}")

    def order(self, fault: str, count: int = 1) -> None:
        """Let the next `count` occasions be struck; raises UsageError for a fault that there is not."""
        if fault not in self.faults or count < 0:
            raise UsageError(f"{count} x {fault!r} is ordered; faults are {', '.join(FAULTS)}, counts 0 or more")
        self.faults[fault] = count

    def feed(self, chunk: bytes) -> list[Answer]:
        """Take bytes from the line and return what goes back."""
        found = [answer for frame in self._decoder.feed(chunk) for answer in self._answered(frame)]
        self.counts.bad_checksums = self._decoder.mismatches
        return found

    def restart_line(self) -> None:
        """Forget half a command: the cable was out."""
        self._decoder = FrameDecoder()

    def settings(self) -> dict[str, dict[str, int]]:
        """Return every CCD's settings by the colour of its channel."""
        colours = {channel: colour for colour, channel in self.dialect.channels.items()}
        return {colours[channel]: {**vars(ccd)} for channel, ccd in self.ccds.items()}

    def _answered(self, frame: Frame) -> list[Answer]:
        self.counts.commands += 1
        if self._strikes("lose"):
            return []
        try:
            command = decode_command(frame, self.dialect)
        except ProtocolError:
            self.counts.not_understood += 1
            return []
        refused = self._strikes("refuse")
        data = self._data(command, refused)
        if not command.answer_width and self.dialect.set_answer == "none":
            return []
        status = REFUSED if refused else self.dialect.status_ok
        return self._spoiled(Frame(frame.command, data + bytes((status,))).encode())

    def _data(self, command: Command, refused: bool) -> bytes:
        """Do what a command says, unless it is refused, and return its answer's data but for the status."""
        ccd = self.ccds[command.channel]
        if command.answer_width:
            value = ccd.gain if isinstance(command, GetGain) else ccd.offset
            value = ccd.lines if isinstance(command, GetIntegration) else value
            return bytes((command.channel,)) + value.to_bytes(command.answer_width, "little")
        if not refused:
            match command:
                case SetGain(_, value):
                    ccd.gain = value
                case SetOffset(_, value):
                    ccd.offset = value
                case SetIntegration(_, lines):
                    ccd.lines = lines
            if self.changed is not None:
                self.changed(self)
        return command.arguments()

    def _spoiled(self, data: bytes) -> list[Answer]:
        if self._strikes("drop"):
            return []
        if self._strikes("garble"):
            place = self._random.randrange(len(data))
            data = data[:place] + bytes((data[place] ^ self._random.randrange(1, 256),)) + data[place + 1 :]
        if self._strikes("junk"):
            data = self._random.randbytes(self._random.randrange(1, 12)) + data
        delay_s = LATE_S if self._strikes("late") else 0.0
        return [Answer(data, delay_s, self._strikes("unplug"))]

    def _strikes(self, fault: str) -> bool:
        struck = self.faults[fault] > 0
        self.faults[fault] -= struck
        return struck
