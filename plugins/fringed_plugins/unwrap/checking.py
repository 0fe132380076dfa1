"""What every unwrapper asks of its input.

Owns the checks of shape and range, and the types that the kernels take.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

_LARGEST_RAD = 3.1425  # pi, and the rounding of whoever wrapped the phase
_SAMPLE_PX = 1 << 14


def sealed(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a read-only view: kernels are compiled once, whether or not the caller's array may be written."""
    view = array.view()
    view.flags.writeable = False
    return view


def wrapped_phase(wrapped_rad: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a phase (height, width), C-ordered and read-only; float64 stays, anything else becomes float32.

    Raises
    ------
    ValueError
        no picture, or one without pixels.
    """
    phase = np.asarray(wrapped_rad)
    if phase.ndim != 2 or phase.size == 0:
        raise ValueError(f"a phase of shape {phase.shape}; expected (height, width), neither of them 0")
    return sealed(np.ascontiguousarray(phase, np.float64 if phase.dtype == np.float64 else np.float32))


def check_range(largest_rad: float) -> None:
    """Check the largest |phase| of the known pixels.

    Raises
    ------
    ValueError
        the phase is not within [-pi, pi].
    """
    if largest_rad > _LARGEST_RAD:
        raise ValueError(
            f"the phase reaches {largest_rad:.4g} rad; a wrapped phase is within [-pi, pi]: wrap it first, "
            "with numpy.angle(numpy.exp(1j * phase)), if it is meant to be unwrapped again"
        )


def weights(quality: npt.NDArray[Any] | None, shape: tuple[int, ...]) -> tuple[npt.NDArray[np.float32], np.float32]:
    """Return the quality (height, width) with its median, or (0, width) for none.

    The median is that of up to about 16 thousand pixels evenly spread, of those that are finite and above 0.

    Raises
    ------
    ValueError
        quality and phase differ in shape.
    """
    none = sealed(np.empty((0, shape[1]), np.float32))
    if quality is None:
        return none, np.float32(1)
    if quality.shape != shape:
        raise ValueError(f"a phase of shape {shape} with a quality of {quality.shape}; both must be (height, width)")
    flat = np.ascontiguousarray(quality, np.float32)
    step = max(1, flat.size // _SAMPLE_PX) | 1  # odd, so that it is not a divisor of most widths
    for sample in (flat.ravel()[::step], flat.ravel()):
        good = sample[np.isfinite(sample) & (sample > 0)]
        if good.size:
            return sealed(flat), np.float32(np.median(good))
    return none, np.float32(1)
