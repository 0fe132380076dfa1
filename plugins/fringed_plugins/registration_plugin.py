"""Registers registration and merging; the processors are in `registrars`, the mathematics in `registration`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fringed.hookspecs import hookimpl
from fringed_plugins.registrars.model import Merge
from fringed_plugins.registrars.pair import Register


@hookimpl
def register_processors() -> Sequence[type[Any]]:
    """Return the processors of registration."""
    return [Register, Merge]
