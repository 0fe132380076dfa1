"""One request on its way, and how its parameters are read with clear errors.

Owns the reading of `Request.params`; knows no socket. A verb gets a `Call`, and answers it now by returning a
value or later by `Call.reply`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from fringed.errors import ConfigurationError, FringedError, Problem, UsageError
from fringed.messages import ErrorInfo, Request

T = TypeVar("T")
_REQUIRED: Any = object()
_NAMES = {str: "text", float: "a number", int: "an integer", bool: "true or false", dict: "a table", list: "a list"}


class Later:
    """What a verb returns that answers later."""


LATER = Later()


@dataclass(eq=False)
class Call:
    """One request and the way back to who asked."""

    request: Request
    answer: Callable[[Any, ErrorInfo | None], None]
    deadline_s: float  # on the reactor's clock
    remote: bool = False  # came over TCP
    answered: bool = False

    def reply(self, result: Any) -> None:
        """Answer with a result, or with a whole `Reply` that was encoded elsewhere; only the first answer counts."""
        self._finish(result, None)

    def fail(self, error: BaseException) -> None:
        """Answer with an error; only the first answer counts."""
        self._finish(None, error_info(error))

    def refuse(self, error: ErrorInfo) -> None:
        """Answer with an error that somebody else has told; only the first answer counts."""
        self._finish(None, error)

    def _finish(self, result: Any, error: ErrorInfo | None) -> None:
        if not self.answered:
            self.answered = True
            self.answer(result, error)

    def allow(self, *names: str) -> None:
        """Refuse parameters that the verb does not know; raises UsageError."""
        unknown = sorted(set(self.request.params) - set(names))
        if unknown:
            takes = ", ".join(sorted(names)) or "nothing"
            raise UsageError(f"{self.request.verb} does not know {', '.join(unknown)}; it takes {takes}")

    def get(self, name: str, kind: type[T], default: Any = _REQUIRED) -> T:
        """Return a parameter of that type; raises UsageError."""
        value = self.request.params.get(name)
        if value is None:
            if default is _REQUIRED:
                raise UsageError(f"{self.request.verb} needs the parameter {name!r}: {_NAMES[kind]}")
            return default  # type: ignore[no-any-return]
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        wanted: Any = Mapping if kind is dict else (list, tuple) if kind is list else kind
        if not isinstance(value, wanted) or (isinstance(value, bool) and kind is not bool):
            raise UsageError(f"{self.request.verb}: {name} is {str(value)[:80]!r}; expected {_NAMES[kind]}")
        if isinstance(value, float) and not math.isfinite(value):
            raise UsageError(f"{self.request.verb}: {name} is {value}; expected a finite number")
        return value  # type: ignore[no-any-return]

    def within(self, name: str, low: float, high: float, default: Any = _REQUIRED) -> float:
        """Return a number between two limits; raises UsageError."""
        value = self.get(name, float, default)
        if not low <= value <= high:
            raise UsageError(f"{self.request.verb}: {name} is {value:g}; expected {low:g} to {high:g}")
        return value


def error_info(error: BaseException) -> ErrorInfo:
    """Return an error as it travels: its class's name, its text, its problems."""
    if isinstance(error, ConfigurationError):
        return ErrorInfo("ConfigurationError", error.message, tuple(map(str, error.problems)))
    if isinstance(error, FringedError):
        return ErrorInfo(type(error).__name__, error.message)
    return ErrorInfo("FringedError", f"the daemon made a mistake: {type(error).__name__}: {error}")


def problem(path: str, value: Any, allowed: str) -> ConfigurationError:
    """Return the error of one wrong value."""
    found = Problem(path, repr(value)[:80], allowed)
    return ConfigurationError(f"1 problem in {path}:", (found,))


Verb = Callable[[Call], Any]
