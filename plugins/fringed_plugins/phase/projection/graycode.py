"""Gray code on the projector: what the cells are, and the lines that show them.

Owns the layout that encoders, decoders and descriptions of captured folders share; knows no frame and no contract.

A code of n bits cuts the projector into cells of `cell_px`. Column u (pixel centres at integers) lies in cell
`floor((u + 1/2 - offset_px) / cell_px)`, so that the first cell of a code without offset begins at the left edge of
the first column. Frame `bit` b, 0 being the coarsest, is bright where bit n - 1 - b of `cell ^ (cell >> 1)` is set; a
frame with `inverted` is its complement. In a sequence each Gray frame has `style` "gray", `period_px` twice the cell
(the cell itself for every bit, not the width of that bit's stripes) and `initial_phase_rad`
`-2 pi (offset_px - 1/2) / period_px`, so that `2 pi u / period_px + initial_phase_rad` is pi at the end of the first
cell. A frame with `bit` -1 is all bright, or all dark when `inverted`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

MIN_CELL_PX = 2.0
MAX_BITS = 16


@dataclass(frozen=True)
class Code:
    """A Gray code: `bits`, the width of a cell and where the first one begins, in projector pixels."""

    bits: int
    cell_px: float
    offset_px: float = 0.0

    @property
    def cells(self) -> int:
        """How many cells the code tells apart."""
        return 1 << self.bits

    @property
    def period_px(self) -> float:
        """What frames of this code have as period: two cells."""
        return 2 * self.cell_px

    @property
    def initial_rad(self) -> float:
        """Phase of column 0, counted from the first cell's left edge, two cells a turn."""
        return -2 * np.pi * (self.offset_px - 0.5) / self.period_px

    @classmethod
    def of(cls, bits: int, period_px: float, initial_rad: float) -> Code:
        """Return the code that frames of this period and initial phase show.

        Examples
        --------
        >>> Code.of(5, 32.0, Code(5, 16.0, 3.0).initial_rad)
        Code(bits=5, cell_px=16.0, offset_px=3.0)
        """
        return cls(bits, period_px / 2, 0.5 - initial_rad * period_px / (2 * np.pi))


def bits_needed(length_px: float, cell_px: float) -> int:
    """Return how many bits count the cells of `length_px`.

    Examples
    --------
    >>> bits_needed(1024, 8.0), bits_needed(1024, 7.9), bits_needed(8, 8.0)
    (7, 8, 1)
    """
    cells = int(np.ceil(length_px / cell_px - 1e-9))
    return max(int(np.ceil(np.log2(max(cells, 1)))), 1)


def cell_of(u_px: npt.NDArray[np.float64], code: Code) -> npt.NDArray[np.int64]:
    """Return the cell of columns `u_px`, any shape.

    Examples
    --------
    >>> cell_of(np.array([-0.4, 7.4, 7.6]), Code(7, 8.0))
    array([0, 0, 1])
    """
    return np.floor((np.asarray(u_px, np.float64) + 0.5 - code.offset_px) / code.cell_px).astype(np.int64)


def line(length_px: int, code: Code, bit: int, inverted: bool = False) -> npt.NDArray[np.float64]:
    """Return relative light (length_px,), 0 or 1, of frame `bit`; -1 is all bright.

    References
    ----------
    Gray 1953 (US 2,632,058); Sansoni et al. 1997.

    Examples
    --------
    >>> line(8, Code(2, 2.0), 1)
    array([0., 0., 1., 1., 1., 1., 0., 0.])
    """
    if not -1 <= bit < code.bits:
        raise ValueError(f"bit {bit} of a code of {code.bits} bits; expected 0 to {code.bits - 1}, or -1")
    if bit < 0:
        bright = np.ones(length_px, bool)
    else:
        cell = cell_of(np.arange(length_px, dtype=np.float64), code)
        gray = cell ^ (cell >> 1)
        bright = (gray >> (code.bits - 1 - bit)) & 1 > 0
    return np.where(bright != inverted, 1.0, 0.0)


def check_code(code: Code, length_px: int) -> None:
    """Check that a code can be shown and told apart.

    Raises
    ------
    ValueError
        cells too narrow for a projector pixel, or too few bits for the projector, with what to use instead.
    """
    if not code.cell_px >= MIN_CELL_PX:
        raise ValueError(
            f"cells of {code.cell_px:.3g} px; below {MIN_CELL_PX:g} px a stripe is no wider than the projector's own "
            f"pixels and blur: use cells of {MIN_CELL_PX:g} px or more, with fringes of several pixels for the rest"
        )
    needed = bits_needed(length_px - code.offset_px, code.cell_px)
    if code.offset_px > 0:
        raise ValueError(
            f"the first cell begins at {code.offset_px:g} px, so that columns before it have no code: use 0"
        )
    if needed > code.bits:
        raise ValueError(
            f"{code.bits} bits count {code.cells} cells of {code.cell_px:.4g} px; {length_px} px need {needed} bits, "
            f"or cells of {length_px / code.cells:.4g} px"
        )
    if code.bits > MAX_BITS:
        raise ValueError(f"{code.bits} bits; at most {MAX_BITS} are decoded")
