"""What a decoder returns, and when it drops a pixel.

Owns two plain types that the kernels' callers share.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Thresholds:
    """When a pixel is dropped; each can be switched off by its extreme value.

    `modulation_dn` and `modulation_snr` bound the modulation of every frequency from below, absolute and
    over the noise of one frame; `residual` bounds the misfit to a sinusoid as a part of the modulation,
    over what six sigma of noise explain; `order_turns` the difference between the phase that a coarser
    frequency predicts and the one measured; `modulation_drop` the finest over the coarsest modulation;
    `edge_px` how near to the projector's border a column may be; `similar_neighbours` how many of the
    24 neighbours must be alike, within half a period; `border_glow` the modulation over the brightest
    neighbour's below which a pixel at the border of what is lit shows that neighbour's light.
    """

    saturation_dn: float = float("inf")
    modulation_dn: float = 3.0
    modulation_snr: float = 5.0
    residual: float = 0.1
    order_turns: float = 0.3
    modulation_drop: float = 0.0
    edge_px: float = 0.5
    similar_neighbours: int = 6
    border_glow: float = 0.4


class Decoded(NamedTuple):
    """Arrays of `(height, width)`: float32 and the uint16 mask; `wrapped_rad` is (0, 0) unless asked for."""

    phase_rad: Float32Array
    sigma_rad: Float32Array
    modulation: Float32Array
    background: Float32Array
    wrapped_rad: Float32Array
    rejected: npt.NDArray[np.uint16]
