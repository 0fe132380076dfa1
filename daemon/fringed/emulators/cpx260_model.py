"""An emulated HITACHI CP-X260: commands in, replies and noise out, at the times that it is told.

Owns the projector's state; knows no port and asks no clock. What a CP-X260 answers during warm-up and in standby is
not published: `while_warming` chooses, and standby refuses all but power, error and hours.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Literal

from fringed.protocols import hitachi_commands as codes
from fringed.protocols.hitachi import GAP_S, Ack, CannotExecute, Data, Nak, encode_reply
from fringed.protocols.hitachi_commands import Action, Command

WhileWarming = Literal["refuse", "silent", "on"]
_ALWAYS = (codes.POWER, codes.ERRORS, codes.LAMP_HOURS, codes.FILTER_HOURS)
_RESETS = {
    codes.BRIGHTNESS_RESET: (codes.BRIGHTNESS, 50),
    codes.CONTRAST_RESET: (codes.CONTRAST, 50),
    codes.KEYSTONE_RESET: (codes.KEYSTONE, 0),
}
REGISTERS = {
    "input": codes.INPUT, "error": codes.ERRORS, "blank": codes.BLANK, "blank_colour": codes.BLANK_COLOUR,
    "freeze": codes.FREEZE, "brightness": codes.BRIGHTNESS, "contrast": codes.CONTRAST, "gamma": codes.GAMMA,
    "picture_mode": codes.PICTURE_MODE, "keystone": codes.KEYSTONE, "magnify": codes.MAGNIFY,
    "frame_lock_1": codes.FRAME_LOCK_1, "frame_lock_2": codes.FRAME_LOCK_2, "lamp_hours": codes.LAMP_HOURS,
    "filter_hours": codes.FILTER_HOURS,
}  # fmt: skip
_FIXED = (codes.ERRORS, codes.LAMP_HOURS, codes.FILTER_HOURS, codes.KEYSTONE, codes.MAGNIFY)


def _start() -> dict[int, int]:
    return dict.fromkeys(REGISTERS.values(), 0) | {
        codes.BRIGHTNESS: 50, codes.CONTRAST: 50, codes.GAMMA: codes.GAMMA_1_DEFAULT, codes.FRAME_LOCK_1: 1,
        codes.FRAME_LOCK_2: 1, codes.LAMP_HOURS: 812, codes.FILTER_HOURS: 90,
    }  # fmt: skip


FAULTS = ("drop", "nak", "junk", "late")


@dataclass
class Faults:
    """What goes wrong on request: counts of the next replies, or a chance for each."""

    drop: int = 0
    nak: int = 0
    junk: int = 0
    late: int = 0
    chance: float = 0.0

    def next(self, dice: random.Random) -> str:
        """Return "drop", "nak", "junk", "late" or nothing for the next reply."""
        for name in FAULTS:
            if (count := getattr(self, name)) > 0:
                setattr(self, name, count - 1)
                return name
        return dice.choice(FAULTS) if dice.random() < self.chance else ""


@dataclass
class Projector:
    """The projector. Every method takes the time in seconds, which never goes back."""

    warm_up_s: float = 30.0
    cool_down_s: float = 90.0
    while_warming: WhileWarming = "refuse"
    gap_s: float = GAP_S
    dice: random.Random = field(default_factory=lambda: random.Random(260))
    registers: dict[int, int] = field(default_factory=_start)
    faults: Faults = field(default_factory=Faults)
    counts: dict[str, int] = field(default_factory=dict)
    late_s: float = 0.7
    delay_s: float = 0.0
    _until: tuple[str, float] | None = None
    _on: bool = False
    _strike_s: float | None = None
    _replied_s: float = -1e9

    def lamp(self, now_s: float) -> str:
        """Return STANDBY, WARMING, ON or COOLING."""
        if self._until is not None and now_s >= self._until[1]:
            self._on, self._until = self._until[0] == "WARMING", None
        return self._until[0] if self._until else "ON" if self._on else "STANDBY"

    def noise(self, now_s: float) -> bytes:
        """Return what it emits unasked: test data at lamp strike, half way through warm-up."""
        if self._strike_s is None or now_s < self._strike_s:
            return b""
        self._strike_s = None
        return self.junk()

    def junk(self, size: int = 24) -> bytes:
        """Return some bytes that mean nothing, or worse, look as if they did."""
        return self.dice.randbytes(size) + b"\x06"

    def replied(self, now_s: float) -> None:
        """Take note that the last byte of a reply has left."""
        self._replied_s = now_s

    def too_early(self, began_s: float) -> bool:
        """Whether a command that began then breaks the 40 ms rule; such a one is dropped."""
        early = began_s - self._replied_s < self.gap_s - 1e-4
        self._count("early", early)
        return early

    def receive(self, command: Command | None, now_s: float) -> bytes:
        """Return the reply to a command, None for one whose CRC is wrong; nothing where it stays silent.

        It is to be sent `delay_s` later than usual.
        """
        self._count("commands")
        if command is None:
            self._count("bad crc")
            return encode_reply(Nak())
        fault = self.faults.next(self.dice)
        self.delay_s = self.late_s if fault == "late" else 0.0
        self._count(f"fault {fault}", bool(fault))
        if fault == "nak":
            return encode_reply(Nak())
        reply = self._answer(command, now_s)
        if fault == "drop":
            return b""
        return self.junk(self.dice.randrange(1, 12)) + reply if fault == "junk" else reply

    def _answer(self, command: Command, now_s: float) -> bytes:
        lamp = self.lamp(now_s)
        if lamp == "WARMING":
            if self.while_warming == "on" and (command.type, command.action) == (codes.POWER, Action.GET):
                return encode_reply(Data(codes.POWER_ON))
            return b"" if self.while_warming == "silent" else encode_reply(CannotExecute())
        if command.type == codes.POWER:
            return self._power(command, lamp, now_s)
        if lamp != "ON" and command.type not in _ALWAYS:
            return encode_reply(CannotExecute())
        return self._register(command)

    def _power(self, command: Command, lamp: str, now_s: float) -> bytes:
        if command.action == Action.GET:
            return encode_reply(Data({"STANDBY": 0, "ON": 1, "COOLING": 2}[lamp]))
        if command.action != Action.SET or lamp == "COOLING" or self.registers[codes.ERRORS] not in (0, 6, 8):
            return encode_reply(CannotExecute())
        if command.setting == codes.POWER_ON and lamp == "STANDBY":
            self._until, self._strike_s = ("WARMING", now_s + self.warm_up_s), now_s + self.warm_up_s / 2
            self._count("switched on")
            return encode_reply(Ack()) + self.junk()
        if command.setting == codes.POWER_OFF and lamp == "ON":
            self._until = ("COOLING", now_s + self.cool_down_s)
            self._count("switched off")
        return encode_reply(Ack())

    def _register(self, command: Command) -> bytes:
        kind, action = command.type, command.action
        if action == Action.EXECUTE and kind in (*_RESETS, codes.AUTO_ADJUST):
            if kind in _RESETS:
                target, value = _RESETS[kind]
                self.registers[target] = value
        elif kind not in self.registers:
            return encode_reply(CannotExecute())
        elif action == Action.GET:
            return encode_reply(Data(self.registers[kind]))
        elif action == Action.SET and kind not in _FIXED:
            self.registers[kind] = command.setting
        elif action in (Action.INCREMENT, Action.DECREMENT):
            step = 1 if action == Action.INCREMENT else -1
            self.registers[kind] = min(max(self.registers[kind] + step, 0), 0xFFFF)
        else:
            return encode_reply(CannotExecute())
        return encode_reply(Ack())

    def _count(self, what: str, happened: bool = True) -> None:
        if happened:
            self.counts[what] = self.counts.get(what, 0) + 1
