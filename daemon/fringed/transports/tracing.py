"""What went over a line, written down for support: time, direction, bytes.

Owns the file's form: one line for each piece, `+12.345 > 02 02 00 05 01 FA` sent, `<` received, `#` what happened.
"""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

from fringed.errors import FringedError
from fringed.transports.base import Transport

FOLDER = "FRINGED_SERIAL_TRACE"
MOST_BYTES = 20_000_000


class Traced:
    """A transport that writes down what passes, at most `MOST_BYTES` of text; a disk that is full stops only that."""

    def __init__(self, transport: Transport, path: Path) -> None:
        self._transport, self._path = transport, path
        self._began_s = time.monotonic()
        self._left = MOST_BYTES

    @property
    def name(self) -> str:
        """What messages call the line."""
        return self._transport.name

    def open(self) -> None:
        """Open the line."""
        try:
            self._transport.open()
        except FringedError as error:
            self._note(f"# not opened: {error.message}")
            raise
        self._note(f"# opened {self.name}")

    def close(self) -> None:
        """Close the line."""
        self._transport.close()
        self._note("# closed")

    def write(self, data: bytes) -> None:
        """Send."""
        self._note(f"> {data.hex(' ').upper()}")
        self._transport.write(data)

    def read(self, timeout_s: float) -> bytes:
        """Receive."""
        try:
            data = self._transport.read(timeout_s)
        except FringedError as error:
            self._note(f"# {error.message}")
            raise
        if data:
            self._note(f"< {data.hex(' ').upper()}")
        return data

    def _note(self, text: str) -> None:
        line = f"+{time.monotonic() - self._began_s:.3f} {text}\n"
        if self._left < len(line):
            return
        self._left -= len(line)
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(line)
        except OSError:
            self._left = 0


def traced(transport: Transport) -> Transport:
    """Return the transport, traced where the environment names a folder for that."""
    folder = os.environ.get(FOLDER, "")
    if not folder:
        return transport
    name = re.sub(r"[^A-Za-z0-9]+", "-", transport.name).strip("-")
    return Traced(transport, Path(folder) / f"{name}.trace")
