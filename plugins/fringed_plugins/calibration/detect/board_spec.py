"""What is looked for, and what was found.

Owns the types that the steps of detection hand on; knows nothing of how boards are described elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
Kind = Literal["circles-five", "circles", "asymmetric-circles", "chessboard", "charuco"]


@dataclass(frozen=True)
class BoardSpec:
    """A board: `points_mm` (n, 3) row by row, `diameters_mm` (n,), `big` (n,) bool; `charuco` is OpenCV's own board."""

    kind: Kind
    columns: int
    rows: int
    pitch_mm: float
    points_mm: Float64Array
    diameters_mm: Float64Array
    big: npt.NDArray[np.bool_]
    dark_marks: bool = True
    charuco: Any = None


@dataclass(frozen=True)
class Limits:
    """What a view has to be like; lengths in px, tilt in degrees, the others are shares."""

    min_diameter_px: float = 8.0
    max_blur_px: float = 3.0
    min_contrast: float = 0.15
    max_tilt_deg: float = 65.0
    max_saturated: float = 0.02
    min_points: int = 12


@dataclass(frozen=True)
class Detection:
    """The points found: `index` (n,) of the board, `px` (n, 2), `sigma_px` (n,), `ellipses` (n, 5) or (0, 5).

    `quality` has figures of the view; `problems` what is wrong with it, worst first; `reason` why it is of no use;
    `decided` that nothing else needs to be thought of.
    """

    found: bool
    reason: str = ""
    index: npt.NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    px: Float64Array = field(default_factory=lambda: np.zeros((0, 2)))
    sigma_px: Float64Array = field(default_factory=lambda: np.zeros(0))
    ellipses: Float64Array = field(default_factory=lambda: np.zeros((0, 5)))
    quality: Mapping[str, float] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    decided: bool = False
