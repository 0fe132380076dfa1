"""The projector driver "window": patterns on a real video output, by a display process.

Owns the options and the rules of a projector. Power, inputs and lamps are another driver's.
"""

from __future__ import annotations

import logging
import os
import re
import subprocess
import sys
from typing import Annotated, Any, Literal, Protocol

import msgspec
from msgspec import Meta

from fringed.data import PatternSequence
from fringed.devices.projector.window_process import DisplayProcess
from fringed.display.listing import Listing
from fringed.display.messages import Backend, Command, Idle, Ping, Ready, Setup, Show
from fringed.display.patterns import packed
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError
from fringed.hookspecs import Driver, Params

_SECONDS = {"units": "s"}


class WindowOptions(Params, frozen=True):
    """Options of the driver "window"."""

    display: Annotated[int | str, Meta(description="index or name of the display; messages list them all")] = 0
    size_px: Annotated[
        tuple[Annotated[int, Meta(ge=64, le=16384)], Annotated[int, Meta(ge=64, le=16384)]],
        Meta(description="width and height of the panel; a desktop of another size is refused"),
    ] = (1024, 768)
    backend: Annotated[
        Backend, Meta(description="auto: Wayland or X where there is a session, else KMS; dummy shows nothing")
    ] = "auto"
    x_display: Annotated[str, Meta(description="X server, such as ':0'; empty: $DISPLAY")] = ""
    x_authority: Annotated[str, Meta(description="X authority file; empty: $XAUTHORITY")] = ""
    idle_text: Annotated[
        str, Meta(description="lines on the idle picture; {station}, {host} and {address} are filled in")
    ] = "{station}\n{host}  {address}"
    grid_after_s: Annotated[
        float, Meta(ge=0, le=3600, description="darkness before the idle picture", extra_json_schema=_SECONDS)
    ] = 2.0
    vsync: Annotated[
        Literal["preferred", "required"],
        Meta(description="required: refuse a display whose flips were measured not to follow its refresh"),
    ] = "preferred"
    assumed_hz: Annotated[
        float,
        Meta(ge=10, le=500, description="[A] refresh, where nobody says it", extra_json_schema={"units": "Hz"}),
    ] = 60.0
    connector: Annotated[
        str,
        Meta(description="the kernel's connector that is watched for unplugging, such as card0-HDMI-A-1; auto; empty"),
    ] = "auto"
    drm_folder: Annotated[str, Meta(description="where the kernel lists connectors")] = "/sys/class/drm"
    open_timeout_s: Annotated[
        float, Meta(gt=0, le=120, description="for a window to open", extra_json_schema=_SECONDS)
    ] = 20.0
    timeout_s: Annotated[
        float, Meta(gt=0, le=60, description="for every answer after that", extra_json_schema=_SECONDS)
    ] = 3.0


class DriverContext(Protocol):
    """What this driver wants to be told."""

    @property
    def station(self) -> str:
        """The station's name."""
        ...


class WindowProjector:
    """A projector on a video output. Its times are the machine's monotonic clock's."""

    simulated = False

    def __init__(self, options: WindowOptions, station: str = "") -> None:
        self._options, self._station = options, station
        self._process: DisplayProcess | None = None
        self._count = 0
        self._gone = ""  # why, since it was open last
        self._warned: set[str] = set()
        self.ready: Ready | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the panel."""
        return self._options.size_px

    @property
    def pid(self) -> int:
        """The display process's id; 0 when closed."""
        return self._process.pid if self._process else 0

    def open(self) -> str:
        """Open the window, measure its flips and return the identity.

        Raises
        ------
        DeviceAbsent
            the display is not there, is of another size, or is scaled.
        DeviceStalled
            the display process hangs.
        """
        if self._process is not None:
            self.check()
            return self._identity()
        process = DisplayProcess(self.setup(), environment_of(self._options))
        try:
            self.ready = process.ready(self._options.open_timeout_s)
        except BaseException as error:
            process.kill() if isinstance(error, DeviceStalled) else process.end()
            raise
        self._process, self._gone = process, ""
        self._warn(self.ready)
        return self._identity()

    def close(self) -> None:
        """Close the window; harmless when closed."""
        process, self._process, self._count, self._gone = self._process, None, 0, ""
        if process is not None:
            process.end()

    def load(self, sequence: PatternSequence, role: str) -> None:
        """Hand over the patterns of one set.

        Raises
        ------
        DeviceError
            they are made for another size.
        """
        if (sequence.width_px, sequence.height_px) != tuple(self.size_px):
            raise DeviceError(
                f"the patterns are {sequence.width_px} x {sequence.height_px}; the projector's panel is "
                f"{self.size_px[0]} x {self.size_px[1]}: encode them for that size"
            )
        data, table = packed(sequence.patterns)
        self._count = 0
        self._do(lambda process: process.load(data, table, self._options.timeout_s))
        self._count = len(table)

    def show(self, index: int) -> float:
        """Show pattern `index` and return the time of its flip, confirmed."""
        if self._process is not None and not 0 <= index < self._count:
            what = f"{self._count} are loaded" if self._count else "none are loaded: call load before show"
            raise DeviceError(f"pattern {index} is asked for; {what}")
        flip_s: float = self._do(lambda process: process.ask(lambda token: Show(token, index), self._options.timeout_s))
        return flip_s

    def idle(self) -> None:
        """Show darkness, and the idle picture a while later."""
        self._ask(Idle)

    def check(self) -> None:
        """See that the display process answers and the display is there; returns within milliseconds where it does.

        Raises
        ------
        DeviceAbsent
            the display has gone, or the process has ended.
        DeviceStalled
            the process hangs.
        """
        self._ask(Ping)

    def _ask(self, make: Any) -> None:
        def command(token: int) -> Command:
            made: Command = make(token)
            return made

        self._do(lambda process: process.ask(command, self._options.timeout_s))

    def _do(self, what: Any) -> Any:
        """Do something with the process; one that failed is ended, so that the next `open` starts afresh."""
        if self._process is None:
            raise DeviceAbsent(self._gone or "the projector's window is closed: open it")
        try:
            return what(self._process)
        except (DeviceStalled, ProtocolError):
            process, self._process, self._count = self._process, None, 0
            process.kill()
            raise
        except DeviceAbsent as error:
            self.close()
            self._gone = error.message
            raise

    def _warn(self, ready: Ready) -> None:
        """Log each kind of doubt once, not at each opening; figures in it differ from time to time."""
        for warning in ready.warnings:
            kind = re.sub(r"[\d.]+", "", warning)
            if kind not in self._warned:
                self._warned.add(kind)
                logging.getLogger(__name__).warning("projector window: %s", warning)

    def _identity(self) -> str:
        assert self.ready is not None
        ready = self.ready
        if ready.depth < 0:
            pace = f"not timed by the refresh, {ready.period_s * 1e3:.2f} ms assumed"
        else:
            pace = f"a flip every {ready.interval_s * 1e3:.2f} ms (deviation {ready.jitter_s * 1e3:.2f} ms), measured"
        plug = f" on {ready.connector}" if ready.connector else ""
        width, height = self.size_px
        return f"display {ready.display} {ready.name!r}{plug}, {width} x {height}, {ready.backend}, {pace}"

    def setup(self) -> Setup:
        """Return what the display process is told."""
        options = self._options
        return Setup(
            display=options.display, size_px=options.size_px, backend=options.backend, assumed_hz=options.assumed_hz,
            idle_text=options.idle_text.replace("{station}", self._station), grid_after_s=options.grid_after_s,
            connector=options.connector, drm_folder=options.drm_folder,
            vsync_required=options.vsync == "required", parent=os.getpid(),
        )  # fmt: skip


def environment_of(options: WindowOptions) -> dict[str, str]:
    """Return the environment of a display process: this one's, with the X server that the options name."""
    environment = dict(os.environ)
    if options.x_display:
        environment["DISPLAY"] = options.x_display
        if options.backend == "auto":
            environment.pop("WAYLAND_DISPLAY", None)
    if options.x_authority:
        environment["XAUTHORITY"] = options.x_authority
    return environment


def displays(options: WindowOptions | None = None, timeout_s: float = 20.0) -> Listing:
    """Return the displays and connectors that there are; a `problem` says why there are none.

    Raises
    ------
    DeviceError
        nothing came within `timeout_s`, or nothing that can be understood.
    """
    options = options or WindowOptions()
    command = [sys.executable, "-m", "fringed.display", "--list", options.backend, "--json"]
    environment = environment_of(options)
    try:
        ran = subprocess.run(
            command, env=environment, capture_output=True, timeout=timeout_s, stdin=subprocess.DEVNULL, check=False
        )
        return msgspec.json.decode(ran.stdout, type=Listing)
    except subprocess.TimeoutExpired as error:
        raise DeviceStalled(
            f"the displays were not told within {timeout_s:g} s; look at the graphics driver"
        ) from error
    except msgspec.MsgspecError as error:
        said = ran.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["nothing"]
        raise DeviceError(f"the displays cannot be told: {error}; the display process said: {said[0]}") from error


def _create(options: WindowOptions, context: DriverContext) -> WindowProjector:
    return WindowProjector(options, context.station)


WINDOW = Driver("window", WindowOptions, _create, "patterns full-screen on a video output, exact and timed")
