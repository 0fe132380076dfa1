"""SDL, as far as pygame does not hand it on: names of displays, waiting for the refresh.

Owns start and end, and the calls by ctypes; these go to the library that pygame has loaded, and to none where it
cannot be found.
"""

from __future__ import annotations

import ctypes
import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import pygame

from fringed.display.screens import Screen, hints
from fringed.errors import DeviceAbsent


@lru_cache(maxsize=1)
def _library() -> Any:
    """Return the SDL2 that is loaded in this process; None where none is found."""
    for line in Path("/proc/self/maps").read_text().splitlines():
        path = line.rpartition(" ")[2]
        if Path(path).name.startswith("libSDL2-2"):
            library = ctypes.CDLL(path)
            library.SDL_GetDisplayName.restype = ctypes.c_char_p
            library.SDL_GetDisplayName.argtypes = [ctypes.c_int]
            library.SDL_GL_SetSwapInterval.argtypes = [ctypes.c_int]
            return library
    return None


def start(backend: str) -> None:
    """Start SDL with the backend that SDL_VIDEODRIVER names.

    Raises
    ------
    DeviceAbsent
        it cannot be used here: what is missing, and what to do.
    """
    try:
        pygame.display.init()
        pygame.font.init()
    except pygame.error as error:
        raise DeviceAbsent(f"SDL cannot use {backend} ({error}): {hints(backend, os.environ)}") from error


def stop() -> None:
    """End it; harmless when ended."""
    pygame.quit()


def _name(index: int) -> str:
    library = _library()
    name = library.SDL_GetDisplayName(index) if library is not None else None
    return name.decode(errors="replace") if name else str(index)


def screens() -> tuple[Screen, ...]:
    """Return the displays as SDL has them now."""
    rates = pygame.display.get_desktop_refresh_rates()
    return tuple(
        Screen(index, _name(index), (int(size[0]), int(size[1])), float(rate))
        for index, (size, rate) in enumerate(zip(pygame.display.get_desktop_sizes(), rates, strict=True))
    )


def wait_for_refresh() -> bool:
    """Have the graphics driver itself wait for the refresh with each flip, and tell whether it says it will.

    A window that asks SDL for it gets a timer of SDL's own where the driver cannot, on a steady grid that looks like
    a refresh and has nothing to do with the display's.
    """
    library = _library()
    return library is not None and library.SDL_GL_SetSwapInterval(1) == 0
