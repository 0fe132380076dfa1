"""What SDL reads from the environment, and which backend "auto" is. Imports nothing that loads SDL."""

from __future__ import annotations

from collections.abc import Mapping

ENVIRONMENT = {
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
    # SDL_hints.h: wait for the refresh right after each flip instead of queueing one; drivers without it ignore it.
    "SDL_VIDEO_DOUBLE_BUFFER": "1",
    "SDL_VIDEO_MINIMIZE_ON_FOCUS_LOSS": "0",
    "SDL_VIDEO_ALLOW_SCREENSAVER": "0",
    "SDL_NO_SIGNAL_HANDLERS": "1",
    "SDL_AUDIODRIVER": "dummy",
}
PLAIN = {"x11": {"SDL_FRAMEBUFFER_ACCELERATION": "0"}}
"""By backend: a window without the graphics card is a plain copy; only X has that."""


def backend(wanted: str, environment: Mapping[str, str]) -> str:
    """Return the backend for "auto": the session's, or the graphics card itself where there is no session."""
    if wanted != "auto":
        return wanted
    if environment.get("WAYLAND_DISPLAY"):
        return "wayland"
    return "x11" if environment.get("DISPLAY") else "kmsdrm"
