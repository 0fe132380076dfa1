"""What a tone curve does to fringes, and what the fringes' harmonics do to a phase.

Owns the forward model: light of one period to harmonics, harmonics to the error of N steps. A tone curve has no
memory and blur is symmetric, so a cosine stays even: harmonic k is `B_k cos(k phase)` with a real B_k, and blur only
makes it smaller.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]

PERIOD_SAMPLES = 256
MOST_HARMONICS = 16


def harmonics_of(light: npt.ArrayLike, count: int = MOST_HARMONICS) -> Float64Array:
    """Return B_k / B_1 for k = 0 ... `count` (entry 1 is 1) of the light (n,) over one period that begins at its crest.

    Raises
    ------
    ValueError
        the light has no fundamental.

    Examples
    --------
    >>> t = 2 * np.pi * np.arange(64) / 64
    >>> harmonics_of(1 + np.cos(t) + 0.2 * np.cos(2 * t), 3).round(3) + 0
    array([1. , 1. , 0.2, 0. ])
    """
    values = np.asarray(light, np.float64)
    spectrum = np.fft.rfft(values).real / len(values)
    spectrum[1:] *= 2
    found = np.zeros(count + 1)
    known = min(count + 1, len(spectrum))
    found[:known] = spectrum[:known]
    if not abs(found[1]) > 0:
        raise ValueError("the light has no fundamental: one period of a fringe, crest first, is needed")
    return np.asarray(found / found[1], np.float64)


def tone_harmonics(
    tone_curve: npt.ArrayLike, grey_low: float = 0.0, grey_high: float = 255.0, count: int = MOST_HARMONICS
) -> Float64Array:
    """Return the harmonics, as `harmonics_of`, of a sinusoid in grey levels shown with `tone_curve` (256,)."""
    t = 2 * np.pi * np.arange(PERIOD_SAMPLES) / PERIOD_SAMPLES
    grey = grey_low + (grey_high - grey_low) * (1 + np.cos(t)) / 2
    return harmonics_of(np.interp(grey, np.arange(256), np.asarray(tone_curve, np.float64)), count)


def blurred(harmonics: Float64Array, sigma_periods: float) -> Float64Array:
    """Return the harmonics behind a Gaussian blur of `sigma_periods` periods.

    Examples
    --------
    >>> blurred(np.array([1.0, 1.0, 0.3]), 0.05).round(3)
    array([1.051, 1.   , 0.259])
    """
    k = np.arange(len(harmonics))
    return np.asarray(harmonics * np.exp(-2 * (np.pi * sigma_periods) ** 2 * (k**2 - 1)))


def phase_error(harmonics: npt.ArrayLike, steps: int, phase_rad: npt.ArrayLike) -> Float64Array:
    """Return measured minus true phase of `steps` equal steps, for true phases of any shape.

    N steps see harmonic k as the fundamental where k = m N + 1, and as its mirror image where k = m N - 1; the others
    they do not see. The sum of frames is therefore B_1 exp(i phi) + sum B_(mN-1) exp(-i (mN-1) phi) +
    B_(mN+1) exp(i (mN+1) phi), and the error its angle less phi: with the first pair alone
    `-(B_(N-1) - B_(N+1)) / B_1 sin(N phi)`, to first order.

    References
    ----------
    Guo, He & Chen 2004, eq. 9; Pan, Kemao, Huang & Asundi 2009, eqs. 6-11; Zuo et al. 2018, section 6.1.

    Examples
    --------
    >>> round(float(phase_error([1, 1, 0.1], 3, np.pi / 6)), 4)
    -0.0997
    >>> round(float(phase_error([1, 1, 0.1], 4, np.pi / 6)), 4)
    0.0
    """
    ratios = np.asarray(harmonics, np.float64)
    phase = np.asarray(phase_rad, np.float64)
    total = np.ones_like(phase, dtype=np.complex128)
    for k in range(2, len(ratios)):
        if k % steps == 1:
            total += ratios[k] * np.exp(1j * (k - 1) * phase)
        elif k % steps == steps - 1:
            total += ratios[k] * np.exp(-1j * (k + 1) * phase)
    return np.asarray(np.angle(total))


def second_harmonic(frames: npt.NDArray[np.float32], shifts_rad: npt.ArrayLike) -> tuple[float, float]:
    """Return B_2 / B_1 of one group of equal steps, `frames` (n, pixels) with n >= 4, and how evenly phases are seen.

    The second harmonic leaves the phase of four steps alone, and shows in their misfit to a sinusoid: the first sign
    that a tone curve is not what it was. The second value is the mean of exp(i phase), 0 where every phase is seen
    alike; above 0.3 the first one means little.

    Raises
    ------
    ValueError
        fewer than four steps: three fit any sinusoid.
    """
    shifts = np.asarray(shifts_rad, np.float64)
    if len(shifts) < 4:
        raise ValueError(f"{len(shifts)} steps hide the second harmonic; 4 or more show it")
    design = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    null = np.linalg.svd(design.T)[2][3:]
    solved = (np.concatenate([np.linalg.pinv(design), null]) @ frames).astype(np.float32)
    fringe = solved[1] + 1j * solved[2]
    size = np.maximum(np.abs(fringe), np.float32(1e-6))
    unit = fringe / size
    waves = np.tensordot(null @ np.exp(2j * shifts), unit * fringe, 0).real
    amplitude = float(np.vdot(waves, solved[3:])) / max(float(np.vdot(waves, waves)), 1e-12)
    return amplitude, float(abs(unit.mean()))
