"""When the optional masks drop a pixel. Owns one plain type that decoders and `cleaning` share."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MaskLimits:
    """Limits of the optional masks; each is off by default.

    `hot_spread` and `hot_dn` are those of `hot.flag_hot`, off at 0; `hot_pixels` are (row, column) known
    beforehand. `contrast` is the modulation over the light below which a pixel is in shadow, `dark_dn` the camera's
    dark level. `region_px` is the size of the smallest island that stays; `repeated` keeps one camera pixel for each
    projector pixel; `order_median_px` is the window of the order's median. `down`: runs of repeated pixels go along
    camera columns.
    """

    hot_spread: float = 0.0
    hot_dn: float = 10.0
    hot_pixels: tuple[tuple[int, int], ...] = ()
    contrast: float = 0.0
    dark_dn: float = 4.0
    region_px: int = 0
    repeated: bool = False
    order_median_px: int = 0
    down: bool = False
