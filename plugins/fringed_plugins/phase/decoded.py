"""What a decoder returns, and when it drops a pixel.

Owns two plain types that the kernels' callers share.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.phase.masks.limits import MaskLimits

Float32Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Thresholds:
    """When a pixel is dropped; each can be switched off by its extreme value.

    `modulation_dn` and `modulation_snr` bound the modulation of every frequency from below, absolute and
    over the noise of one frame; `residual` bounds the misfit to a sinusoid as a part of the modulation,
    over what six sigma of noise and the harmonics of a projector of this `gamma` explain; `order_turns` the
    difference between the phase that a coarser frequency predicts and the one measured; `modulation_drop` the
    finest over the coarsest modulation; `edge_px` how near to the projector's border a column may be;
    `similar_neighbours` how many of the 24 neighbours must be alike, within half a period; `border_glow` the
    modulation over the brightest neighbour's below which a pixel at the border of what is lit shows that neighbour's
    light; `window_snr` the modulation over the noise, averaged over 5 x 5 px, from which on neighbours may settle a
    fringe order; 0: never. `masks` are the optional ones.
    """

    saturation_dn: float = float("inf")
    modulation_dn: float = 3.0
    modulation_snr: float = 5.0
    residual: float = 0.1
    gamma: float = 1.0
    order_turns: float = 0.3
    modulation_drop: float = 0.0
    edge_px: float = 0.5
    similar_neighbours: int = 6
    border_glow: float = 0.4
    window_snr: float = 1.0
    masks: MaskLimits = MaskLimits()  # noqa: RUF009 (frozen)


_NOT_KEPT = np.empty((0, 0), np.float32)


class Decoded(NamedTuple):
    """Arrays of `(height, width)`: float32 and the uint16 mask; what was not asked for is (0, 0).

    `residual` is the root mean square of the finest group's residual components in grey levels, one frame's noise
    where nothing is wrong. `confidence` is by how many standard deviations the least certain fringe order is not the
    next one; infinite where there was none to choose.
    """

    phase_rad: Float32Array
    sigma_rad: Float32Array
    modulation: Float32Array
    background: Float32Array
    wrapped_rad: Float32Array
    rejected: npt.NDArray[np.uint16]
    residual: Float32Array = _NOT_KEPT
    confidence: Float32Array = _NOT_KEPT
