"""Commands and answers of the DuncanTech MS3100's serial line as bytes, and nothing that waits.

The commands of VERIFIED are those of EDT's libpdv, which cites the maker's manual. Everything that nobody has
confirmed is in `Dialect` and UNVERIFIED, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import ClassVar, Literal

from fringed.errors import ProtocolError, UsageError
from fringed.protocols.duncantech_frames import Frame

LINES = (1, 1046)  # integration time in lines
OFFSETS = (0, 127)
CHANNELS = (1, 3)
WORD = (0, 0xFFFF)

VERIFIED: Mapping[str, int] = MappingProxyType({"set_gain": 0x02, "get_offset": 0x05, "set_integration": 0x14})
"""Opcodes that a driver which cites the maker uses."""

UNVERIFIED: Mapping[str, int] = MappingProxyType({"get_gain": 0x03, "set_offset": 0x04, "get_integration": 0x15})
"""Opcodes assumed from their neighbours [A]; `encode` refuses them unless the dialect enables them."""

UNKNOWN = ("trigger mode", "output mode", "identity")
"""What the camera surely can do, by bytes that are not known at all."""

Colour = Literal["red", "green", "blue"]
SetAnswer = Literal["status", "any", "none"]


@dataclass(frozen=True)
class Dialect:
    """Every assumption about what a camera says and takes; correct it here, or in the driver's options.

    `channels` is the channel byte of each CCD [A: numbered as the output multiplexer numbers its arrays].
    `set_answer` is what follows a set [A]: "status": a frame of the same command, its last byte the status,
    before it perhaps the arguments again; "any": such a frame, whatever it says; "none": nothing.
    `status_ok` is the status of success [A]; the byte is verified, its values are not.
    """

    unverified: bool = False
    opcodes: Mapping[str, int] = field(default_factory=lambda: UNVERIFIED)
    channels: Mapping[Colour, int] = field(
        default_factory=lambda: MappingProxyType[Colour, int]({"green": 1, "red": 2, "blue": 3})
    )
    set_answer: SetAnswer = "status"
    status_ok: int = 0

    def __post_init__(self) -> None:
        """Refuse what would confuse two commands or two channels."""
        codes = [*VERIFIED.values(), *self.opcodes.values()]
        if (
            set(self.opcodes) != set(UNVERIFIED)
            or len(set(codes)) < len(codes)
            or not all(0 <= c <= 0xFF for c in codes)
        ):
            raise UsageError(
                f"the opcodes of the MS3100 are {dict(self.opcodes)}; needed are one byte for each of "
                f"{', '.join(UNVERIFIED)}, none of them twice and none of {sorted(VERIFIED.values())}"
            )
        if sorted(self.channels) != ["blue", "green", "red"] or sorted(self.channels.values()) != [1, 2, 3]:
            raise UsageError(
                f"the channels of the MS3100 are {dict(self.channels)}; red, green and blue need 1, 2 and 3"
            )

    def opcode(self, name: str) -> int:
        """Return the opcode of a command, verified or not."""
        return VERIFIED[name] if name in VERIFIED else self.opcodes[name]


@dataclass(frozen=True)
class Command:
    """A command to one channel (1 to 3)."""

    channel: int
    name: ClassVar[str]
    answer_width: ClassVar[int] = 0  # bytes of the value in a get's answer; 0: a set

    def arguments(self) -> bytes:
        """Return the data of its frame."""
        return bytes((_within(self.channel, CHANNELS, "channel"),))


@dataclass(frozen=True)
class SetGain(Command):
    """Set the gain; how many decibels a step is, is not known."""

    value: int
    name: ClassVar[str] = "set_gain"

    def arguments(self) -> bytes:
        """Return channel and value."""
        return super().arguments() + _within(self.value, WORD, "gain").to_bytes(2, "little")


@dataclass(frozen=True)
class SetIntegration(Command):
    """Set the integration time in lines of about 125 us."""

    lines: int
    name: ClassVar[str] = "set_integration"

    def arguments(self) -> bytes:
        """Return channel and lines."""
        return super().arguments() + _within(self.lines, LINES, "integration time in lines").to_bytes(2, "little")


@dataclass(frozen=True)
class SetOffset(Command):
    """Set the offset [A]."""

    value: int
    name: ClassVar[str] = "set_offset"

    def arguments(self) -> bytes:
        """Return channel and value."""
        return super().arguments() + bytes((_within(self.value, OFFSETS, "offset"),))


@dataclass(frozen=True)
class GetOffset(Command):
    """Read the offset."""

    name: ClassVar[str] = "get_offset"
    answer_width: ClassVar[int] = 1


@dataclass(frozen=True)
class GetGain(Command):
    """Read the gain [A]."""

    name: ClassVar[str] = "get_gain"
    answer_width: ClassVar[int] = 2


@dataclass(frozen=True)
class GetIntegration(Command):
    """Read the integration time in lines [A]."""

    name: ClassVar[str] = "get_integration"
    answer_width: ClassVar[int] = 2


COMMANDS: tuple[type[Command], ...] = (SetGain, GetGain, SetOffset, GetOffset, SetIntegration, GetIntegration)


@dataclass(frozen=True)
class Value:
    """The answer to a get."""

    channel: int
    value: int
    status: int


@dataclass(frozen=True)
class Done:
    """The answer to a set; `status` is None where it carried none."""

    status: int | None = None


def encode(command: Command, dialect: Dialect) -> bytes:
    """Return the bytes of a command.

    Raises
    ------
    UsageError
        a number outside its limits, or an opcode that is unverified and not enabled.
    """
    if command.name in UNVERIFIED and not dialect.unverified:
        what, opcode = command.name.replace("_", " "), dialect.opcode(command.name)
        raise UsageError(
            f"'{what}' of the MS3100 is not sent: its opcode 0x{opcode:02X} is assumed and nobody has confirmed it; "
            "set enable_unverified = true in the camera's options to try it, and report what the camera answers "
            "(docs/devices/duncantech.md)"
        )
    return Frame(dialect.opcode(command.name), command.arguments()).encode()


def answers(frame: Frame, command: Command, dialect: Dialect) -> bool:
    """Say whether a frame can be the answer to a command: the same opcode, and the same channel where it has one."""
    if frame.command != dialect.opcode(command.name):
        return False
    wanted = command.arguments()
    if command.answer_width:
        return frame.data[:1] == wanted[:1]
    return len(frame.data) <= len(wanted) or frame.data.startswith(wanted)


def parse_answer(frame: Frame, command: Command, dialect: Dialect) -> Value | Done:
    """Return what the camera answered.

    Raises
    ------
    ProtocolError
        the frame answers another command, has another length, or its status says that the command failed.
    """
    wanted, data = command.arguments(), frame.data
    if not answers(frame, command, dialect):
        raise ProtocolError(
            f"the MS3100 answered {frame.encode().hex(' ')} to {command}; expected command "
            f"0x{dialect.opcode(command.name):02X} with {wanted.hex(' ')}"
        )
    if command.answer_width:
        if len(data) != command.answer_width + 2:
            raise ProtocolError(
                f"the MS3100 answered {len(data)} bytes of data ({data.hex(' ')}) to {command}; expected "
                f"{command.answer_width + 2}: channel, value, status"
            )
        _check_status(data[-1], command, dialect)
        return Value(data[0], int.from_bytes(data[1:-1], "little"), data[-1])
    if dialect.set_answer != "status" or not data or data == wanted:
        return Done()
    if len(data) > len(wanted) + 1:
        raise ProtocolError(
            f"the MS3100 answered {data.hex(' ')} to {command}; expected a status, or {wanted.hex(' ')} and one"
        )
    _check_status(data[-1], command, dialect)
    return Done(data[-1])


def decode_command(frame: Frame, dialect: Dialect) -> Command:
    """Return the command that a frame is, as the camera would read it.

    Raises
    ------
    ProtocolError
        an unknown opcode, a wrong length, or a number outside its limits.
    """
    for cls in COMMANDS:
        if dialect.opcode(cls.name) == frame.command:
            break
    else:
        raise ProtocolError(f"opcode 0x{frame.command:02X} is not known")
    width = 0 if cls.answer_width else (1 if cls is SetOffset else 2)
    if len(frame.data) != 1 + width:
        raise ProtocolError(f"{cls.name} carries {len(frame.data)} bytes of data; expected {1 + width}")
    numbers = (frame.data[0], int.from_bytes(frame.data[1:], "little"))[: 1 + bool(width)]
    command = cls(*numbers)
    try:
        command.arguments()
    except UsageError as error:
        raise ProtocolError(error.message) from error
    return command


def _check_status(status: int, command: Command, dialect: Dialect) -> None:
    if status != dialect.status_ok:
        raise ProtocolError(
            f"the MS3100 answered status 0x{status:02X} to {command}; 0x{dialect.status_ok:02X} is taken for success "
            "[assumed]: if the camera did what was asked, set status_ok in its options, and report it"
        )


def _within(value: int, limits: tuple[int, int], what: str) -> int:
    low, high = limits
    if not low <= value <= high:
        raise UsageError(f"{what} {value} is asked of the MS3100; it must be {low} to {high}")
    return value
