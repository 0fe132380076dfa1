"""Decoder of number-theoretic sets: periods without a common multiple on the projector.

Owns its name and what it refuses; the algorithm is that of `heterodyne`, which weighs all orders of any periods.
"""

from __future__ import annotations

from typing import ClassVar

from fringed_plugins.decoders.heterodyne import HeterodyneDecoder


class NumberTheoreticDecoder(HeterodyneDecoder):
    """Absolute phase of two or more periods whose phases together are the same at no two columns.

    The residues of the column after division by each period, which are the phases, tell the column; noise makes that
    a search for the most likely column instead of the Chinese remainder theorem's sum, which
    multiplies noise by the periods.

    References
    ----------
    Gushov & Solodkin 1991; Petkovic, Pribanic & Donlic 2016, 2017; Zuo et al. 2016, section 5.
    """

    name: ClassVar[str] = "number-theoretic"
    summary: ClassVar[str] = "N steps of periods without a common multiple to an absolute phase"
