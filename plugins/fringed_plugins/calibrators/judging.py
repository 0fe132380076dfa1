"""What every verification shares: its parameters, the limits where none are given, the traffic light, its notes.

Owns the rule of the light and the limits' shares of the field; measures nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from fringed.data import Array, Calibration, RangeImage, Verification
from fringed.data.verification import Verdict
from fringed.errors import DataError
from fringed.hookspecs import Context, Params

_MM = {"units": "mm"}
FORM_SHARE, LENGTH_SHARE = 1 / 4000, 1 / 10000
"""Limits where none are given, as shares of the width of the field at the artefact: of ranges, and of lengths."""
YELLOW = 1.5
_COVERAGE = 2.0  # standard uncertainties that a figure may be off by
_REFERENCE_C = 20.0
_APART_C = 3.0
_ORDER: tuple[Verdict, ...] = ("green", "yellow", "red")
_UNITS = (
    (1000.0, "given in metres"),
    (0.001, "given in micrometres"),
    (25.4, "given in inches"),
    (2.0, "given as half of it"),
    (0.5, "given as twice of it, such as a diameter for a radius"),
)


class VerifyParams(Params, frozen=True, kw_only=True):
    """What every artefact has."""

    smooth_px: Annotated[
        int, Meta(ge=1, le=63, description="side of the window whose means form and flatness are the range of; odd")
    ] = 7
    min_depth_mm: Annotated[float, Meta(ge=0, description="nearest depth looked at", extra_json_schema=_MM)] = 0.0
    max_depth_mm: Annotated[
        Annotated[float, Meta(gt=0)] | None,
        Meta(description="farthest depth looked at; unset: no limit", extra_json_schema=_MM),
    ] = None
    limits: Annotated[
        dict[str, Annotated[float, Meta(gt=0)]],
        Meta(description="mm for each figure; others: field / 4000 of a form, / 10000 of a length"),
    ] = msgspec.field(default_factory=dict)
    artefact_uncertainty_mm: Annotated[
        float,
        Meta(ge=0, le=10, description="standard uncertainty of the artefact's own sizes", extra_json_schema=_MM),
    ] = 0.0
    temperature_c: Annotated[
        Annotated[float, Meta(ge=-50, le=100)] | None,
        Meta(description="of the room", extra_json_schema={"units": "degC"}),
    ] = None
    expansion_per_k: Annotated[
        float,
        Meta(
            ge=0,
            le=1e-4,
            description="of the artefact, whose sizes hold at 20 degC",
            extra_json_schema={"units": "1/K"},
        ),
    ] = 0.0


@dataclass
class Findings:
    """Figures (mm) with their standard uncertainties, nominal sizes, and what has to be said."""

    figures: dict[str, float] = field(default_factory=dict)
    uncertainties: dict[str, float] = field(default_factory=dict)
    default_limits: dict[str, float] = field(default_factory=dict)
    nominal: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def judged(self, name: str, value: float, uncertainty: float, share: float, field_mm: float) -> None:
        """Add a figure that has a limit, its default a share of the field."""
        self.figures[name], self.uncertainties[name] = float(value), float(uncertainty)
        self.default_limits[name] = share * field_mm


@dataclass(frozen=True)
class Scene:
    """A range image as algorithms take it."""

    image: RangeImage
    xyz_mm: Array
    valid: Array
    sigma_mm: Array | None


def scene_of(inputs: Mapping[str, Any], name: str, params: VerifyParams) -> Scene:
    """Return the points within the depths.

    Raises
    ------
    DataError
        no range image, or an even window.
    """
    image = inputs.get("range")
    if not isinstance(image, RangeImage):
        raise DataError(f"{name} takes a RangeImage named 'range'; it was given {type(image).__name__}")
    if params.smooth_px % 2 == 0:
        raise DataError(f"smooth_px is {params.smooth_px}; expected an odd number, such as {params.smooth_px + 1}")
    z = image.xyz_mm[..., 2]
    valid = (image.rejected == 0) & np.isfinite(image.xyz_mm).all(axis=-1)
    valid &= (z > params.min_depth_mm) & (z < (params.max_depth_mm or np.inf))
    return Scene(image, image.xyz_mm, valid, image.sigma_mm)


def expanded(nominal_mm: float, params: VerifyParams) -> float:
    """Return a nominal size at the room's temperature."""
    warmer = 0.0 if params.temperature_c is None else params.temperature_c - _REFERENCE_C
    return nominal_mm * (1 + params.expansion_per_k * warmer)


def check_size(what: str, measured_mm: float, nominal_mm: float, most: float = 0.2) -> None:
    """Refuse a size that is another artefact's, or in another unit.

    Raises
    ------
    DataError
        measured and nominal differ by more than `most` of the nominal one.
    """
    if nominal_mm <= 0 or abs(measured_mm / nominal_mm - 1) <= most:
        return
    ratio = measured_mm / nominal_mm
    hint = next((f", {text}?" for factor, text in _UNITS if abs(ratio / factor - 1) < 0.05), ".")
    raise DataError(
        f"the {what} measures {measured_mm:.3f} mm, and {nominal_mm:g} mm is its nominal value{hint} Give the nominal "
        "value in mm, or put that artefact before the rig"
    )


def light(value_mm: float, uncertainty_mm: float, limit_mm: float) -> Verdict:
    """Return green within the limit, yellow to 1.5 of it or where the uncertainty leaves it open, else red."""
    size, doubt = abs(value_mm), _COVERAGE * uncertainty_mm
    if abs(size - limit_mm) < doubt:
        return "yellow"
    if size <= limit_mm:
        return "green"
    return "yellow" if size <= YELLOW * limit_mm else "red"


def worst(verdicts: Sequence[Verdict]) -> Verdict:
    """Return the worst of them."""
    return max(verdicts, key=_ORDER.index)


def verification(
    artefact: Any, scene: Scene, inside: Array, found: Findings, given: tuple[Mapping[str, Any], VerifyParams, Context]
) -> Verification:
    """Return the verification, with every figure's uncertainty beside it as `NAME_u`.

    Raises
    ------
    DataError
        a limit of a figure that there is not.
    """
    inputs, params, context = given
    unknown = set(params.limits) - set(found.default_limits)
    if unknown:
        raise DataError(
            f"there is no figure {', '.join(sorted(unknown))} to limit; this artefact has "
            f"{', '.join(found.default_limits)}"
        )
    limits = {**found.default_limits, **params.limits}
    verdicts = {name: light(found.figures[name], found.uncertainties[name], limit) for name, limit in limits.items()}
    z = scene.xyz_mm[inside][:, 2]
    image = scene.image
    notes = [*found.notes, *_notes(image, inputs.get("calibration"), params)]
    for note in notes:
        context.log("info", note)
    return Verification(
        artefact=artefact,
        calibration=image.calibration,
        rig=image.provenance.rig,
        figures={**found.figures, **{f"{name}_u": value for name, value in found.uncertainties.items()}},
        limits=limits,
        verdicts=verdicts,
        verdict=worst(list(verdicts.values())),
        depth_mm=(float(z.min()), float(z.max())),
        points=int(np.count_nonzero(inside)),
        nominal=found.nominal,
        temperature_c=params.temperature_c,
        notes=tuple(notes),
    )


def _notes(image: RangeImage, calibration: Any, params: VerifyParams) -> list[str]:
    notes = [
        f"form and flatness are ranges of means over {params.smooth_px} x {params.smooth_px} px, 3 per mille left out"
    ]
    if isinstance(calibration, Calibration):
        if calibration.hash != image.calibration:
            notes.append(
                f"the range image was made with the calibration {image.calibration or 'of no name'}, which is what is "
                f"verified; {calibration.hash} is in force"
            )
        known, now = calibration.temperature_c, params.temperature_c
        if (
            calibration.hash == image.calibration
            and known is not None
            and now is not None
            and abs(known - now) > _APART_C
        ):
            notes.append(f"calibrated at {known:.1f} degC, verified at {now:.1f} degC: the rig may have moved with it")
    return notes


def scatter_notes(noise_mm: float, sigma_mm: Array | None, inside: Array, strays: float) -> list[str]:
    """Return what has to be said of noise: stated deviations that are wrong, points that are far off."""
    notes = []
    stated = float(np.nanmedian(sigma_mm[inside])) if sigma_mm is not None else 0.0
    if stated > 0 and not 0.7 <= noise_mm / stated <= 1.4:
        notes.append(f"neighbouring points scatter by {noise_mm * 1000:.0f} um, {stated * 1000:.0f} um are stated")
    if strays > 0.003:
        notes.append(f"{strays:.1%} of the points inside are far off: glare, dust or edges on the artefact?")
    return notes
