"""Registers the fringe methods: phase shifting, multi-frequency, and the unwrapped difference.

Owns parameters and the translation between the contract's types and arrays; the algorithms are in
`phase` and `unwrap`, and are imported when first used, since compiling kernels takes time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fringed.hookspecs import hookimpl
from fringed_plugins.decoders.colour import MeasureCrosstalk
from fringed_plugins.decoders.correction import CorrectPhase, HarmonicCorrection, PhaseErrorTableMaker
from fringed_plugins.decoders.exposures import SuggestExposures
from fringed_plugins.decoders.fourier import FourierDecoder
from fringed_plugins.decoders.fusion import FuseExposures
from fringed_plugins.decoders.gray import GrayCodeDecoder, GrayPhaseShiftDecoder
from fringed_plugins.decoders.heterodyne import HeterodyneDecoder
from fringed_plugins.decoders.levels import FuseLevels
from fringed_plugins.decoders.number_theoretic import NumberTheoreticDecoder
from fringed_plugins.decoders.one_shot import OneShotFrequenciesDecoder, OneShotPhaseShiftDecoder
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.decoders.tone import ToneResponse, ToneVerify
from fringed_plugins.decoders.unknown_shifts import UnknownShiftsDecoder
from fringed_plugins.decoders.unwrapping import Unwrap, UnwrapDifference
from fringed_plugins.decoders.windowed_fourier import WindowedFourier
from fringed_plugins.encoders.fourier import FourierEncoder
from fringed_plugins.encoders.gray import GrayCodeEncoder, GrayPhaseShiftEncoder
from fringed_plugins.encoders.grey_ramp import GreyRampEncoder
from fringed_plugins.encoders.heterodyne import HeterodyneEncoder
from fringed_plugins.encoders.number_theoretic import NumberTheoreticEncoder
from fringed_plugins.encoders.one_shot import ColourBarsEncoder, OneShotFrequenciesEncoder, OneShotPhaseShiftEncoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder


@hookimpl
def register_patterns() -> Sequence[type[Any]]:
    """Return the encoders."""
    return (
        PhaseShiftEncoder,
        MultiFrequencyEncoder,
        HeterodyneEncoder,
        NumberTheoreticEncoder,
        GrayCodeEncoder,
        GrayPhaseShiftEncoder,
        FourierEncoder,
        ColourBarsEncoder,
        OneShotFrequenciesEncoder,
        OneShotPhaseShiftEncoder,
        GreyRampEncoder,
    )


@hookimpl
def register_processors() -> Sequence[type[Any]]:
    """Return the decoders and the unwrapping."""
    return (
        PhaseShiftDecoder,
        MultiFrequencyDecoder,
        HeterodyneDecoder,
        NumberTheoreticDecoder,
        GrayCodeDecoder,
        GrayPhaseShiftDecoder,
        UnwrapDifference,
        Unwrap,
        FourierDecoder,
        FuseExposures,
        FuseLevels,
        SuggestExposures,
        WindowedFourier,
        UnknownShiftsDecoder,
        MeasureCrosstalk,
        OneShotFrequenciesDecoder,
        OneShotPhaseShiftDecoder,
        ToneResponse,
        ToneVerify,
        PhaseErrorTableMaker,
        CorrectPhase,
        HarmonicCorrection,
    )
