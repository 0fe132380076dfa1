"""Every error that this software raises on purpose, as one tree.

Owns the names, the exit codes and the codes that travel over the wire; knows nothing of whoever
raises them.

    FringedError
    ├── UsageError (ValueError)              a request that cannot be meant
    ├── ConfigurationError (ValueError)      a configuration or parameter with its list of problems
    ├── DataError (ValueError)               arrays or records that contradict themselves
    │   ├── WireError                        a malformed message
    │   │   └── VersionMismatch              a message of another protocol version
    │   └── RecordingError                   a truncated or foreign recording
    ├── NotFound (LookupError)               no such id, pipeline, plug-in or topic
    ├── StationError (ConnectionError)
    │   ├── NoStation                        nobody serves there
    │   ├── ConnectionLost                   the station was there and is gone
    │   ├── StationBusy                      another one owns the runtime directory or the rig
    │   └── RequestTimeout (TimeoutError)    no answer before the deadline
    ├── LeaseError (PermissionError)         the rig is held by somebody else
    ├── DeviceError (OSError)
    │   ├── DeviceAbsent                     not connected, or gone
    │   ├── DeviceStalled (TimeoutError)     connected and silent
    │   └── ProtocolError (ValueError)       it answered, but not what its protocol allows
    ├── AcquisitionError (RuntimeError)      a set that could not be taken
    │   └── QualityError                     taken, and not good enough (the quality gate)
    ├── StorageError (OSError)               disk full, unwritable, gone
    ├── PluginError (RuntimeError)           a plug-in raised or broke its contract
    │   ├── WorkerLost                       it took its worker down, or hung
    │   └── Quarantined                      given up after repeated failures
    ├── ConvergenceError (ArithmeticError)   a fit or a registration that did not succeed
    └── Cancelled                            stopped because somebody asked

A message says what failed, the value seen, the values allowed and what to do next.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

EXIT_OK = 0
EXIT_FAILURE = 1
EXIT_USAGE = 2
EXIT_NO_STATION = 3
EXIT_HARDWARE = 4
EXIT_QUALITY = 5
EXIT_INTERRUPTED = 130


@dataclass(frozen=True)
class Problem:
    """One thing wrong in a configuration or a parameter set."""

    path: str
    value: str
    allowed: str

    def __str__(self) -> str:
        return f"{self.path}: {self.value} is not allowed; expected {self.allowed}"


class FringedError(Exception):
    """Be the root of every error that is raised on purpose."""

    exit_code: ClassVar[int] = EXIT_FAILURE

    @property
    def message(self) -> str:
        """The text without the decoration that some built-in bases add."""
        return str(self.args[0]) if self.args else type(self).__name__

    def __str__(self) -> str:
        return self.message


class UsageError(FringedError, ValueError):
    """A request that cannot be meant."""

    exit_code = EXIT_USAGE


class ConfigurationError(FringedError, ValueError):
    """A configuration or parameter set; `problems` holds every single one."""

    exit_code = EXIT_USAGE

    def __init__(self, message: str, problems: tuple[Problem, ...] = ()) -> None:
        lines = [message, *(f"  {problem}" for problem in problems)]
        super().__init__("\n".join(lines))
        self.problems = problems


class DataError(FringedError, ValueError):
    """Arrays or records that contradict themselves."""


class WireError(DataError):
    """A malformed message."""


class VersionMismatch(WireError):
    """A message of another protocol version."""


class RecordingError(DataError):
    """A truncated or foreign recording."""


class NotFound(FringedError, LookupError):
    """No such id, pipeline, plug-in or topic."""

    exit_code = EXIT_USAGE


class StationError(FringedError, ConnectionError):
    """Something between a client and its station."""

    exit_code = EXIT_NO_STATION


class NoStation(StationError):
    """Nobody serves there."""


class ConnectionLost(StationError):
    """The station was there and is gone."""


class StationBusy(StationError):
    """Another process owns the runtime directory or the rig."""


class RequestTimeout(StationError, TimeoutError):
    """No answer before the deadline."""


class LeaseError(FringedError, PermissionError):
    """The rig is held by somebody else."""

    exit_code = EXIT_HARDWARE


class DeviceError(FringedError, OSError):
    """A device that does not do what it should."""

    exit_code = EXIT_HARDWARE


class DeviceAbsent(DeviceError):
    """Not connected, or gone."""


class DeviceStalled(DeviceError, TimeoutError):
    """Connected and silent."""


class ProtocolError(DeviceError, ValueError):
    """It answered, but not what its protocol allows."""


class AcquisitionError(FringedError, RuntimeError):
    """A frame set that could not be taken."""

    exit_code = EXIT_HARDWARE


class QualityError(AcquisitionError):
    """Taken, and not good enough."""

    exit_code = EXIT_QUALITY


class StorageError(FringedError, OSError):
    """The disk is full, unwritable or gone."""


class PluginError(FringedError, RuntimeError):
    """A plug-in raised, or broke its contract."""


class WorkerLost(PluginError):
    """A plug-in took its worker down, or hung."""


class Quarantined(PluginError):
    """Given up after repeated failures."""


class ConvergenceError(FringedError, ArithmeticError):
    """A fit or a registration that did not succeed."""

    exit_code = EXIT_QUALITY


class Cancelled(FringedError):
    """Stopped because somebody asked."""

    exit_code = EXIT_INTERRUPTED


def error_classes() -> dict[str, type[FringedError]]:
    """Map the code of every error (its class name) to its class."""
    found: dict[str, type[FringedError]] = {}
    pending: list[type[FringedError]] = [FringedError]
    while pending:
        cls = pending.pop()
        found[cls.__name__] = cls
        pending.extend(cls.__subclasses__())
    return found
