"""What one pose of a calibration board showed: its points in the camera's and in the projector's picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fringed.data.arrays import Float64Array, Frozen, Int32Array, Provenance, UInt8Array
from fringed.errors import DataError


@dataclass(frozen=True)
class BoardView(Frozen):
    """The points of a board that one pose shows, or why there are none.

    `board` describes it (`fringed.boards.Board`). Row i is the board's point `index[i]`: `camera_px` (n, 2) its place
    in the camera's picture, `camera_sigma_px` (n,) how well that is known along each axis. For circles it is the
    centre of the ellipse as seen, which is not the picture of the circle's centre: `ellipses` (n, 5) has centre, half
    axes (px) and the angle (rad) of the first one; (0, 5) for corners. `projector_px` (n, 2) is the projector's
    column and row at `camera_px`, NaN where unknown, `projector_sigma_px` (n, 2) its deviation, `projector_jacobian`
    (n, 2, 2) its derivative by the camera's x and y. `light` (n,) or (0,) is the grey level of the ground beside each
    point, 0 where unknown. `quality` has figures of the view (`blur_px`, `contrast`, `saturated`, `tilt_deg`,
    `coverage` ...), `problems` what is wrong with it, worst first. `picture` (h, w) uint8 shows the board, reduced by
    `picture_step`.
    """

    board: Mapping[str, Any]
    camera_size_px: tuple[int, int]
    projector_size_px: tuple[int, int]
    found: bool
    reason: str = ""
    index: Int32Array = field(default_factory=lambda: np.zeros(0, np.int32))
    camera_px: Float64Array = field(default_factory=lambda: np.zeros((0, 2)))
    camera_sigma_px: Float64Array = field(default_factory=lambda: np.zeros(0))
    ellipses: Float64Array = field(default_factory=lambda: np.zeros((0, 5)))
    projector_px: Float64Array = field(default_factory=lambda: np.zeros((0, 2)))
    projector_sigma_px: Float64Array = field(default_factory=lambda: np.zeros((0, 2)))
    projector_jacobian: Float64Array = field(default_factory=lambda: np.zeros((0, 2, 2)))
    light: Float64Array = field(default_factory=lambda: np.zeros(0))
    quality: Mapping[str, float] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    picture: UInt8Array | None = None
    picture_step: int = 1
    name: str = ""
    id: str = ""
    scan: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        count = len(self.index)
        shapes = {
            "camera_px": (count, 2), "camera_sigma_px": (count,), "projector_px": (count, 2),
            "projector_sigma_px": (count, 2), "projector_jacobian": (count, 2, 2),
        }  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise DataError(f"board view: {name} has shape {getattr(self, name).shape}; expected {shape}")
        if self.ellipses.shape not in ((count, 5), (0, 5)):
            raise DataError(f"board view: ellipses have shape {self.ellipses.shape}; expected ({count}, 5) or (0, 5)")
