"""Which side of a view's surface is outside: that of the sensor.

Owns the decision for grids whose rows run upwards or whose points are not in the camera's frame: their normals, made
from rows and columns, may point into the object, and a volume of signed distances would be inside out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.meshing.volume import Seen
from fringed_plugins.registration.transforms import FloatArray, apply, turned

Array = npt.NDArray[Any]
AT_ORIGIN = 0.2  # of its distance, how far the fitted projection's centre may be from the frame's origin
_SAMPLES = 5000


def outward(views: Sequence[Seen]) -> list[Seen]:
    """Return the views with all normals to the outside.

    Where the range image's own projection has its centre at the frame's origin, the sensor is there. The other views
    are turned together, if need be, so that their normals point away from the middle of all points: the sign of the
    volume that they enclose.
    """
    known = [_towards_sensor(seen) for seen in views]
    centre = np.mean([_middle(seen) for seen in views], axis=0)
    volume = sum(_volume(seen, centre) for seen, side in zip(views, known, strict=True) if side == 0)
    return [
        _flipped(seen) if side < 0 or (side == 0 and volume < 0) else seen
        for seen, side in zip(views, known, strict=True)
    ]


def _towards_sensor(seen: Seen) -> int:
    """Return 1 where normals face the sensor, -1 where they face away, 0 where it is not known where it is."""
    P, origin = seen.patches.projection, seen.patches.surface.origin
    distance = float(np.linalg.norm(origin))
    centre = -np.linalg.lstsq(P[:, :3], P[:, 3], rcond=1e-12)[0]
    if not distance > 0 or np.linalg.norm(centre + origin) > AT_ORIGIN * distance:
        return 0
    points, normals, _ = _some(seen)
    return -int(np.sign(np.einsum("ij,ij->i", points + origin, normals).sum())) or 1


def _some(seen: Seen) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points, normals and areas of some patches, in the view's frame about its origin."""
    at = np.flatnonzero(seen.weights > 0)
    patch = seen.patches.table.reshape(-1, 15)[at[:: max(1, len(at) // _SAMPLES)]].astype(np.float64)
    across = np.cross(patch[:, 3:6], patch[:, 6:9])
    return patch[:, :3], patch[:, 9:12], np.sqrt(np.einsum("ij,ij->i", across, across)) * max(1, len(at) // _SAMPLES)


def _middle(seen: Seen) -> FloatArray:
    middle: FloatArray = apply(seen.T_model_centred, _some(seen)[0]).mean(0)
    return middle


def _volume(seen: Seen, centre: FloatArray) -> float:
    """Return the volume of the cone from `centre` to the view's surface, negative where its normals face inwards."""
    points, normals, areas = _some(seen)
    off = apply(seen.T_model_centred, points) - centre
    return float((areas * np.einsum("ij,ij->i", off, turned(seen.T_model_centred[:3, :3], normals))).sum() / 3)


def _flipped(seen: Seen) -> Seen:
    """Return a view with its normals, and with them its second fundamental forms, turned round; the given one stays."""
    table = seen.patches.table.copy()
    table[seen.patches.usable, 9:15] *= -1  # the others hold nothing
    return replace(seen, patches=replace(seen.patches, table=table))
