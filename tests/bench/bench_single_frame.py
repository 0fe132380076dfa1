"""Single frames, unknown shifts and colours, 1392 x 1040: times and errors, beside textbook versions in plain NumPy.

Everything is made from the definition here and timed in turns in one run; medians and bests are printed.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy import fft
from stationkit import figure, info

from fringed_plugins.phase.colours.colour import Colours, balance, three_steps, unmix
from fringed_plugins.phase.colours.one_shot import Carrier, three_carriers
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import transform
from fringed_plugins.phase.single_frame.bands import band_around, find_carrier
from fringed_plugins.phase.single_frame.fourier import analytic_signal, frame_noise, lit, single_frame
from fringed_plugins.phase.single_frame.window_bank import Bank, noise_of_coefficients
from fringed_plugins.phase.single_frame.windowed_fourier import filtered, ridges
from fringed_plugins.phase.unknown.unknown_shifts import estimated_shifts

WIDTH, HEIGHT, ROUNDS = 1392, 1040, 7
X, Y = np.arange(WIDTH), np.arange(HEIGHT)[:, None]
BUMP = np.exp(-((X - 700) ** 2 + (Y - 520) ** 2) / (2 * 180.0**2))
PERIOD = 17.3
PHASE = 2 * np.pi * X / PERIOD + 12 * BUMP
LIGHT = 110 + 25 * np.sin(X / 400) * np.cos(Y / 300)
CONTRAST = 0.6
MIX = np.array([[0.90, 0.08, 0.02], [0.07, 0.85, 0.08], [0.01, 0.09, 0.90]])
INNER = (slice(40, -40), slice(40, -40))
_rng = np.random.default_rng(1)


def frame(phase: Any = PHASE, noise_dn: float = 2.0) -> Any:
    """Return a frame of fringes, float32 of whole grey levels."""
    clean = LIGHT * (1 + CONTRAST * np.cos(phase)) + _rng.normal(0, noise_dn, phase.shape)
    return np.clip(np.rint(clean), 0, 255).astype(np.float32)


def rms(phase: Any, true: Any = PHASE, common: bool = False) -> float:
    """Return the root mean square error away from the borders; a common offset may be taken off."""
    off = np.angle(np.exp(1j * (phase - true)))[INNER]
    if common:
        off = np.angle(np.exp(1j * (off - np.angle(np.nanmean(np.exp(1j * off))))))
    return float(np.sqrt(np.nanmean(off**2)))


def timed(jobs: dict[str, Callable[[], Any]], rounds: int = ROUNDS) -> dict[str, tuple[float, float]]:
    """Run the jobs in turns and return median and best of each, in milliseconds."""
    took: dict[str, list[float]] = {name: [] for name in jobs}
    for job in jobs.values():
        job()
    for _ in range(rounds):
        for name, job in jobs.items():
            start = time.perf_counter()
            job()
            took[name].append((time.perf_counter() - start) * 1e3)
    return {name: (statistics.median(times), min(times)) for name, times in took.items()}


def ours(image: Any) -> Any:
    """Decode one frame with the Fourier transform, carrier search and masks included."""
    saturated = image >= 255
    band = band_around(find_carrier(image, 1 / 20), 0.9, 0.9, 0.5)
    valid = lit(image, saturated, band, 3.0)
    found = analytic_signal(image, valid, band, threads=2)
    return single_frame(found, image, valid, saturated, band, noise=frame_noise(image))


def textbook_fourier(image: Any) -> Any:
    """Takeda & Mutoh 1983 with a Hann band in two dimensions, as one writes it in NumPy."""
    down, right = np.fft.fftfreq(HEIGHT)[:, None], np.fft.fftfreq(WIDTH)[None, :]
    distance = np.hypot(right - 1 / PERIOD, down) / (0.6 / PERIOD)
    window = np.where(distance < 1, 0.5 * (1 + np.cos(np.pi * distance)), 0)
    return np.angle(np.fft.ifft2(np.fft.fft2(image) * window))


def textbook_windows(field: Any, bank: Bank, threshold: float) -> Any:
    """Kemao 2007: every window at every pixel, two transforms of the whole picture each (SciPy, two threads)."""
    down, right = 2 * np.pi * fft.fftfreq(HEIGHT)[:, None], 2 * np.pi * fft.fftfreq(WIDTH)[None, :]
    spectrum, total = fft.fft2(field.astype(np.complex64), workers=2), np.zeros(field.shape, np.complex64)
    for across, along in bank.frequencies():
        window = np.exp(-0.5 * bank.sigma_px**2 * ((down - across) ** 2 + (right - along) ** 2)).astype(np.float32)
        part = fft.ifft2(spectrum * window, workers=2)
        part[np.abs(part) < threshold] = 0
        total += fft.fft2(part, workers=2) * window
    return fft.ifft2(total, workers=2) * 2 / np.pi


def textbook_shifts(stack: Any, asked: Any, rounds: int = 20) -> Any:
    """Wang & Han 2004 on every fourth pixel of every fourth row, `rounds` alternations."""
    pixels = stack[:, ::4, ::4].reshape(len(stack), -1).astype(np.float64)
    shifts = np.asarray(asked, float)
    for _ in range(rounds):
        cosine, sine = transform(shifts)[1:3] @ pixels
        phase = np.arctan2(sine, cosine)
        model = np.stack([np.ones_like(phase), np.cos(phase), -np.sin(phase)], axis=1)
        fit = np.linalg.lstsq(model, pixels.T, rcond=None)[0]
        shifts = np.unwrap(np.arctan2(fit[2], fit[1]))
    return shifts


def fourier() -> None:
    """Print what one frame costs and what its phase is worth."""
    image = frame()
    took = timed({"ours": lambda: ours(image), "textbook": lambda: textbook_fourier(image)})
    median, best = took["ours"]
    figure(
        "fourier: one frame to phase, sigma and mask", f"{median:.0f} ms, best {best:.0f}", "at most 1 s", best < 1000
    )
    info("fourier: textbook, complex double transforms, no masks, no borders", f"{took['textbook'][0]:.0f} ms")
    for noise in (0.0, 2.0, 5.0, 10.0, 20.0):
        image = frame(noise_dn=noise)
        found = ours(image)
        sigma = float(np.nanmedian(found.sigma_rad[INNER]))
        info(
            f"fourier: error at {noise:g} grey levels of noise (modulation 66)",
            f"{rms(found.phase_rad):.4f} rad, stated noise {sigma:.4f}; textbook {rms(textbook_fourier(image)):.4f}",
        )


def windows() -> None:
    """Print what windows cost beside the textbook's, with the same bank and threshold."""
    bank = Bank((0.18, 0.55), (-0.2, 0.2), 10.0)
    noisy = (np.cos(PHASE) + _rng.normal(0, 0.7, PHASE.shape)).astype(np.float32)
    threshold = 3 * noise_of_coefficients(0.7, 10.0, is_complex=False)
    jobs = {
        "filter": lambda: filtered(noisy, bank, threshold, threads=2),
        "ridges": lambda: ridges(noisy, bank, threads=2),
        "textbook": lambda: textbook_windows(noisy, bank, threshold),
    }
    took = timed(jobs, 3)
    ratio = took["textbook"][0] / took["filter"][0]
    figure(
        f"windowed-fourier: filter, {len(bank.frequencies())} windows",
        f"{took['filter'][0]:.0f} ms, best {took['filter'][1]:.0f}; {ratio:.0f} x the textbook",
        "at most 3 s",
        took["filter"][1] < 3000,
    )
    info("windowed-fourier: ridges", f"{took['ridges'][0]:.0f} ms, best {took['ridges'][1]:.0f}")
    found, ridge = filtered(noisy, bank, threshold), ridges(noisy, bank)
    error, other = rms(np.angle(found.field)), rms(np.angle(textbook_windows(noisy, bank, threshold)))
    figure(
        "windowed-fourier: error beside the textbook's",
        f"{error:.4f} and {other:.4f} rad",
        "as good",
        error < 1.1 * other,
    )
    info("windowed-fourier: error of ridges", f"{rms(ridge.phase_rad):.4f} rad")
    for noise in (0.1, 0.3, 0.6):
        field = np.exp(1j * (PHASE + _rng.normal(0, noise, PHASE.shape))).astype(np.complex64)
        cleaned = filtered(field, bank, 3 * noise_of_coefficients(noise, 10.0, is_complex=False), threads=2)
        info(f"windowed-fourier: phase map with {noise:g} rad of noise", f"{rms(np.angle(cleaned.field)):.4f} rad left")


def shifts() -> None:
    """Print how well shifts are found, and what that is worth."""
    for count in (3, 4, 5, 8):
        asked = 2 * np.pi * np.arange(count) / count
        true = asked + _rng.normal(0, 0.3, count)
        stack = np.stack([frame(PHASE + s) for s in true]).astype(np.uint8)
        noise = NoiseModel(4.1, 0.0)
        found = estimated_shifts(stack, asked, noise)
        book = textbook_shifts(stack, asked)
        off, off_book = (np.asarray(s) - true for s in (found.shifts_rad, book))
        took = timed(
            {"ours": partial(estimated_shifts, stack, asked, noise), "book": partial(textbook_shifts, stack, asked)}, 3
        )
        worst, worst_book = (float(np.abs(np.angle(np.exp(1j * (o - np.angle(np.exp(1j * o).mean()))))).max())
                             for o in (off, off_book))  # fmt: skip
        figure(
            f"unknown-shifts: {count} frames, shifts wrong by 0.3 rad",
            f"found within {worst:.1e} rad (stated {max(found.sigma_rad):.1e}), {took['ours'][0]:.0f} ms; "
            f"textbook {worst_book:.1e}, {took['book'][0]:.0f} ms",
            "within 5e-3 rad", found.converged and worst < 5e-3,
        )  # fmt: skip
        decoded = [np.arctan2(*(transform(s)[2:0:-1] @ stack.reshape(count, -1)).reshape(2, HEIGHT, WIDTH))
                   for s in (found.shifts_rad, asked)]  # fmt: skip
        errors = [rms(phase, common=True) for phase in decoded]
        info(
            f"unknown-shifts: {count} frames, phase error",
            f"{errors[0]:.4f} rad; with the asked shifts {errors[1]:.4f}",
        )


def colours() -> None:
    """Print one-shot errors with and without unmixing, on a grey and on a mildly coloured surface."""
    steps = tuple(2 * np.pi * np.arange(3) / 3)
    light = np.stack([(1 + np.cos(PHASE + s)) / 2 for s in steps])
    noise, limits = NoiseModel(1.5**2 + 1 / 12, 0.0), Thresholds(saturation_dn=255.0)
    known, none = Colours(MIX, (2.0, 2.0, 2.0)), Colours(np.eye(3), (2.0, 2.0, 2.0))
    for name, surface in (("grey", (1.0, 1.0, 1.0)), ("mildly coloured (1, .8, .65)", (1.0, 0.8, 0.65))):
        clean = 2 + 200 * np.einsum("cj,jhw->chw", MIX, np.reshape(surface, (3, 1, 1)) * light)
        seen = np.clip(np.rint(clean + _rng.normal(0, 1.5, clean.shape)), 0, 255).astype(np.uint8)
        for method in ("none", "global", "local"):
            for how, colours_ in (("unmixed", known), ("raw", none)):
                gains = balance(unmix(seen, colours_), method, period_px=PERIOD)  # type: ignore[arg-type]
                found = three_steps(seen, steps, colours_, noise, limits, gains=gains, threads=2)
                sigma = float(np.nanmedian(found.sigma_rad))
                info(f"one-shot-phase-shift: {name}, balance {method}, {how}",
                     f"{rms(found.phase_rad):.4f} rad, stated noise {sigma:.4f}")  # fmt: skip
    gains = balance(unmix(seen, known), "local", period_px=PERIOD)
    phase = partial(three_steps, seen, steps, known, noise, limits, gains=gains, threads=2)
    took = timed({"unmix": partial(unmix, seen, known, 2), "phase": phase, "copy": seen.copy})
    info("one-shot-phase-shift: unmixing; unmixing, phase, sigma and mask; a copy of the frames",
         "; ".join(f"{median:.1f} ms, best {best:.1f}" for median, best in took.values()))  # fmt: skip


def frequencies() -> None:
    """Print what three carriers in one exposure give."""
    column = np.linspace(60, 960, WIDTH) + 25 * BUMP
    carriers = [Carrier(1024 / n, 0.0, NoiseModel(1.5**2, 0.0)) for n in (40, 59, 96)]
    light = np.stack([(1 + np.cos(2 * np.pi * column / c.period_px)) / 2 for c in carriers])
    for name, unmixed in (("unmixed", True), ("raw", False)):
        clean = 2 + 200 * np.einsum("cj,jhw->chw", MIX, light)
        seen = np.clip(np.rint(clean + _rng.normal(0, 1.5, clean.shape)), 0, 255).astype(np.uint8)
        channels = unmix(seen, Colours(MIX if unmixed else np.eye(3), (2.0, 2.0, 2.0)), 2)
        job = partial(three_carriers, channels, seen.max(axis=0) >= 255, carriers, 1024, threads=2)
        found = job()
        off = found.phase_rad * 1024 / 96 / (2 * np.pi) - column
        median, best = timed({"job": job}, 3)["job"]
        wrong = float(np.nanmean(np.abs(off[np.isfinite(off)]) > 5))
        figure(
            f"one-shot-frequencies: {name}",
            f"{np.sqrt(np.nanmean(off**2)):.3f} px, {wrong:.1e} of the orders wrong, "
            f"{np.isfinite(off).mean():.0%} kept, {median:.0f} ms, best {best:.0f}",
            "orders wrong under 1e-4", wrong < 1e-4,
        )  # fmt: skip


if __name__ == "__main__":
    fourier()
    windows()
    shifts()
    colours()
    frequencies()
