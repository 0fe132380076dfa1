"""What tests of the HITACHI driver share: the emulated projector in virtual time, and as a process."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import contextmanager
from typing import Any

import fringed.emulators.cpx260
from fringed.devices.projector.hitachi_control import ControlSettings, HitachiControl
from fringed.devices.projector.hitachi_line import HitachiLine, LineTimes, NetworkFraming, SerialFraming
from fringed.emulators.cpx260_conversation import Conversation, Manner
from fringed.emulators.cpx260_model import Projector
from fringed.errors import DeviceAbsent
from fringed.simulation.clock import VirtualClock

MODULE = fringed.emulators.cpx260.__name__
PATIENCE_S = 30.0


class VirtualCable:
    """A transport to an emulated projector in this process, in virtual time."""

    def __init__(self, projector, clock, manner=None):
        self.projector, self.clock = projector, clock
        self.conversation = Conversation(projector, manner or Manner())
        self.plugged, self.is_open, self.openings = True, False, 0
        self.sent = []

    @property
    def name(self):
        return "/dev/projector"

    def open(self):
        if not self.plugged:
            raise DeviceAbsent("there is no /dev/projector")
        self.is_open, self.openings = True, self.openings + 1
        self.conversation.begin(self.clock.now())
        self.conversation.greet(self.clock.now())

    def close(self):
        self.is_open = False

    def write(self, data):
        self._require()
        self.sent.append(data)
        self.conversation.feed(data, self.clock.now())

    def read(self, timeout_s):
        self._require()
        end_s = self.clock.now() + timeout_s
        while True:
            if self.conversation.idle_too_long(self.clock.now()):
                self.is_open = False
                self._require()
            self.conversation.emit(self.projector.noise(self.clock.now()), self.clock.now())
            if data := self.conversation.due(self.clock.now()):
                return data
            next_s = self.conversation.next_s()
            if next_s is None or next_s > end_s:
                self.clock.sleep_until(end_s)
                return b""
            self.clock.sleep_until(next_s)

    def _require(self):
        if not (self.plugged and self.is_open):
            self.is_open = False
            raise DeviceAbsent("/dev/projector was unplugged")


class Lab:
    """A projector in virtual time with its control."""

    def __init__(self, manner=None, settings=None, times=None, password="", **model: Any):
        self.clock = VirtualClock(real_time=False)
        self.projector = Projector(**model)
        self.cable = VirtualCable(self.projector, self.clock, manner)
        framing = NetworkFraming() if manner is not None and manner.wrapped else SerialFraming()
        self.line = HitachiLine(self.cable, framing, self.clock, times or LineTimes(), password)
        self.control = HitachiControl(self.line, self.clock, settings or ControlSettings())

    def lit(self):
        """Open, switch on and wait."""
        self.control.open()
        self.control.power_on()
        from fringed.devices.projector.hitachi_power import Lamp

        self.control.wait_for(Lamp.ON, 100)
        return self


class EmulatorProcess:
    """The emulator as a process, told what to do by its control line."""

    def __init__(self, process):
        self._process = process
        self.ports = self._line()["ports"]

    def __call__(self, do, **values):
        self._process.stdin.write(json.dumps({"do": do, **values}).encode() + b"\n")
        self._process.stdin.flush()
        answer = self._line()
        assert answer.pop("ok"), answer
        return answer

    def _line(self):
        line = self._process.stdout.readline()
        assert line, f"the emulator ended with {self._process.wait(PATIENCE_S)}"
        return json.loads(line)


@contextmanager
def emulator(*arguments):
    """Run the emulator with these arguments."""
    process = subprocess.Popen(
        [sys.executable, "-m", MODULE, *map(str, arguments)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        yield EmulatorProcess(process)
    finally:
        process.stdin.close()
        process.wait(PATIENCE_S)
        process.stdout.close()
