"""An emulated HITACHI CP-X260 as a process: `python -m fringed.emulators.cpx260 --pty /path/link --tcp PORT`.

Owns the ports, the real time and the control line: one JSON object a line on standard input, one a line back.

    {"do": "drop", "count": 2}          the next replies do not come ("nak", "junk", "late" likewise)
    {"do": "chance", "value": 0.05}     each reply is dropped, refused, disturbed or late so often
    {"do": "noise", "size": 20}         junk now
    {"do": "unplug", "seconds": 0.5}    the ports vanish, and come back ("plug" brings them back at once)
    {"do": "hang-up"}                   TCP connections end
    {"do": "set", "keystone": 4}        a setting, as if by its remote control; also "error", "lamp_hours", …
    {"do": "state"}                     tells lamp, settings and counts
    {"do": "quit"}
"""

from __future__ import annotations

import json
import os
import select
import signal
import stat
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

import click

from fringed.emulators.cpx260_conversation import Conversation, Manner, dice_of, network_manner
from fringed.emulators.cpx260_model import REGISTERS, Faults, Projector, WhileWarming
from fringed.emulators.cpx260_ports import PtyPort, TcpServer
from fringed.errors import UsageError

_IDLE_S = 0.05
Port = PtyPort | TcpServer


class Emulator:
    """The projector with its ports."""

    def __init__(self, projector: Projector, ports: list[tuple[Port, Manner]]) -> None:
        self.projector = projector
        self._ports = [(port, Conversation(projector, manner)) for port, manner in ports]
        self._plug_s: float | None = None
        self.stopping = False

    def plug(self) -> dict[str, Any]:
        """Bring the ports back, and return their names."""
        self._plug_s = None
        for port, _ in self._ports:
            port.plug()
        return {"ports": [port.name for port, _ in self._ports]}

    def unplug(self, now_s: float, seconds: float | None) -> None:
        """Take the ports away, for good or for so long."""
        for port, conversation in self._ports:
            port.unplug()
            conversation.begin(now_s)
        self._plug_s = None if seconds is None else now_s + seconds

    def handles(self, now_s: float) -> list[int]:
        """Return what to wait for."""
        return [handle for port, _ in self._ports for handle in port.handles(now_s)]

    def wait_s(self, now_s: float) -> float:
        """Return how long nothing is to be done."""
        times = [when_s for _, each in self._ports if (when_s := each.next_s()) is not None]
        return min([max(0.0, when_s - now_s) for when_s in times] + [_IDLE_S])

    def step(self, now_s: float) -> None:
        """Do what is due."""
        if self._plug_s is not None and now_s >= self._plug_s:
            self.plug()
        self.projector.lamp(now_s)
        noise = self.projector.noise(now_s)
        for port, conversation in self._ports:
            data = port.read(now_s)
            if port.connected():
                conversation.begin(now_s)
                conversation.greet(now_s)
            conversation.feed(data, now_s)
            if noise:
                conversation.emit(noise, now_s)
            if leaving := conversation.due(time.monotonic()):
                port.write(leaving)
            if conversation.idle_too_long(now_s):
                port.hang_up()

    def control(self, order: Mapping[str, Any], now_s: float) -> dict[str, Any]:
        """Do what a control line says and return what to tell; raises UsageError for what none does."""
        match order.get("do"):
            case "drop" | "nak" | "junk" | "late" as what:
                setattr(self.projector.faults, what, int(order.get("count", 1)))
            case "chance":
                self.projector.faults = Faults(chance=float(order["value"]))
            case "noise":
                for _, conversation in self._ports:
                    conversation.emit(self.projector.junk(int(order.get("size", 20))), now_s)
            case "unplug":
                self.unplug(now_s, order.get("seconds"))
            case "plug":
                return self.plug()
            case "hang-up":
                for port, _ in self._ports:
                    port.hang_up()
            case "set":
                self._set({key: value for key, value in order.items() if key != "do"})
            case "state":
                return self._state(now_s)
            case "quit":
                self.stopping = True
            case other:
                raise UsageError(f"no control line does {other!r}; see python -m fringed.emulators.cpx260 --help")
        return {}

    def close(self) -> None:
        """Take everything away."""
        for port, _ in self._ports:
            port.unplug()

    def _set(self, values: Mapping[str, Any]) -> None:
        if unknown := [key for key in values if key not in REGISTERS]:
            raise UsageError(f"there is no setting {unknown[0]!r}; there are {', '.join(REGISTERS)}")
        self.projector.registers.update({REGISTERS[key]: int(value) for key, value in values.items()})

    def _state(self, now_s: float) -> dict[str, Any]:
        settings = {name: self.projector.registers[code] for name, code in REGISTERS.items()}
        return {"lamp": self.projector.lamp(now_s), "counts": dict(self.projector.counts), **settings}


class ControlLine:
    """Orders from standard input, answers to standard output. A pipe that ends is a parent that is gone."""

    def __init__(self, source: TextIO, sink: TextIO) -> None:
        self._handle, self._sink, self._buffer = source.fileno(), sink, b""
        mode = os.fstat(self._handle).st_mode
        self._from_parent = stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)
        self.ended = not (self._from_parent or os.isatty(self._handle))

    def handles(self) -> list[int]:
        """Return what to wait for."""
        return [] if self.ended else [self._handle]

    def serve(self, emulator: Emulator, ready: list[int], now_s: float) -> None:
        """Do what came."""
        if self._handle not in ready:
            return
        data = os.read(self._handle, 4096)
        if not data:
            self.ended = True
            emulator.stopping = emulator.stopping or self._from_parent
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in filter(None, lines):
            try:
                self.tell({"ok": True, **emulator.control(json.loads(line), now_s)})
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                self.tell({"ok": False, "error": str(error)})

    def tell(self, answer: Mapping[str, Any]) -> None:
        """Say something."""
        print(json.dumps(answer), file=self._sink, flush=True)


def serve(emulator: Emulator, line: ControlLine) -> None:
    """Run until it is told to quit."""
    try:
        line.tell({"ready": True, **emulator.plug()})
        while not emulator.stopping:
            now_s = time.monotonic()
            ready, _, _ = select.select([*emulator.handles(now_s), *line.handles()], [], [], emulator.wait_s(now_s))
            now_s = time.monotonic()
            line.serve(emulator, ready, now_s)
            emulator.step(now_s)
    finally:
        emulator.close()


@click.command(help=__doc__.replace("    {", "\b\n    {", 1))
@click.option("--pty", type=click.Path(path_type=Path), help="make a pseudo-terminal with this link to it")
@click.option("--tcp", type=click.IntRange(0, 65535), help="plain frames on this port, as TCP 23; 0: a free one")
@click.option(
    "--wrapped", type=click.IntRange(0, 65535), help="wrapped frames on this port, as TCP 9715; 0: a free one"
)
@click.option("--password", default="", help="of the network ports")
@click.option("--idle", default=30.0, show_default=True, help="seconds until the wrapped port hangs up")
@click.option("--warm-up", default=30.0, show_default=True, help="seconds")
@click.option("--cool-down", default=90.0, show_default=True, help="seconds")
@click.option("--while-warming", type=click.Choice(["refuse", "silent", "on"]), default="refuse", show_default=True)
@click.option("--baud", default=19200, show_default=True, help="pace of the pseudo-terminal; 0: as fast as it goes")
@click.option("--seed", default=260, show_default=True, help="of noise and faults")
def main(**options: Any) -> None:
    """Run the emulator."""
    while_warming: WhileWarming = options["while_warming"]
    projector = Projector(options["warm_up"], options["cool_down"], while_warming, dice=dice_of(options["seed"]))
    ports: list[tuple[Port, Manner]] = []
    if options["pty"] is not None:
        ports.append((PtyPort(options["pty"]), replace(Manner(), baud=options["baud"])))
    for name, wrapped in (("tcp", False), ("wrapped", True)):
        if options[name] is not None:
            ports.append((TcpServer(options[name]), network_manner(wrapped, options["password"], options["idle"])))
    if not ports:
        raise click.UsageError("nothing to serve: give --pty LINK, --tcp PORT or --wrapped PORT")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    serve(Emulator(projector, ports), ControlLine(sys.stdin, sys.stdout))


if __name__ == "__main__":
    main()
