"""How much light a projector gives for a grey level.

Owns the tone curve; knows nothing of where the light goes. Every colour channel passes through the same curve,
so one curve is exact for every camera channel.
"""

from __future__ import annotations

import numpy as np

from fringed.config.simulated import ProjectorOptics
from fringed.data import Float64Array

# An S-curve x^p / (x^p + (1 - x)^p) departs from the straight line by (p - 1) times this, to first order; it stays
# monotonic for every p, which adding a sine would not.
_DEPARTURE = 0.2239


def tone_curve(optics: ProjectorOptics) -> Float64Array:
    """Return the relative light (256,) of each grey level, 0 for level 0 and 1 for level 255.

    Gamma first, then the panel's S-curve: light = S((level / 255) ** gamma). The black level is not in it: the
    light that leaves the projector is `black_level + (1 - black_level) * tone_curve[level]`.
    """
    level = (np.arange(256) / 255.0) ** optics.gamma
    power = 1 + optics.s_curve / _DEPARTURE
    high, low = level**power, (1 - level) ** power
    return np.asarray(high / (high + low), dtype=np.float64)


def response(optics: ProjectorOptics) -> Float64Array:
    """Return the light (256,) that leaves the projector for each grey level, as a fraction of its white."""
    return np.asarray(optics.black_level + (1 - optics.black_level) * tone_curve(optics), dtype=np.float64)
