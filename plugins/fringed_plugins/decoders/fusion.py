"""Fusion of phase maps that were taken with different exposures or grey levels: high dynamic range.

Owns its parameters and what maps have to have in common; the arithmetic is in `phase.exposure.fusion`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context

if TYPE_CHECKING:
    from fringed_plugins.phase.exposure.fusion import ExposedMap, Light

_SAME = ("kind", "period_px", "orientation", "initial_phase_rad", "projector_px", "difference_to")


class FuseExposures:
    """One phase map of several, each pixel from the exposures that show it, weighted by their noise.

    The maps' relative light is measured from the pixels that they share, so that it does not matter whether exposure,
    aperture or the patterns' grey level was changed.

    References
    ----------
    Zhang & Yau, Opt. Eng. 48 (2009) 033604 (fringes at several exposures); the weights are those of the
    maximum-likelihood mean.
    """

    name: ClassVar[str] = "fuse-exposures"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "phase maps of several exposures or grey levels to one"
    inputs: ClassVar[Mapping[str, Any]] = {"maps": (PhaseMap,)}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        scales: Annotated[
            list[Annotated[float, Meta(gt=0, le=1e6)]],
            Meta(description="relative light of each map, in their order; empty: measured from shared pixels"),
        ] = msgspec.field(default_factory=list)
        max_difference_sigma: Annotated[
            float,
            Meta(
                gt=0,
                le=1000,
                description="largest difference between two maps, in standard deviations of it",
                extra_json_schema={"units": "1"},
            ),
        ] = 6.0
        max_systematic_rad: Annotated[
            float,
            Meta(
                ge=0,
                le=3,
                description="what two maps may differ beside their noise",
                extra_json_schema={"units": "rad"},
            ),
        ] = 0.05
        ignored_sigma_ratio: Annotated[
            float,
            Meta(
                ge=1,
                le=1000,
                description="a map whose deviation is that many times the best one's has no say",
                extra_json_schema={"units": "1"},
            ),
        ] = 4.0

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the fused map.

        Raises
        ------
        DataError
            fewer than two maps, maps of other fringes or without a deviation, or scales for other maps.
        """
        from fringed_plugins.phase.exposure.fusion import FusionLimits, fuse, relative_light

        maps = _checked(inputs.get("maps"))
        arrays = [_arrays(one) for one in maps]
        context.check_cancelled()
        limits = FusionLimits(params.max_difference_sigma, params.max_systematic_rad, params.ignored_sigma_ratio)
        try:
            light = _given_light(params.scales, len(maps)) if params.scales else relative_light(arrays)
            fused = fuse(arrays, maps[0].kind == "wrapped", light, limits, context.threads)
        except ValueError as error:
            raise DataError(f"{self.name}: {error}") from error
        _tell(light, float(np.mean(fused.rejected == 0)), context)
        return _map_of(maps[0], fused)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernel for two and three maps."""
        from fringed_plugins.phase.exposure.fusion import ExposedMap, Light, fuse

        flat, none = np.ones((8, 8), np.float32), np.zeros((0, 0), np.float32)
        one = ExposedMap(flat, flat, flat, flat, none, np.zeros((8, 8), np.uint16))
        for count in (2, 3):
            fuse([one] * count, False, [Light(1.0, 0.0)] * count, threads=1)


def _tell(light: Sequence[Light], kept: float, context: Context) -> None:
    guessed = [str(index) for index, one in enumerate(light) if not one.measured]
    if guessed:
        context.log(
            "warning",
            f"map {', '.join(guessed)} shares too few pixels with the others to compare its light; its phase counts, "
            "its modulation and background are on a guessed scale",
        )
    told = ", ".join(f"{1 / one.gain:.3g}" for one in light)
    context.log("info", f"relative light of the maps: {told}; kept {kept:.1%} of the pixels")


def _map_of(first: PhaseMap, fused: ExposedMap) -> PhaseMap:
    """Return the fused arrays as a map of the same fringes as `first`."""
    return PhaseMap(
        phase_rad=fused.phase_rad,
        modulation=fused.modulation,
        background=fused.background,
        rejected=fused.rejected,
        kind=first.kind,
        period_px=first.period_px,
        orientation=first.orientation,
        initial_phase_rad=first.initial_phase_rad,
        sigma_rad=fused.sigma_rad,
        difference_to=first.difference_to,
        projector_px=first.projector_px,
        confidence=fused.confidence if fused.confidence.size else None,
    )


def _checked(maps: Any) -> Sequence[PhaseMap]:
    if not isinstance(maps, (list, tuple)) or not all(isinstance(one, PhaseMap) for one in maps) or len(maps) < 2:
        count = len(maps) if isinstance(maps, (list, tuple)) else 0
        raise DataError(f"fuse-exposures takes two or more phase maps named 'maps'; it was given {count}")
    for index, one in enumerate(maps):
        if one.sigma_rad is None:
            raise DataError(
                f"map {index} ({one.id or 'without id'}) has no sigma_rad, which weighs it; decode it again"
            )
        other = [f"{name} is {getattr(one, name)!r}, not {getattr(maps[0], name)!r}" for name in _SAME
                 if getattr(one, name) != getattr(maps[0], name)]  # fmt: skip
        if other:
            raise DataError(f"map {index} is of other fringes than the first: {'; '.join(other)}")
        if one.kind == "relative":
            raise DataError("relative phases have a multiple of 2 pi of their own each; fuse wrapped or absolute ones")
    return maps


def _arrays(one: PhaseMap) -> ExposedMap:
    from fringed_plugins.phase.exposure.fusion import ExposedMap

    none = np.zeros((0, 0), np.float32)
    sigma = one.sigma_rad if one.sigma_rad is not None else none
    confidence = one.confidence if one.confidence is not None else none
    return ExposedMap(one.phase_rad, sigma, one.modulation, one.background, confidence, one.rejected)


def _given_light(scales: Sequence[float], count: int) -> list[Light]:
    from fringed_plugins.phase.exposure.fusion import Light

    if len(scales) != count:
        raise ValueError(f"{len(scales)} scales are given for {count} maps; give one for each, or none")
    return [Light(min(scales) / scale, 0.0) for scale in scales]
