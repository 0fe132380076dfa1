"""Parameters of the optional masks, and their limits in the frames' own grey levels.

Owns names, units and defaults; the masks are in `phase.masks`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import msgspec
from msgspec import Meta

from fringed.hookspecs import Params

if TYPE_CHECKING:
    from fringed_plugins.phase.masks.limits import MaskLimits

_ONE, _PX, _GREY = {"units": "1"}, {"units": "px"}, {"units": "grey level"}
Place = Annotated[list[Annotated[int, Meta(ge=0, le=65535)]], Meta(min_length=2, max_length=2)]


class MaskParams(Params, frozen=True, kw_only=True):
    """Masks that any decoder can apply; all are off by default."""

    hot_pixel_spread: Annotated[
        float,
        Meta(
            ge=0, le=100, description="a pixel is hot that leaves its neighbours' range by this many ranges; 0: off",
            extra_json_schema=_ONE,
        ),
    ] = 0.0  # fmt: skip
    hot_pixel_dn: Annotated[
        float, Meta(ge=0, le=65535, description="and by this much, for 8 bits", extra_json_schema=_GREY)
    ] = 10.0
    hot_pixels: Annotated[
        list[Place], Meta(max_length=4096, description="known hot pixels, [row, column] each", extra_json_schema=_PX)
    ] = msgspec.field(default_factory=list)
    min_contrast: Annotated[
        float,
        Meta(ge=0, le=1, description="modulation over light, less is shadow where there is light; 0: off",
             extra_json_schema=_ONE),
    ] = 0.0  # fmt: skip
    dark_level_dn: Annotated[
        float, Meta(ge=0, le=65535, description="the camera's dark level, for 8 bits", extra_json_schema=_GREY)
    ] = 4.0
    min_region_px: Annotated[
        int, Meta(ge=0, le=10**8, description="smaller islands are dropped; 0: off", extra_json_schema=_PX)
    ] = 0


def mask_limits(
    params: MaskParams, full_dn: float, *, order_median_px: int = 0, repeated: bool = False, down: bool = False
) -> MaskLimits:
    """Return the limits for frames whose full scale is `full_dn`."""
    from fringed_plugins.phase.masks.limits import MaskLimits

    scale = full_dn / 255
    return MaskLimits(
        hot_spread=params.hot_pixel_spread,
        hot_dn=params.hot_pixel_dn * scale,
        hot_pixels=tuple((row, column) for row, column in params.hot_pixels),
        contrast=params.min_contrast,
        dark_dn=params.dark_level_dn * scale,
        region_px=params.min_region_px,
        repeated=repeated,
        order_median_px=order_median_px,
        down=down,
    )
