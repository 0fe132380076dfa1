"""Connected regions of a mask.

Owns the numbering; knows nothing of phase.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage


def connected_regions(mask: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
    """Label the 4-connected regions of `mask` (height, width) by numbers from 1; 0 outside.

    Examples
    --------
    >>> connected_regions(np.array([[True, False, True]]))
    array([[1, 0, 2]], dtype=int32)
    """
    numbers, _ = ndimage.label(mask)
    return np.asarray(numbers, np.int32)
