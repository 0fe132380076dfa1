"""Encoders of sinusoidal fringes: one frequency, and several from coarse to fine.

Owns their parameters; the arithmetic is in `phase.patterns`.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

from fringed import __version__
from fringed.data import PatternSequence
from fringed.errors import UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.common import FringeParams, length_px, sinusoids
from fringed_plugins.phase import patterns


class PhaseShiftEncoder:
    """N-step phase shifting with one frequency: a wrapped phase.

    References
    ----------
    thesis.md, section 2; Zuo et al. 2018.
    """

    name: ClassVar[str] = "phase-shift"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N-step sinusoidal fringes of one frequency"
    decoders: ClassVar[tuple[str, ...]] = ("phase-shift",)

    class Params(FringeParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            float, Meta(gt=0, le=4096, description="across the projector", extra_json_schema={"units": "periods"})
        ] = 48.0
        steps: Annotated[int, Meta(ge=3, le=64, description="equal phase steps", extra_json_schema={"units": "1"})] = 6
        initial_phase_rad: Annotated[
            float, Meta(ge=-7, le=7, description="phase of the first column", extra_json_schema={"units": "rad"})
        ] = 0.0

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return `steps` patterns of one group.

        Raises
        ------
        UsageError
            a combination that cannot be decoded, with the reason.
        """
        try:
            patterns.check_steps(params.steps)
            patterns.check_period(length_px(target, params.orientation), params.periods)
        except ValueError as error:
            raise UsageError(f"phase-shift: {error}") from error
        return sinusoids(self, params, target, [params.periods], [params.steps], params.initial_phase_rad)


class MultiFrequencyEncoder:
    """Several frequencies, each with N steps, from one period to many: an absolute phase.

    References
    ----------
    Zuo et al. 2016, section 3 (hierarchical temporal unwrapping).
    """

    name: ClassVar[str] = "multi-frequency"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N-step sinusoidal fringes of several frequencies, coarse to fine"
    decoders: ClassVar[tuple[str, ...]] = ("multi-frequency",)

    class Params(FringeParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            list[Annotated[int, Meta(ge=1, le=4096)]],
            Meta(min_length=1, max_length=16, description="across the projector, coarse to fine, starting with 1"),
        ] = msgspec.field(default_factory=lambda: [1, 8, 64])
        steps: Annotated[
            Annotated[int, Meta(ge=3, le=64)] | list[Annotated[int, Meta(ge=3, le=64)]],
            Meta(description="equal phase steps: one number, or one for each frequency"),
        ] = 4
        expected_snr: Annotated[
            float,
            Meta(gt=0, le=1e4, description="modulation over the noise of a frame", extra_json_schema={"units": "1"}),
        ] = 20.0

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the patterns group by group, coarse to fine.

        Raises
        ------
        UsageError
            a combination that cannot be decoded, with the reason and what to use instead.
        """
        steps = [params.steps] * len(params.periods) if isinstance(params.steps, int) else list(params.steps)
        length = length_px(target, params.orientation)
        try:
            patterns.check_frequencies(length, params.periods, steps, params.expected_snr)
        except ValueError as error:
            raise UsageError(f"multi-frequency: {error}") from error
        return sinusoids(self, params, target, params.periods, steps, 0.0)
