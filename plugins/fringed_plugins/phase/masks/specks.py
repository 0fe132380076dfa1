"""Small islands of kept pixels. Owns their search; knows no contract."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

ISOLATED = 32


def flag_specks(rejected: npt.NDArray[np.uint16], least_px: int) -> None:
    """Flag `ISOLATED`, in place, connected regions of kept pixels with fewer than `least_px`; corners connect.

    Examples
    --------
    >>> flags = np.ones((5, 5), np.uint16)
    >>> flags[0, 0] = 0
    >>> flags[2:4, 2:5] = 0
    >>> flag_specks(flags, 4)
    >>> int((flags == 0).sum())
    6
    """
    from scipy import ndimage

    regions, count = ndimage.label(rejected == 0, np.ones((3, 3)))
    if count:
        sizes = np.bincount(regions.ravel())
        small = sizes < least_px
        small[0] = False
        rejected[small[regions]] |= np.uint16(ISOLATED)
