"""One Xvfb with its frame buffer mapped: an ideal video cable that shows what the X server scans out.

One server per head. `Xvfb(folder)` starts it, `picture()` is `(height, width, 3)`, red, green and blue.
"""

from __future__ import annotations

import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, Self

import numpy as np

from fringed.emulators.framebuffer import FrameBuffer

MISSING = "Xvfb is not installed (Debian: apt install xvfb); nothing shows what is scanned out without it"
_START_S = 60.0


def available() -> bool:
    """Tell whether an X server for tests is installed."""
    return shutil.which("Xvfb") is not None


class Xvfb:
    """A running X server without a screen; end it with `close` or as a context."""

    def __init__(self, folder: Path, size_px: tuple[int, int] = (1024, 768), depth: int = 24) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.size_px = size_px
        read, write = os.pipe()
        width, height = size_px
        command = ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{width}x{height}x{depth}"]
        command += ["-fbdir", str(folder), "-nolisten", "tcp", "-noreset"]
        with (folder / "log").open("wb") as log:
            self._process = subprocess.Popen(
                command, pass_fds=(write,), stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
        os.close(write)
        try:
            self.display = f":{_number(read, folder)}"
            if depth == 24:
                self._buffer = FrameBuffer(folder / "Xvfb_screen0")
        except BaseException:
            self._end()
            raise
        finally:
            os.close(read)

    @property
    def pid(self) -> int:
        """The server's process id."""
        return self._process.pid

    def picture(self) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return a copy of what is scanned out now."""
        return self._buffer.picture()

    def unplug(self) -> None:
        """End the server at once, as a cable that is pulled or a session that crashes."""
        self._process.kill()
        self._process.wait(10)

    def close(self) -> None:
        """End the server; harmless when ended."""
        if hasattr(self, "_buffer"):
            self._buffer.close()
        self._end()

    def _end(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(10)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait(10)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _number(descriptor: int, folder: Path) -> int:
    """Return the display number that the server chose."""
    deadline, text = time.monotonic() + _START_S, b""
    while not text.endswith(b"\n"):
        left = deadline - time.monotonic()
        if left <= 0 or not select.select([descriptor], [], [], left)[0]:
            raise RuntimeError(f"Xvfb did not start within {_START_S:g} s: {(folder / 'log').read_text()}")
        more = os.read(descriptor, 16)
        if not more:
            raise RuntimeError(f"Xvfb ended: {(folder / 'log').read_text()}")
        text += more
    return int(text)
