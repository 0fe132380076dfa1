"""Clients of a station: Python (`Station`, `AsyncStation`), notebooks (`show`) and the command line.

    from fringed_client import Station

    with Station() as station:
        xyz_mm = station.scan().range_image.xyz_mm

Names are imported when they are first used, so that the command line starts quickly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fringed_client.address import Address
    from fringed_client.aio import AsyncStation
    from fringed_client.html import show
    from fringed_client.protocol.messages import Message
    from fringed_client.results import ScanResult
    from fringed_client.station import Station

_HOMES = {
    "Address": "fringed_client.address",
    "AsyncStation": "fringed_client.aio",
    "Message": "fringed_client.protocol.messages",
    "ScanResult": "fringed_client.results",
    "Station": "fringed_client.station",
    "show": "fringed_client.html",
}

__all__ = ["Address", "AsyncStation", "Message", "ScanResult", "Station", "show"]


def __getattr__(name: str) -> Any:
    """Import `name` from its module when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
