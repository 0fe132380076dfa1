"""Registers the processors of this plug-in; fringed finds it by its entry point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from example_plugin.carre import CarreDecoder
from example_plugin.trimmed_icp import TrimmedIcp
from fringed.hookspecs import hookimpl

__version__ = "0.1.0"


@hookimpl
def register_processors() -> Sequence[type[Any]]:
    """Return the processors."""
    return [CarreDecoder, TrimmedIcp]
