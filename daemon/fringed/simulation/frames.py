"""Geometry and light to the electrons of one exposure.

Owns the call of the exposing kernel and the camera lens's blur; knows nothing of noise and time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fringed.data import Float32Array
from fringed.simulation.geometry import Geometry
from fringed.simulation.light import LINE_SAMPLES, PICTURE_SAMPLES, Light, blend
from fringed.simulation.rows import for_rows


def exposed(
    geometry: Geometry, lights: Sequence[tuple[float, Light]], scale: tuple[float, float], blur_px: float
) -> Float32Array:
    """Return the mean electrons (height, width) of an exposure.

    `lights` are weighted, `scale` the electrons of the projector's white and of ambient light on a white plane.
    """
    from fringed.simulation.frame_kernels import expose_rows

    light = blend(lights)
    known = (geometry.gain, geometry.base, geometry.level, geometry.column, geometry.row)
    tables = (light.columns, light.rows, light.picture)
    scales = (*scale, float(LINE_SAMPLES), float(PICTURE_SAMPLES))
    out = np.empty(geometry.gain.shape, np.float32)
    for_rows(len(out), lambda first, end: expose_rows(first, end, known, tables, scales, out))
    if blur_px > 0:
        import cv2

        out = np.asarray(cv2.GaussianBlur(out, (0, 0), blur_px, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)
    return out
