"""What a pixel sees of a straight edge: a step, blurred by the lens and averaged over the pixel's square.

Owns the closed form: along the edge's normal (nx, ny) the square has the profile of two boxes of widths |nx| and |ny|,
one after the other, and the lens adds a Gaussian.
"""

from __future__ import annotations

from math import erf, exp, sqrt
from typing import Any

from numba import njit

_NARROW = 0.03  # px: below it the narrower box is a point
_FAR = 5.5  # Gaussian deviations beyond which nothing is left
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def _integrals(x: float, s: float) -> tuple[float, float, float]:
    """Return the normal distribution's integral at x, its own integral, and that one's: 0, 1 and 2 times more."""
    u = x / s
    if u > 9.0:
        return 1.0, x, (x * x + s * s) / 2.0
    if u < -9.0:
        return 0.0, 0.0, 0.0
    below = 0.5 + 0.5 * erf(u * 0.7071067811865476)
    density = s * 0.3989422804014327 * exp(-0.5 * u * u)
    return below, x * below + density, ((x * x + s * s) * below + x * density) / 2.0


@njit(**_options)
def edge(d: float, nx: float, ny: float, s: float) -> tuple[float, float, float]:
    """Return the part of a pixel behind an edge at distance d from its centre, and minus that by d and by s.

    (nx, ny) is the edge's unit normal, towards growing d; s the Gaussian's deviation. All in pixels.

    Examples
    --------
    >>> [round(part, 3) + 0.0 for part in edge(0.25, 1.0, 0.0, 1e-3)]
    [0.25, 1.0, 0.0]
    >>> [round(part, 3) + 0.0 for part in edge(0.0, 0.6, 0.8, 0.5)]
    [0.5, 0.687, 0.0]
    """
    a, b = abs(nx), abs(ny)
    if a < b:
        a, b = b, a
    reach = 0.5 * (a + b) + _FAR * s
    if d >= reach:
        return 0.0, 0.0, 0.0
    if d <= -reach:
        return 1.0, 0.0, 0.0
    if b < _NARROW:
        s = sqrt(s * s + b * b / 12.0)
        p0, p1, _ = _integrals(d + 0.5 * a, s)
        m0, m1, _ = _integrals(d - 0.5 * a, s)
        # By s: the heat equation, s times the second derivative of what is averaged.
        up, down = (d + 0.5 * a) / s, (d - 0.5 * a) / s
        by_s = 0.3989422804014327 * (exp(-0.5 * up * up) - exp(-0.5 * down * down)) / a
        return 1.0 - (p1 - m1) / a, (p0 - m0) / a, by_s
    far, near = 0.5 * (a + b), 0.5 * (a - b)
    a0, a1, a2 = _integrals(d + far, s)
    b0, b1, b2 = _integrals(d + near, s)
    c0, c1, c2 = _integrals(d - near, s)
    e0, e1, e2 = _integrals(d - far, s)
    area = a * b
    return 1.0 - (a2 - b2 - c2 + e2) / area, (a1 - b1 - c1 + e1) / area, s * (a0 - b0 - c0 + e0) / area
