"""Everything a plug-in author needs: the hooks, and the shape of what they register.

A plug-in is a module or object whose functions carry `@hookimpl` and return classes. Hooks only
*register*; frames never travel through hook calls. Make it known by an entry point in the group
`fringed.plugins`, or put its file into a folder named by `workers.plugin_folders`.

    from fringed.hookspecs import hookimpl

    @hookimpl
    def register_processors():
        return [MyDecoder]

Plug-ins import from `fringed.hookspecs`, `fringed.data`, `fringed.wire`, `fringed.config` and
`fringed.errors`, and from nothing else of the daemon.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import msgspec
import numpy as np
import pluggy

from fringed.data import Array, CameraSettings, Float64Array, FrameSet, Mesh, PatternSequence, Product

API_VERSION = 1
PROJECT = "fringed"
ENTRY_POINT_GROUP = "fringed.plugins"

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


class Params(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every plug-in's parameters.

    Annotate each field with `Annotated[float, msgspec.Meta(ge=0, description="…", extra_json_schema=
    {"units": "mm"})]`: limits are enforced, help and units are shown.
    """


class Context(Protocol):
    """What a running plug-in may ask of its host, and nothing more."""

    threads: int

    def progress(self, fraction: float, text: str = "") -> None:
        """Tell how far the work is, 0 to 1; raises Cancelled when somebody asked to stop."""

    def check_cancelled(self) -> None:
        """Raise Cancelled when somebody asked to stop."""

    def log(self, level: str, text: str) -> None:
        """Log "debug", "info", "warning" or "error"."""


@runtime_checkable
class Processor(Protocol):
    """Turn inputs into one product. Stateless; one instance may serve many runs.

    `inputs` maps each input's name to its type (`FrameSet`, `PhaseMap`, …); a type in a one-element
    tuple means a sequence of them. `optional` names those that may be missing. The host fills
    `id`, `scan` and `provenance` of the product.
    """

    name: ClassVar[str]
    version: ClassVar[str]
    summary: ClassVar[str]
    inputs: ClassVar[Mapping[str, Any]]
    optional: ClassVar[frozenset[str]]
    output: ClassVar[type]
    Params: ClassVar[type[Params]]

    def run(self, inputs: Mapping[str, Any], params: Any, context: Context) -> Product:
        """Return a new product of type `output`; raise DataError for inputs that cannot be meant."""
        ...


@dataclass(frozen=True)
class FrameSetStart:
    """What is known of a frame set before its first frame; frames will be `shape` (height, width) of `dtype`."""

    sequence: PatternSequence
    settings: CameraSettings
    shape: tuple[int, int]
    dtype: str
    role: str = "object"


class FrameSink(Protocol):
    """The state of one run that takes its frames while they arrive."""

    def add(self, index: int, image: Array) -> None:
        """Take frame `index`, `(height, width)`, read-only and valid for this call only; in the frames' order."""

    def finish(self, frame_set: FrameSet, context: Context) -> Product:
        """Return what `run` would have returned for the finished set; called once, after every frame."""
        ...


@runtime_checkable
class StreamingProcessor(Protocol):
    """A Processor of one FrameSet that can begin before the set is complete.

    The host may call `run` instead, as it does for recorded sets; both return the same. A set that is
    retaken begins anew.
    """

    def begin(self, start: FrameSetStart, params: Any, context: Context) -> FrameSink:
        """Return the empty sum; raise DataError for a sequence that cannot be decoded."""
        ...


@dataclass(frozen=True)
class ProjectorTarget:
    """The projector that patterns are made for. `tone_curve` as in Calibration, or None."""

    width_px: int
    height_px: int
    tone_curve: Float64Array | None = None


@runtime_checkable
class Encoder(Protocol):
    """Turn parameters into patterns. `decoders` names the processors that understand them."""

    name: ClassVar[str]
    version: ClassVar[str]
    summary: ClassVar[str]
    decoders: ClassVar[tuple[str, ...]]
    Params: ClassVar[type[Params]]

    def encode(self, params: Any, target: ProjectorTarget) -> PatternSequence:
        """Return the sequence; raise UsageError for combinations that cannot be decoded."""
        ...


@runtime_checkable
class Exporter(Protocol):
    """Write a product as a file's bytes. `accepts` lists the types it takes."""

    name: ClassVar[str]
    version: ClassVar[str]
    summary: ClassVar[str]
    suffix: ClassVar[str]
    media_type: ClassVar[str]
    accepts: ClassVar[tuple[type, ...]]
    Params: ClassVar[type[Params]]

    def export(self, product: Any, params: Any) -> bytes:
        """Return the file's content; raise DataError when nothing is left to write."""
        ...


@runtime_checkable
class SceneMaker(Protocol):
    """Make an object for the simulated rig: a mesh in millimetres around its own origin."""

    name: ClassVar[str]
    version: ClassVar[str]
    summary: ClassVar[str]
    Params: ClassVar[type[Params]]

    def make(self, params: Any) -> Mesh:
        """Return the mesh."""
        ...


# Devices. They run in the daemon's acquisition thread, so every call ends within its time-out.


@dataclass(frozen=True)
class RawFrame:
    """One frame as a camera delivers it, times on the rig's clock in seconds.

    `image` is `(height, width)`, uint8 up to 8 bits and uint16 above; `(height, width, 3)`, red, green and
    blue of one exposure, where the camera was armed with channel "rgb".
    """

    image: np.ndarray[Any, np.dtype[Any]]
    counter: int
    exposure_start_s: float
    exposure_end_s: float


class Clock(Protocol):
    """The one clock of a rig: the machine's, or the simulation's."""

    def now(self) -> float:
        """Seconds; never goes back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let that much time pass on this clock."""
        ...


class Camera(Protocol):
    """A camera. open/close the port, arm/disarm the acquisition.

    Free-running: after `arm`, frames come at their own pace and `read` returns the next one.
    Triggered: `trigger` starts one integration, `read` returns its frame.
    """

    simulated: bool
    replayed: bool
    clock: Clock

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its frames."""
        ...

    @property
    def period_s(self) -> float:
        """Shortest time from frame to frame with the settings in force."""
        ...

    def open(self) -> str:
        """Open the port and return the identity; raises DeviceError."""
        ...

    def close(self) -> None:
        """Release everything; harmless when closed."""

    def arm(self, settings: CameraSettings) -> CameraSettings:
        """Start acquisition and return the settings in force; raises DeviceError."""
        ...

    def disarm(self) -> None:
        """Stop acquisition; harmless when not armed."""

    def trigger(self) -> None:
        """Start one integration; only when armed with a trigger."""

    def read(self, timeout_s: float) -> RawFrame:
        """Return the next frame; raises DeviceStalled after `timeout_s` on the rig's clock."""
        ...


class Projector(Protocol):
    """A projector with its video output."""

    simulated: bool

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its panel."""
        ...

    def open(self) -> str:
        """Open and return the identity; raises DeviceError."""
        ...

    def close(self) -> None:
        """Release everything; harmless when closed."""

    def load(self, sequence: PatternSequence, role: str) -> None:
        """Prepare the patterns of one set."""

    def show(self, index: int) -> float:
        """Show pattern `index` and return the confirmed time of its flip, on the rig's clock."""
        ...

    def idle(self) -> None:
        """Show the idle picture."""


@runtime_checkable
class Watched(Protocol):
    """A device that can tell, while it rests, whether it is still there; what a camera or projector may be too."""

    def check(self) -> None:
        """Return at once, within some 0.1 s, where it is; raises DeviceError where it has gone or failed."""


@dataclass(frozen=True)
class Setting:
    """Something of a device that can be read, and set where `writable`: its value now, its unit and limits.

    `choices` are the values allowed, where they are few. `verified` is false where nobody has confirmed on this model
    what is read or written.
    """

    name: str
    value: bool | int | float | str | None
    unit: str = ""
    least: float | None = None
    most: float | None = None
    choices: tuple[str, ...] = ()
    writable: bool = True
    verified: bool = True
    help: str = ""


@runtime_checkable
class Adjustable(Protocol):
    """A device with settings of its own beside those of a scan; what a camera or projector may be too."""

    def settings(self) -> Sequence[Setting]:
        """Ask the device for all of them; raises DeviceError."""
        ...

    def adjust(self, name: str, value: bool | float | str) -> None:
        """Set one, checked against its limits before; raises DeviceError, or UsageError where it cannot be now."""


@dataclass(frozen=True)
class Driver:
    """How the daemon builds a device: `create(options, context)`; options are validated first."""

    name: str
    Options: type[Params]
    create: Any
    summary: str = ""


# The hooks.


@hookspec
def register_patterns() -> Sequence[type[Encoder]]:
    """Return encoder classes."""
    return ()


@hookspec
def register_processors() -> Sequence[type[Processor]]:
    """Return processor classes: decoders, unwrapping, triangulation, registration, merging."""
    return ()


@hookspec
def register_cameras() -> Sequence[Driver]:
    """Return camera drivers; only one that the configuration names is built, in the daemon."""
    return ()


@hookspec
def register_projectors() -> Sequence[Driver]:
    """Return projector drivers; only one that the configuration names is built, in the daemon."""
    return ()


@hookspec
def register_scenes() -> Sequence[type[SceneMaker]]:
    """Return makers of objects for the simulated rig."""
    return ()


@hookspec
def register_exporters() -> Sequence[type[Exporter]]:
    """Return exporters."""
    return ()


@hookspec
def register_commands() -> Sequence[Any]:
    """Return click commands that `fringe` adds to its own."""
    return ()


HOOKS = (
    "register_patterns", "register_processors", "register_cameras", "register_projectors",
    "register_scenes", "register_exporters", "register_commands",
)  # fmt: skip
