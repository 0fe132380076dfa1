"""Encoder of number-theoretic sets: periods without a common multiple on the projector.

Owns its parameters; the rules are in `phase.temporal.sets`, the designs in `phase.projection.frequencies`.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from fringed import __version__
from fringed.data import PatternSequence
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.common import FringeParams
from fringed_plugins.encoders.heterodyne import AutoFrames, Snr, Steps, joint_fringes


class NumberTheoreticEncoder:
    """Two or more periods whose phases together are the same at no two columns.

    Periods in whole pixels without a common divisor repeat only after their product; others do as well, as long
    as no two columns of the projector share all phases. What counts against noise is how far apart
    the phases of different columns are.

    References
    ----------
    Gushov & Solodkin 1991; Petkovic, Pribanic & Donlic 2016, 2017; Zuo et al. 2016, section 5.
    """

    name: ClassVar[str] = "number-theoretic"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N-step sinusoidal fringes of periods without a common multiple"
    decoders: ClassVar[tuple[str, ...]] = ("number-theoretic", "heterodyne")

    class Params(FringeParams, frozen=True, kw_only=True):
        """Parameters."""

        periods_px: Annotated[
            list[Annotated[float, Meta(gt=0, le=65536)]] | Literal["auto"],
            Meta(
                description="long to short; auto: the best for frames and expected_snr",
                extra_json_schema={"units": "px"},
            ),
        ] = "auto"
        steps: Steps = 4
        frames: AutoFrames = 12
        expected_snr: Snr = 12.0

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the patterns group by group, long periods first.

        Raises
        ------
        UsageError
            a combination that cannot be decoded, with the reason and what to use instead.
        """
        from fringed_plugins.phase.projection.frequencies import design_number_theoretic

        def given(_: int) -> list[float] | None:
            return None if params.periods_px == "auto" else list(params.periods_px)

        return joint_fringes(self, params, target, given, design_number_theoretic)
