"""A view that can be registered, whatever it is made of."""

from __future__ import annotations

from typing import Protocol

from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray


class Scan(Protocol):
    """What a registration needs of a view, with a grid (`Surface`) or without (`clouds.CloudSurface`)."""

    @property
    def name(self) -> str:
        """What messages call it."""
        ...

    @property
    def origin(self) -> FloatArray:
        """Where its levels' points are relative to."""
        ...

    @property
    def spacing_mm(self) -> float:
        """The distance of neighbours."""
        ...

    @property
    def diagonal_mm(self) -> float:
        """The extent."""
        ...

    def level(self, most_points: int) -> Level:
        """Return at most about so many points with normals."""
        ...
