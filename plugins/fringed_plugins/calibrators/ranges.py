"""Several scans of one thing averaged, and verifications at several depths brought together.

Owns how pixels and verdicts are joined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Float32Array, RangeImage, Reject, Verification
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.calibrators.judging import worst


class AverageRange:
    """Scans of an unmoved object to one range image with less noise: each pixel's mean point.

    A pixel's ray is the same in all scans, so that its mean lies on it as well. The deviation falls with the root of
    the number of scans; what the calibration contributes to it does not, and is hidden by that.
    """

    name: ClassVar[str] = "average-range"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "range images of an unmoved object to their mean, with less noise"
    inputs: ClassVar[Mapping[str, Any]] = {"ranges": (RangeImage,)}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = RangeImage

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        least_share: Annotated[
            float, Meta(gt=0, le=1, description="of the scans in which a pixel has to be measured")
        ] = 0.5

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> RangeImage:
        """Return the mean.

        Raises
        ------
        DataError
            none given, of other sizes or calibrations, or of something that has moved.
        """
        images = _images(inputs, self.name)
        total = np.zeros(images[0].xyz_mm.shape)
        variance, count = np.zeros(total.shape[:2]), np.zeros(total.shape[:2])
        for image in images:
            kept = image.rejected == 0
            total[kept] += image.xyz_mm[kept]
            count += kept
            if image.sigma_mm is not None:
                variance[kept] += image.sigma_mm[kept].astype(np.float64) ** 2
        known = count >= max(1.0, params.least_share * len(images))
        times = np.where(known, count, np.nan)
        mean: Float32Array = (total / times[..., None]).astype(np.float32)
        _check_still(images, mean, known)
        sigma: Float32Array | None = None
        if all(image.sigma_mm is not None for image in images):
            sigma = (np.sqrt(variance) / times).astype(np.float32)
        rejected = np.where(known, np.uint16(0), np.maximum(images[0].rejected, np.uint16(Reject.OTHER)))
        return replace(images[0], xyz_mm=mean, rejected=rejected, sigma_mm=sigma, id="", scan="")


def _images(inputs: Mapping[str, Any], name: str) -> Sequence[RangeImage]:
    images = inputs.get("ranges")
    if not isinstance(images, (tuple, list)) or not images or not all(isinstance(one, RangeImage) for one in images):
        raise DataError(f"{name} takes one or more RangeImages named 'ranges'")
    first = images[0]
    for image in images[1:]:
        if image.rejected.shape != first.rejected.shape or image.calibration != first.calibration:
            raise DataError(
                f"{name}: range images of {first.rejected.shape} by {first.calibration or 'no calibration'} and "
                f"{image.rejected.shape} by {image.calibration or 'no calibration'}; take all with one camera setting "
                "and calibration"
            )
    return images


def _check_still(images: Sequence[RangeImage], mean: Float32Array, known: Any) -> None:
    """Refuse scans whose depths are apart as a whole, by more than their noise."""
    for number, image in enumerate(images, 1):
        both = known & (image.rejected == 0)
        if np.count_nonzero(both) < 100:
            raise DataError(f"scan {number} has hardly a pixel in common with the others; did the object move?")
        off = (image.xyz_mm[..., 2] - mean[..., 2])[both]
        shift, spread = float(np.median(off)), float(np.median(np.abs(off)))
        if abs(shift) > max(0.5 * spread, 1e-3):
            raise DataError(
                f"scan {number} lies {shift * 1000:+.0f} um off the mean of all, with {spread * 1000:.0f} um of noise: "
                "the object or the rig moved; take them again"
            )


class VerifyRange:
    """Verifications at several depths to one that tells between which depths the calibration holds.

    They are put in the order of their depths; it holds over the longest row of them that is not broken by a red one.
    The figures are the worst of that row.
    """

    name: ClassVar[str] = "verify-range"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "verifications at several depths to the range of depths in which all hold"
    inputs: ClassVar[Mapping[str, Any]] = {"verifications": (Verification,)}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Verification

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Verification:
        """Return the joined verification.

        Raises
        ------
        DataError
            none given, or of several calibrations or artefacts.
        """
        given = inputs.get("verifications")
        if not isinstance(given, (tuple, list)) or not given or not all(isinstance(v, Verification) for v in given):
            raise DataError(f"{self.name} takes one or more Verifications named 'verifications'")
        if len({(v.calibration, v.artefact) for v in given}) > 1:
            seen = ", ".join(sorted({f"{v.artefact} by {v.calibration}" for v in given}))
            raise DataError(f"{self.name} joins verifications of one artefact and one calibration; these are of {seen}")
        ordered = sorted(given, key=lambda v: sum(v.depth_mm))
        row = _longest(ordered)
        return _joined(row or ordered, len(ordered))


def _longest(ordered: Sequence[Verification]) -> list[Verification]:
    rows: list[list[Verification]] = [[]]
    for one in ordered:
        if one.verdict == "red":
            rows.append([])
        else:
            rows[-1].append(one)
    return max(rows, key=lambda row: row[-1].depth_mm[1] - row[0].depth_mm[0] if row else 0.0)


def _joined(row: Sequence[Verification], count: int) -> Verification:
    names = [name for name in row[0].limits if all(name in v.limits for v in row)]
    figures, limits = dict[str, float](), dict[str, float]()
    for name in names:
        one = max(row, key=lambda v: abs(v.figures[name]) / v.limits[name])
        limits[name] = one.limits[name]
        figures |= {key: one.figures[key] for key in (name, f"{name}_u") if key in one.figures}
    verdicts = {name: worst([v.verdicts[name] for v in row]) for name in names}
    note = f"{len(row)} of {count} verifications, from {row[0].depth_mm[0]:.0f} to {row[-1].depth_mm[1]:.0f} mm"
    return replace(
        row[-1],
        figures=figures,
        limits=limits,
        verdicts=verdicts,
        verdict=worst([v.verdict for v in row]),
        depth_mm=(min(v.depth_mm[0] for v in row), max(v.depth_mm[1] for v in row)),
        points=sum(v.points for v in row),
        notes=(note,),
        id="",
    )
