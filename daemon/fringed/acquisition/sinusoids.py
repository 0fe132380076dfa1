"""Whether an N-step group fits one sinusoid, by horizontal band, beyond what noise explains.

Owns the fit and its misfit; arrays in, arrays out. `I_k = a + c cos(shift_k) + s sin(shift_k)` leaves
N - 3 residual coordinates for each pixel. The misfit of frame k is the frame minus what the others
predict for it (the deleted residual, Cook & Weisberg 1982, ch. 2), because that is the size of the error
of one wrong frame whatever N is.

A projector's tone curve also leaves a residual, harmonics of the *total* phase that are the same in
every frame. They are no fault of a frame: one amplitude for the whole group is fitted (`tone_of`) and
removed (`without_tone`); a group that does not see every phase borrows it from one that does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fringed.acquisition.sampling import Noise, per_band
from fringed.data import Array, Float32Array

NOISE_MARGIN = 1.25  # the noise model may be off by that factor
SIGMAS = 6.0  # a band's misfit counts when it exceeds its own uncertainty that often
MIN_PIXELS = 24  # of a band, below which it says nothing
MODULATION_OVER_NOISE = 6.0
COVERED = 0.3  # the mean of exp(i phase) below which every phase is seen often enough
NEGLIGIBLE = 0.005  # a harmonic that is not worth removing
MIN_MODULATION = 3.0 / 255.0  # of full scale


@dataclass(frozen=True)
class GroupFit:
    """One group's fit on the grid; pixels `(p,)`, `rows` of them.

    `valid` is 1 where the pixel may judge, else 0. `residual`
    `(n - 3, p)` are the coordinates, along the rows of `null` `(n - 3, n)`, of what no sinusoid explains.
    `tone` is the size of the tone curve's harmonics removed from it, as a deleted residual over the modulation,
    `shape` that of the pattern's own. A `loose` group leaves more than noise in its residual, and where it is not
    `clean` its mean is not its background. `before` are the frames shown before each of its own, -1 for none.
    """

    indices: tuple[int, ...]
    shifts_rad: Array
    rows: int
    mean: Float32Array
    cosine: Float32Array
    sine: Float32Array
    power: Float32Array
    valid: Float32Array
    variance: Float32Array
    residual: Float32Array
    null: Float32Array
    tone: float = 0.0
    shape: float = 0.0
    loose: bool = False
    clean: bool = True
    before: tuple[int, ...] = ()

    @property
    def fits_always(self) -> bool:
        """Whether three frames leave nothing to judge."""
        return len(self.null) == 0

    @property
    def freedom(self) -> Array:
        """One minus each frame's leverage, `(n,)`."""
        freedom: Array = np.maximum((self.null * self.null).sum(axis=0), 1e-6)
        return freedom

    def deleted(self, position: int) -> Float32Array:
        """Return the frame at `position` minus what the others predict for it, `(p,)`."""
        return (self.null[:, position] @ self.residual) / np.float32(self.freedom[position])


@dataclass(frozen=True)
class Misfit:
    """Relative misfit by frame and band `(n, bands)`, and what of it is certain."""

    relative: Array
    certain: Array


def fit_group(
    grid: Float32Array, indices: tuple[int, ...], model: tuple[Array, tuple[int, ...]], noise: Noise, top: float
) -> GroupFit:
    """Fit one sinusoid to the frames `indices` of `grid` (n, rows, columns).

    `model` are the shifts and the orders of harmonics that may be anything in every pixel: what these explain is no
    residual. `top` is full scale: pixels that reach it in any frame, or whose modulation is lost in noise, are
    left out.
    """
    shifts_rad, orders = model
    frames = grid[list(indices)].reshape(len(indices), -1)
    design = _design(shifts_rad, (1,))
    null = _null(_design(shifts_rad, (1, *orders)))
    transform = np.concatenate([np.linalg.pinv(design).astype(np.float32), null])
    solved = transform @ frames
    mean, cosine, sine = solved[:3]
    power = cosine * cosine
    power += sine * sine
    variance = noise.variance(mean)
    floor = np.maximum(variance * np.float32(MODULATION_OVER_NOISE**2), np.float32((MIN_MODULATION * top) ** 2))
    valid = ((power > floor) & (frames.max(axis=0) < top)).astype(np.float32)
    return GroupFit(
        indices, shifts_rad, grid.shape[1], mean, cosine, sine, power, valid, variance, solved[3:], null
    )  # fmt: skip


def _design(shifts_rad: Array, orders: tuple[int, ...]) -> Array:
    waves = [wave(order * shifts_rad) for order in orders for wave in (np.cos, np.sin)]
    return np.stack([np.ones_like(shifts_rad), *waves], axis=1)


def _null(design: Array) -> Float32Array:
    """Return an orthonormal basis (n - rank, n) of what the columns of `design` (n, m) do not explain."""
    vectors, singular, _ = np.linalg.svd(design)
    rank = int((singular > 1e-6 * singular[0]).sum())
    return np.ascontiguousarray(vectors[:, rank:].T.astype(np.float32))


def phasor_powers(fit: GroupFit, highest: int) -> dict[int, Array]:
    """Return `modulation exp(i order phase)` (p,) complex64 for the orders 2 to `highest`."""
    unit = ((fit.cosine - 1j * fit.sine) / np.sqrt(np.maximum(fit.power, np.float32(1e-6)))).astype(np.complex64)
    powers, power = {}, (fit.cosine - 1j * fit.sine).astype(np.complex64)
    for order in range(2, highest + 1):
        power = power * unit
        powers[order] = power
    return powers


def tone_of(fit: GroupFit) -> tuple[float, ...] | None:
    """Return the second and third harmonic's amplitude over the modulation; None where it cannot be told.

    It can be told where every phase is seen, so that a harmonic looks like nothing else, and by four or
    more steps. A tone curve has no memory and blur is symmetric, so the amplitudes are real numbers.
    """
    weight = fit.valid / np.sqrt(np.maximum(fit.power, np.float32(1e-6)))
    count = max(float(fit.valid.sum()), 1.0)
    if len(fit.null) == 0 or np.hypot(float(fit.cosine @ weight), float(fit.sine @ weight)) > COVERED * count:
        return None
    amplitudes = []
    for order in (2, 3):
        if np.abs(_response(fit, order)).max() < 1e-3:  # four steps do not see the third
            amplitudes.append(0.0)
            continue
        wave = _harmonic(fit, order)
        amplitudes.append(float(np.vdot(wave, fit.residual)) / max(float(np.vdot(wave, wave)), 1e-9))
    return tuple(amplitudes)


def tone_between(fit: GroupFit, one: tuple[float, ...], other: tuple[float, ...]) -> tuple[float, ...]:
    """Return the amplitudes between two estimates that leave the least of a fit: few phases cannot tell them alone."""
    chosen = []
    for order, a, b in zip((2, 3), one, other, strict=True):
        wave = _harmonic(fit, order)
        power = float(np.vdot(wave, wave))
        own = float(np.vdot(wave, fit.residual)) / power if power > 1e-9 else a
        chosen.append(min(max(own, min(a, b)), max(a, b)))
    return tuple(chosen)


def without_tone(fit: GroupFit, amplitudes: tuple[float, ...]) -> GroupFit:
    """Return the fit without the harmonics of these amplitudes (of orders 2, 3)."""
    residual: Array = fit.residual
    size = 0.0
    for order, amplitude in zip((2, 3), amplitudes, strict=True):
        if len(fit.null) and abs(amplitude) > NEGLIGIBLE:
            residual = residual - np.float32(amplitude) * _harmonic(fit, order)
            response = np.abs(fit.null.T @ _response(fit, order)) / fit.freedom
            size = max(size, abs(amplitude) * float(response.max()) / 2**0.5)
    return replace(fit, residual=residual, tone=size)


def _response(fit: GroupFit, order: int) -> Array:
    """Return the residual's coordinates of a unit harmonic at phase 0, complex `(n - 3,)`."""
    response: Array = (fit.null @ np.exp(1j * order * fit.shifts_rad)).astype(np.complex64)
    return response


def _harmonic(fit: GroupFit, order: int) -> Float32Array:
    """Return what `modulation cos(order (phase + shift))` leaves in the residual's coordinates."""
    scale = fit.valid / np.sqrt(np.maximum(fit.power, np.float32(1e-6)))
    unit_real, unit_imag = fit.cosine * scale, fit.sine * -scale
    real: Array = fit.cosine
    imag: Array = -fit.sine
    for _ in range(order - 1):
        real, imag = real * unit_real - imag * unit_imag, real * unit_imag + imag * unit_real
    response = _response(fit, order)
    wave: Float32Array = (np.outer(response.real, real) - np.outer(response.imag, imag)).astype(np.float32, copy=False)
    return wave


def misfit_of(fit: GroupFit) -> Misfit:
    """Return each frame's deleted residual over the modulation, band by band, noise subtracted.

    Raises
    ------
    ValueError
        the group has three frames, which always fit.
    """
    if fit.fits_always:
        raise ValueError("three frames always fit one sinusoid; compare the group with its siblings instead")
    freedom = fit.freedom[:, None]
    if len(fit.null) == 1:  # one coordinate: every frame's deleted residual is a multiple of it
        energy = per_band(fit.residual[0] ** 2 * fit.valid, fit.rows) * (fit.null[0][:, None] / freedom) ** 2
    else:
        deleted = (fit.deleted(position) for position in range(len(fit.indices)))
        energy = np.stack([per_band(error * error * fit.valid, fit.rows) for error in deleted])
    return relative_misfit(energy, fit, fit.valid, 1.0 / freedom)


def relative_misfit(energy: Array, fit: GroupFit, valid: Float32Array, inflation: Array) -> Misfit:
    """Return error `energy` (n, bands) over the modulation; its noise is the pixel's times `inflation` (n, 1)."""
    signal = np.maximum(per_band(fit.power * valid, fit.rows), 1e-9)
    told = per_band(valid, fit.rows) >= MIN_PIXELS
    variance = fit.variance * valid
    expected = NOISE_MARGIN * inflation * per_band(variance, fit.rows)
    deviation = inflation * np.sqrt(2.0 * per_band(variance * variance, fit.rows))
    excess = np.where(told, energy - expected, 0.0) / signal
    certain = np.where(told, energy - expected - SIGMAS * deviation, 0.0) / signal
    return Misfit(np.sqrt(np.maximum(excess, 0.0)), np.sqrt(np.maximum(certain, 0.0)))
