"""Which exposures a scene needs, as a small document: what `fringe exposure` shows.

Owns its parameters and the document's keys; the choice is `phase.exposure.exposures`'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Artifact, FrameSet
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.decoders.common import full_scale_dn

if TYPE_CHECKING:
    from fringed_plugins.phase.exposure.exposures import Brightness, SensorModel, Suggestion

_BINS = 60


class SuggestExposures:
    """Suggest exposures from sets of equal phase steps, taken with one exposure or, better, with several.

    The result is a JSON document: `exposures_us` are the fewest that do, `three_us` three of them for the pipeline
    hdr, `histogram` counts pixels by the exposure that brings them to full scale.
    """

    name: ClassVar[str] = "suggest-exposures"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "exposures that show all of a scene, from fringes taken with some"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": (FrameSet,)}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Artifact

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        snr: Annotated[
            float,
            Meta(gt=0, le=1000, description="wanted modulation over a frame's noise", extra_json_schema={"units": "1"}),
        ] = 20.0
        peak: Annotated[
            float,
            Meta(gt=0.1, le=1, description="brightest allowed part of full scale", extra_json_schema={"units": "1"}),
        ] = 0.92
        share: Annotated[
            float,
            Meta(gt=0, le=1, description="of the pixels with fringes to serve", extra_json_schema={"units": "1"}),
        ] = 0.99
        dimmest: Annotated[
            float,
            Meta(
                ge=0,
                lt=1,
                description="pixels dimmer than this part of the brightest hundredth are not asked for",
                extra_json_schema={"units": "1"},
            ),
        ] = 0.01
        most: Annotated[int, Meta(ge=1, le=8, description="exposures at most")] = 4
        black_dn: Annotated[
            float, Meta(ge=0, le=1000, description="black level, for 8 bits", extra_json_schema={"units": "grey level"})
        ] = 2.0
        shortest_us: Annotated[
            float, Meta(gt=0, le=1e7, description="of the camera", extra_json_schema={"units": "us"})
        ] = 10.0
        longest_us: Annotated[
            float, Meta(gt=0, le=1e7, description="of the camera", extra_json_schema={"units": "us"})
        ] = 1e6

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Artifact:
        """Return the document.

        Raises
        ------
        DataError
            sets that are none, differ in size or gain, have no equal steps, or show no fringes at all.
        """
        from fringed_plugins.phase.exposure.exposures import Wanted, brightness, suggest_exposures

        sets = _checked(inputs.get("frames"))
        context.check_cancelled()
        if params.shortest_us >= params.longest_us:
            raise DataError(
                f"shortest_us is {params.shortest_us:g} and longest_us {params.longest_us:g}; it has to be less"
            )
        sensor = _sensor(sets[0], params.black_dn)
        wanted = Wanted(
            params.snr, params.peak, params.share, params.dimmest, params.most, params.shortest_us, params.longest_us
        )
        try:
            light = brightness([_steps(one) for one in sets], [one.settings.exposure_us for one in sets], sensor)
            fewest = suggest_exposures(light, sensor, wanted)
            three = _three(fewest) or suggest_exposures(light, sensor, wanted, exactly=3).exposures_us
        except ValueError as error:
            raise DataError(f"{self.name}: {error}") from error
        document = _document(sets, light, sensor, (fewest, three), params.share)
        content = np.frombuffer(msgspec.json.format(msgspec.json.encode(document)), np.uint8)
        return Artifact("exposures.json", "application/json", content)


def _three(fewest: Suggestion) -> tuple[float, ...]:
    """Return two exposures with one between them, none where they are not two."""
    if len(fewest.exposures_us) != 2:
        return fewest.exposures_us if len(fewest.exposures_us) == 3 else ()
    short, long = fewest.exposures_us
    return short, round(float(np.sqrt(short * long)), 1), long


def _checked(given: Any) -> Sequence[FrameSet]:
    sets = given if isinstance(given, (list, tuple)) else ()
    if not sets or not all(isinstance(one, FrameSet) for one in sets):
        raise DataError(f"suggest-exposures takes frame sets named 'frames'; it was given {type(given).__name__}")
    alike = {(one.frames.shape[1:], one.frames.dtype.str, one.settings.bits, one.settings.gain_db) for one in sets}
    if len(alike) > 1:
        raise DataError("the sets differ in size, bits or gain; they may differ in exposure only")
    return sets


def _steps(frame_set: FrameSet) -> Any:
    """Return the frames of the last group of equal steps, the finest fringes of the usual sets."""
    for indices in reversed(list(frame_set.sequence.groups().values())):
        frames = [frame_set.sequence.frames[i] for i in indices]
        turns = np.sort(np.mod([frame.shift_rad / (2 * np.pi) for frame in frames], 1.0))
        equal = len(frames) >= 3 and np.allclose(np.diff(turns), 1 / len(frames), atol=1e-3)
        if equal and frames[0].period_px > 0 and frames[0].shot < 0:
            return frame_set.frames[list(indices)]
    raise DataError(f"the set {frame_set.id or 'without id'} has no group of three or more equal phase steps")


def _sensor(frame_set: FrameSet, black_dn: float) -> SensorModel:
    from fringed_plugins.phase.exposure.exposures import SensorModel

    full, settings = full_scale_dn(frame_set), frame_set.settings
    electrons_per_dn = settings.electrons_per_dn or 13_000.0 / full  # the usual CCD's, where it is not known
    read = settings.read_noise_electrons if settings.electrons_per_dn else 12.0
    return SensorModel(black_dn * full / 255, full, (read / electrons_per_dn) ** 2 + 1 / 12, 1 / electrons_per_dn)


def _document(
    sets: Sequence[FrameSet],
    light: Brightness,
    sensor: SensorModel,
    suggestions: tuple[Suggestion, tuple[float, ...]],
    wanted_share: float,
) -> dict[str, Any]:
    fewest, three = suggestions
    saturating_us = (sensor.full_dn - sensor.black_dn) / light.peak_per_us
    edges = np.geomspace(saturating_us.min() * 0.999, saturating_us.max() * 1.001, _BINS + 1)
    return {
        "exposures_us": fewest.exposures_us,
        "served": fewest.served,
        "too_bright": fewest.too_bright,
        "too_dark": fewest.too_dark,
        "dimmer": fewest.dimmer,
        "enough": fewest.served >= wanted_share - 0.005,
        "reason": fewest.reason,
        "three_us": three,
        "measured_us": sorted(one.settings.exposure_us for one in sets),
        "lit": light.lit,
        "dark": light.dark,
        "saturated": light.blinded,
        "range": float(np.quantile(saturating_us, 0.995) / np.quantile(saturating_us, 0.005)),
        "quantiles_us": {f"{q:g}": float(np.quantile(saturating_us, 1 - q)) for q in (0.01, 0.25, 0.5, 0.75, 0.99)},
        "histogram": {"edges_us": edges.tolist(), "pixels": np.histogram(saturating_us, edges)[0].tolist()},
    }
