"""Finding spheres in a range image without a hint of where or how large they are.

Owns the guess from pairs of points with normals: p - q = r (n - m) on a sphere. Each found one is measured by `sphere`.

References
----------
Schnabel, Wahl & Klein 2007, section 4.1: a sphere from two oriented points.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.artefacts.cells import Cells, cells_of
from fringed_plugins.calibration.artefacts.smooth import pieces
from fringed_plugins.calibration.artefacts.sphere import Cap, Sphere, measure_sphere

Array = npt.NDArray[Any]
_PAIRS, _JUDGED, _SAMPLE = 6000, 200, 3000
_APART = 20  # cells between the points of a pair
_TURN_RAD = np.deg2rad(20.0)
_NORMAL_RAD = np.deg2rad(12.0)
_FEWEST_CELLS = 25
_LEAST_CAP_DEG, _LEAST_COVERED = 25.0, 0.6
_NO_SPHERE = 0.02  # RMS over radius: such a surface is no sphere, not a badly measured one


def find_spheres(
    xyz_mm: Array, valid: Array, sigma_mm: Array | None = None, *, count: int = 1, cap: Cap | None = None
) -> list[Sphere]:
    """Return the `count` spheres in view with the most points, from left to right.

    Raises
    ------
    ValueError
        fewer are in view; the message says what the best candidate lacks.

    Examples
    --------
    >>> y, x = np.mgrid[-60:60, -60:60] * 0.5
    >>> z = 500 - np.sqrt(np.maximum(25.0**2 - x**2 - y**2, 0))
    >>> ball = find_spheres(np.stack([x * z / 475, y * z / 475, z], axis=-1), x**2 + y**2 < 24**2)[0]
    >>> bool(abs(ball.radius_mm - 25) < 1.0)
    True
    """
    cells = cells_of(xyz_mm, valid)
    left, found, refused = cells.valid.copy(), list[Sphere](), list[str]()
    rng = np.random.default_rng(0)
    for _ in range(4 * count):
        guess = _guess(cells, left, rng)
        if guess is None:
            break
        own = _own(cells, left, guess)
        left &= ~own & ~_swallowed(cells, guess)
        try:
            found.append(_measured(xyz_mm, valid, sigma_mm, guess, cap or Cap()))
        except ValueError as error:
            refused.append(str(error))
    found.sort(key=lambda one: -np.count_nonzero(one.inside))
    if len(found) < count:
        raise ValueError(_missing(count, len(found), refused))
    return sorted(found[:count], key=lambda one: float(one.centre_mm[0]))


def _missing(count: int, found: int, refused: list[str]) -> str:
    wanted = "a sphere" if count == 1 else f"{count} spheres"
    seen = "none is" if not found else f"{found} {'is' if found == 1 else 'are'}"
    why = f"; the nearest thing to one: {refused[0]}" if refused else ""
    return f"{wanted} should be in view, and {seen}{why}. Put a matt sphere before the rig, well inside the picture"


def _guess(cells: Cells, among: Array, rng: np.random.Generator) -> tuple[Array, float] | None:
    """Return centre and radius of the sphere that most of the cells lie on, None where hardly any do."""
    rows, columns = np.nonzero(among)
    if len(rows) < _FEWEST_CELLS:
        return None
    centres, radii = _pairs(cells, among, (rows, columns), rng)
    if not len(radii):
        return None
    some = rng.choice(len(rows), min(_SAMPLE, len(rows)), replace=False)
    points, normals = (a[rows[some], columns[some]] for a in (cells.points_mm, cells.normals))
    best, most = None, 0
    for centre, radius in zip(centres[:_JUDGED], radii[:_JUDGED], strict=True):
        score = int(np.count_nonzero(_on(points, normals, (centre, radius), 0.03 * radius + 4 * cells.noise_mm)))
        if score > most:
            best, most = (centre, float(radius)), score
    if best is None or most * len(rows) < _FEWEST_CELLS * len(some):
        return None
    for _ in range(8):
        own = _on(points, normals, best, 0.02 * best[1] + 4 * cells.noise_mm)
        if np.count_nonzero(own) < _FEWEST_CELLS // 2:
            return None
        best = _algebraic(points[own])
    return best


def _pairs(cells: Cells, among: Array, places: tuple[Array, Array], rng: np.random.Generator) -> tuple[Array, Array]:
    """Return centres (n, 3) and radii (n,) of pairs of neighbouring cells whose normals agree with a sphere."""
    rows, columns = places
    first = rng.integers(len(rows), size=_PAIRS)
    row = rows[first] + rng.integers(-_APART, _APART + 1, _PAIRS)
    column = columns[first] + rng.integers(-_APART, _APART + 1, _PAIRS)
    ok = (row >= 0) & (row < among.shape[0]) & (column >= 0) & (column < among.shape[1])
    ok[ok] = among[row[ok], column[ok]]
    a, b = (rows[first[ok]], columns[first[ok]]), (row[ok], column[ok])
    p, q, n, m = cells.points_mm[a], cells.points_mm[b], cells.normals[a], cells.normals[b]
    turn = n - m
    size = np.einsum("ij,ij->i", turn, turn)
    radius = np.einsum("ij,ij->i", p - q, turn) / np.maximum(size, 1e-12)
    misfit = np.linalg.norm(p - q - radius[:, None] * turn, axis=1)
    least = max(4 * np.sqrt(2) * cells.normal_noise, 0.05)
    good = (size > least**2) & (radius > 3 * cells.spacing_mm) & (radius < cells.field_mm)
    good &= misfit < 0.15 * np.linalg.norm(p - q, axis=1)
    return (p - radius[:, None] * n)[good], radius[good]


def _on(points: Array, normals: Array, sphere: tuple[Array, float], tolerance_mm: float) -> Array:
    """Return which points (..., 3) lie on a sphere, normals included."""
    away = points - sphere[0]
    distance = np.linalg.norm(away, axis=-1)
    with np.errstate(invalid="ignore"):
        facing = np.einsum("...i,...i", away, normals) > np.cos(_NORMAL_RAD) * distance
        found: Array = facing & (np.abs(distance - sphere[1]) <= tolerance_mm)
    return found


def _algebraic(points: Array) -> tuple[Array, float]:
    """Return the sphere of linear least squares: |p|^2 = 2 c . p + k."""
    middle = points.mean(axis=0)
    away = points - middle
    rows = np.column_stack([2 * away, np.ones(len(away))])
    found = np.linalg.lstsq(rows, np.einsum("ij,ij->i", away, away), rcond=None)[0]
    return middle + found[:3], float(np.sqrt(max(found[3] + found[:3] @ found[:3], 0.0)))


def _own(cells: Cells, among: Array, guess: tuple[Array, float]) -> Array:
    """Return the largest connected piece of cells on the sphere."""
    on = _on(cells.points_mm, cells.normals, guess, 0.1 * guess[1])
    connected = pieces(cells, _TURN_RAD, on & among)
    return connected[0] if connected else on & among


def _swallowed(cells: Cells, guess: tuple[Array, float]) -> Array:
    with np.errstate(invalid="ignore"):
        found: Array = np.linalg.norm(cells.points_mm - guess[0], axis=-1) <= 1.1 * guess[1]
    return found


def _measured(xyz_mm: Array, valid: Array, sigma_mm: Array | None, guess: tuple[Array, float], cap: Cap) -> Sphere:
    """Return the measured sphere; raises ValueError for what is none, or of which too little is in view."""
    found = measure_sphere(xyz_mm, valid, sigma_mm, guess, cap)
    what = f"a surface of radius {found.radius_mm:.2f} mm"
    if found.form.rms_mm > _NO_SPHERE * found.radius_mm:
        raise ValueError(f"{what} that is off a sphere by {found.form.rms_mm:.2f} mm RMS")
    if found.cap_deg < _LEAST_CAP_DEG or found.covered < _LEAST_COVERED:
        raise ValueError(
            f"{what} of which a cap of {found.cap_deg:.0f} degrees is in view, {found.covered:.0%} of it with points; "
            f"a measurement needs {_LEAST_CAP_DEG:.0f} degrees and {_LEAST_COVERED:.0%}"
        )
    return found
