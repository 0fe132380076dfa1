"""What is printed on a flat sheet, as each camera pixel sees it.

Owns the mean of the print over a pixel's footprint: exact for straight edges, and for circles but for a part of their
curvature that cannot move their centre. Knows nothing of light: it multiplies what the blank sheet gives.
"""

from __future__ import annotations

import numpy as np

from fringed.data import Float64Array
from fringed.simulation.geometry import Geometry
from fringed.simulation.rows import for_rows
from fringed.simulation.shapes.board import T_OBJECT_BOARD
from fringed.simulation.shapes.shape import Print


def apply_print(geometry: Geometry, printed: Print, lens: Float64Array) -> None:
    """Multiply gain and base of the pixels that see the sheet's front; its back is blank."""
    from fringed.simulation.print_kernels import Marks, print_rows, sheet_rows

    pose = geometry.T_camera_object @ T_OBJECT_BOARD
    if pose[:3, 2] @ pose[:3, 3] <= 0:  # seen from behind
        return
    height, width = geometry.gain.shape
    place = np.empty((2, height + 2, width + 2))  # one pixel more on each side: derivatives are of neighbours
    for_rows(height + 2, lambda first, end: sheet_rows((first, end), lens, pose, 1 / printed.scale_x, place))
    marks = Marks(
        printed.discs, printed.boxes, np.array(printed.albedo), printed.place, printed.cells[0], printed.cells[1],
        printed.starts[0], printed.items[0], printed.starts[1], printed.items[1],
    )  # fmt: skip
    for_rows(
        height,
        lambda first, end: print_rows((first, end), place, marks, (geometry.gain, geometry.base, geometry.flags)),
    )
