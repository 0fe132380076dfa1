"""A sphere in the pixels of a range image: its centre and radius, and how round it seems.

Owns the fit of one sphere that is already found; `spheres` finds them.

References
----------
VDI/VDE 2634 part 2 (2012), probing error of form and size; Ahn, Rauh & Warnecke 2001 for the geometric fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.artefacts.plane import FEWEST, weights_of
from fringed_plugins.calibration.artefacts.scatter import STRAY, Form, blocks_of, covariance, form_of, spread

Array = npt.NDArray[Any]
MOST_INCIDENCE_DEG = 60.0
_NEAR = 0.1  # of the radius: what is farther off the surface belongs to something else
_OTHER = 0.2
_ROUNDS = 30
_RINGS, _SECTORS = 4, 12


@dataclass(frozen=True)
class Sphere:
    """A measured sphere: `centre_mm` (3,) and `radius_mm`, with covariance (4, 4) of x, y, z and radius, mm^2.

    `fixed_centre_mm` (3,) is where the centre is when the radius is held at the nominal one, with covariance (3, 3);
    without a nominal radius, or with quite another one, it is the centre. `covered` is the share of the cap of
    `cap_deg` in which there are points. `inside` (height, width) are the pixels that it was measured on.
    """

    centre_mm: Array
    radius_mm: float
    covariance: Array
    fixed_centre_mm: Array
    fixed_covariance: Array
    cap_deg: float
    covered: float
    inside: Array
    form: Form


@dataclass(frozen=True)
class Cap:
    """What is measured of a sphere: pixels that look at it at `most_incidence_deg` from the normal or less.

    `nominal_mm` is the radius to hold for `fixed_centre_mm`, 0 for none.
    """

    most_incidence_deg: float = MOST_INCIDENCE_DEG
    nominal_mm: float = 0.0
    smooth_px: int = 7


def measure_sphere(
    xyz_mm: Array, valid: Array, sigma_mm: Array | None, around: tuple[Array, float], cap: Cap | None = None
) -> Sphere:
    """Return the sphere near `around` (centre, radius), fitted by its radial distances.

    The pixels are chosen by where their rays meet the sphere, not by where their points lie: noise at the limb would
    choose those that lie high, and a larger sphere. All of them count for the form.

    Raises
    ------
    ValueError
        too few points on it.
    """
    cap = cap or Cap()
    centre, radius = np.asarray(around[0], np.float64), float(around[1])
    inside = np.zeros(valid.shape, bool)
    for _ in range(3):
        inside = _facing(xyz_mm, valid, (centre, radius), cap.most_incidence_deg)
        _check_count(inside, centre, radius)
        centre, radius, C, deviation = _fit(xyz_mm, inside, sigma_mm, (centre, radius), False)
    fixed, fixed_C = centre, C[:3, :3]
    if abs(radius - cap.nominal_mm) < _OTHER * radius:  # else another sphere's, which whoever judges will refuse
        fixed, _, fixed_C, _ = _fit(xyz_mm, inside, sigma_mm, (centre, cap.nominal_mm), True)
    whole = np.zeros(inside.shape)
    whole[inside] = deviation
    form = form_of(whole, inside, cap.smooth_px)
    reach, covered = _coverage(xyz_mm[inside].astype(np.float64) - centre, centre)
    return Sphere(centre, radius, C, fixed, fixed_C, reach, covered, inside, form)


def _facing(xyz_mm: Array, valid: Array, around: tuple[Array, float], most_deg: float) -> Array:
    """Return the valid pixels near the sphere whose rays meet it at no more than `most_deg` from its normal."""
    centre, radius = around
    inside = np.zeros(valid.shape, bool)
    rows, columns = np.nonzero(valid)
    points = xyz_mm[rows, columns].astype(np.float64)
    aim = points / np.linalg.norm(points, axis=1, keepdims=True)
    along = aim @ centre
    past = np.einsum("ij,ij->i", aim * along[:, None] - centre, aim * along[:, None] - centre)
    depth = radius**2 - past  # squared half chord; cos of the incidence is its root over the radius
    meets = depth >= (radius * np.cos(np.deg2rad(most_deg))) ** 2
    near = np.abs(np.linalg.norm(points - centre, axis=1) - radius) <= _NEAR * radius
    inside[rows[meets & near], columns[meets & near]] = True
    return inside


def _check_count(inside: Array, centre: Array, radius: float) -> None:
    count = int(np.count_nonzero(inside))
    if count < FEWEST:
        raise ValueError(
            f"the sphere of radius {radius:.2f} mm at ({', '.join(f'{c:.0f}' for c in centre)}) mm has {count} points; "
            f"a measurement needs {FEWEST}: use a larger sphere, or bring it nearer"
        )


def _fit(
    xyz_mm: Array, inside: Array, sigma_mm: Array | None, around: tuple[Array, float], held: bool
) -> tuple[Array, float, Array, Array]:
    """Return centre, radius, covariance and radial deviations (n,) by Gauss-Newton; `held` keeps the radius.

    Raises
    ------
    ValueError
        it does not settle: the points lie on no sphere.
    """
    points = xyz_mm[inside].astype(np.float64)
    aim = points / np.linalg.norm(points, axis=1, keepdims=True)
    centre, radius = around
    size = 3 if held else 4
    for _ in range(_ROUNDS):
        away = points - centre
        distance = np.linalg.norm(away, axis=1)
        normals = away / distance[:, None]
        deviation = distance - radius
        kept = np.abs(deviation - np.median(deviation)) <= STRAY * max(spread(deviation), 1e-9)
        weights = weights_of(sigma_mm, inside, np.einsum("ij,ij->i", aim, normals)) * kept
        rows = np.column_stack([normals, np.ones(len(points))])[:, :size]
        H = np.einsum("ni,nj->ij", rows * weights[:, None], rows)
        step = np.linalg.lstsq(H, rows.T @ (weights * deviation), rcond=None)[0]
        centre = centre + step[:3]
        radius = radius if held else radius + float(step[3])
        if float(np.abs(step).max()) < 1e-7 * radius:
            break
    else:
        raise ValueError("the fit of the sphere does not settle: the points lie on no sphere")
    deviation = np.linalg.norm(points - centre, axis=1) - radius
    C = covariance(rows, weights, deviation, blocks_of(inside))
    return centre, float(radius), C, deviation


def _coverage(away: Array, centre: Array) -> tuple[float, float]:
    """Return the angle of the cap (degrees, from the line to the camera), and the share of it that has points."""
    axis = -centre / np.linalg.norm(centre)
    across = np.linalg.svd(axis[None])[2][1:]
    normals = away / np.linalg.norm(away, axis=1, keepdims=True)
    cosine = np.clip(normals @ axis, -1, 1)
    reach = float(np.percentile(np.arccos(cosine), 99.5))
    ring = np.floor((1 - cosine) / max(1 - np.cos(reach), 1e-12) * _RINGS).astype(int)
    side = normals @ across.T
    sector = np.floor((np.arctan2(side[:, 1], side[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS
    held = ring < _RINGS
    filled = np.unique(ring[held] * _SECTORS + sector[held])
    return float(np.rad2deg(reach)), len(filled) / (_RINGS * _SECTORS)
