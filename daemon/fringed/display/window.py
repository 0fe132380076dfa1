"""The window: SDL's surface on one display, filled with patterns, flipped, and watched.

Owns everything of pygame that draws. One thread, the process's main one, uses it.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygame

from fringed.display import environment, pacing, screens, sdl
from fringed.display.messages import Ready, Setup
from fringed.display.patterns import Array8, Pixels, pixels
from fringed.display.picture import grid, with_text
from fringed.errors import DeviceAbsent, UsageError

LOOK_S = 0.25
"""How often it is looked whether the display is still there."""
_FONT_PX = 28
_LOST = {
    pygame.WINDOWCLOSE: "somebody closed the window",
    pygame.QUIT: "the session asked the window to close",
    pygame.WINDOWMINIMIZED: "somebody minimised the window",
    pygame.WINDOWHIDDEN: "the window was hidden",
}


class Window:
    """One full-screen window, never scaled."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._backend = ""
        self._screen: screens.Screen | None = None
        self._connector: screens.Connector | None = None
        self._surface: Any = None
        self._shifts = (16, 8, 0)
        self._pictures: list[Pixels] = []
        self._pace = pacing.Pace(0.0, 0.0, -1)
        self._period_s = 1 / setup.assumed_hz
        self._grid_at_s = float("inf")
        self._look_at_s = 0.0

    def open(self) -> Ready:
        """Open the window, measure its flips, show the idle picture.

        Raises
        ------
        DeviceAbsent
            the display is not there, or is not what the patterns need.
        """
        self._start()
        every = sdl.screens()
        screen = screens.chosen(every, self._setup.display, self._setup.size_px, self._backend)
        screens.require_8_bits(pygame.display.Info().masks, self._backend)
        known = screens.connectors(Path(self._setup.drm_folder))
        self._connector = screens.watched(known, self._setup.connector, screen)
        warnings = list(screens.doubts(self._connector, self._setup.size_px, self._backend))
        self._screen = screen
        self._period_s = 1 / (screen.hz or self._setup.assumed_hz)
        self._cover()
        self._present()  # makes the drawing context
        sdl.wait_for_refresh()  # whether it does is measured
        self._pace = pacing.measured(self._present, time.sleep, self._period_s)
        if self._pace.depth >= 0:
            self._period_s = self._pace.interval_s
        else:
            warnings.append(self._unlocked(screen))
            if self._backend in environment.PLAIN:
                self._cover(plain=True)
        self._draw_idle()
        name = self._connector.name if self._connector else ""
        renderer: tuple[Any, ...] = getattr(
            pygame.display, "_get_renderer_info", tuple
        )()  # pygame-ce's own, for the report only
        return Ready(
            self._backend, screen.index, screen.name, str(renderer[0] if renderer else "copy"), self._period_s,
            self._pace.interval_s, self._pace.jitter_s, self._pace.depth, name, tuple(warnings),
        )  # fmt: skip

    def _unlocked(self, screen: screens.Screen) -> str:
        if self._backend == "dummy":
            return "the backend is 'dummy': nothing is shown"
        text = (
            f"flips do not follow the display's refresh (one every {self._pace.interval_s * 1e3:.2f} ms at no steady "
            f"phase): each is given one period of {self._period_s * 1e3:.2f} ms"
            f"{'' if screen.hz else ' [A], since nobody says the refresh rate,'} to be scanned out"
        )
        if self._setup.vsync_required:
            raise DeviceAbsent(
                f"{text}; projector.options.vsync is 'required': use kmsdrm, or a driver with vertical sync"
            )
        return text

    def _start(self) -> None:
        self._backend = environment.backend(self._setup.backend, os.environ)
        os.environ.update(environment.PLAIN.get(self._backend, {}), SDL_VIDEODRIVER=self._backend)
        sdl.start(self._backend)
        self._backend = pygame.display.get_driver().lower()

    def _cover(self, plain: bool = False) -> None:
        """Open the window: through the graphics card, which can wait for the refresh; `plain`: the quicker copy."""
        assert self._screen is not None
        flags = 0 if self._backend == "dummy" else pygame.FULLSCREEN if plain else pygame.FULLSCREEN | pygame.SCALED
        try:
            self._surface = pygame.display.set_mode(self._setup.size_px, flags, 32, self._screen.index, vsync=0)
        except pygame.error as error:
            hint = screens.hints(self._backend, os.environ)
            raise DeviceAbsent(f"SDL cannot open a window on display {self._screen}: {error}; {hint}") from error
        size = tuple(pygame.display.get_window_size())
        if size != tuple(self._setup.size_px):
            raise DeviceAbsent(
                f"the window is {screens.size_text(size)}, its picture {screens.size_text(self._setup.size_px)}: "
                "something scales; set the desktop's scale to 1"
            )
        self._shifts = tuple(self._surface.get_shifts()[:3])
        pygame.mouse.set_visible(False)
        pygame.display.set_caption("fringed")
        pygame.event.get()

    # Pictures.

    def load(self, patterns: Sequence[Array8]) -> None:
        """Take these as the patterns."""
        self._pictures = [pixels(pattern, self._shifts) for pattern in patterns]

    def show(self, index: int) -> float:
        """Show a pattern and return when it was there, by the machine's monotonic clock.

        Raises
        ------
        UsageError
            there is no such pattern.
        """
        if not 0 <= index < len(self._pictures):
            raise UsageError(f"pattern {index} is asked for; {len(self._pictures)} are loaded")
        self._grid_at_s = float("inf")
        return self._confirmed(self._pictures[index])

    def idle(self) -> float:
        """Show darkness at once, since a late frame may be waited for, and the idle picture a while later."""
        if self._setup.grid_after_s > 0:
            self._grid_at_s = time.monotonic() + self._setup.grid_after_s
            return self._confirmed(np.zeros((1, 1), np.uint32))
        self._draw_idle()
        return time.monotonic()

    def _confirmed(self, picture: Pixels) -> float:
        self._fill(picture)
        flip_s = self._present()
        if self._pace.depth < 0:
            time.sleep(max(0.0, flip_s + self._period_s - time.monotonic()))
            return flip_s + self._period_s
        for _ in range(self._pace.depth):
            flip_s = self._present()
        return flip_s

    def _fill(self, picture: Pixels) -> None:
        target = pygame.surfarray.pixels2d(self._surface)
        target.T[...] = picture

    def _present(self) -> float:
        pygame.display.flip()
        return time.monotonic()

    def _draw_idle(self) -> None:
        self._grid_at_s = float("inf")
        drawn = with_text(grid(self._setup.size_px), _lines(self._setup.idle_text))
        self._fill(pixels(drawn, self._shifts))
        self._present()

    # Life.

    def tick(self) -> None:
        """Do what is due: take the session's events, look at the display, draw the idle picture.

        Raises
        ------
        DeviceAbsent
            the display has gone or changed, or the window was closed.
        """
        now = time.monotonic()
        for event in pygame.event.get():
            if event.type in _LOST:
                raise DeviceAbsent(f"{_LOST[event.type]}: no pattern is visible; it opens again by itself")
        if now >= self._look_at_s:
            self._look_at_s = now + LOOK_S
            self._look()
        if now >= self._grid_at_s:
            self._draw_idle()

    def _look(self) -> None:
        assert self._screen is not None
        every = sdl.screens()
        found = [one for one in every if (one.index, one.name) == (self._screen.index, self._screen.name)]
        if not found or found[0].size_px != self._screen.size_px:
            seen = "; ".join(str(one) for one in every) or "none"
            raise DeviceAbsent(f"display {self._screen} is no longer there; now: {seen}. Plug it in again")
        size = tuple(pygame.display.get_window_size())
        if size != tuple(self._setup.size_px):
            raise DeviceAbsent(
                f"the desktop made the window {screens.size_text(size)}; patterns need "
                f"{screens.size_text(self._setup.size_px)}: set the display's mode back"
            )
        if self._connector is not None:
            folder = Path(self._setup.drm_folder) / self._connector.name
            if not screens.is_connected(folder):
                raise DeviceAbsent(f"the display was unplugged from {self._connector.name}; plug it in again")

    def close(self) -> None:
        """Close it; harmless when closed."""
        self._surface = None
        sdl.stop()


def _lines(text: str) -> list[Array8]:
    """Return each line of text as a mask; `{host}` and `{address}` are the machine's."""
    if not text:
        return []
    filled = text.replace("{host}", socket.gethostname()).replace("{address}", _address())
    font = pygame.font.Font(None, _FONT_PX)
    drawn = (font.render(line or " ", False, (255, 255, 255), (0, 0, 0)) for line in filled.splitlines())
    return [(pygame.surfarray.array3d(line)[..., 0].T > 127).astype(np.uint8) for line in drawn]


def _address() -> str:
    """Return the address by which others reach this machine; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # RFC 5737: nobody's address
            return str(probe.getsockname()[0])
        except OSError:
            return "no network"
