"""Draw docs/pictures/single-frame.png: one frame with a carrier, its band, its phase, and errors against noise.

    python tools/pictures/single_frame.py

The scene is made from its definition: a smooth relief with a step, a shadow and a glare.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from fringed_client.pictures.figures import INK, colour_bar, figure, labelled, save, titled
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.single_frame.bands import Band, band_around, find_carrier
from fringed_plugins.phase.single_frame.fourier import SingleFrame, analytic_signal, frame_noise, lit, single_frame
from fringed_plugins.phase.single_frame.window_bank import Bank, noise_of_coefficients
from fringed_plugins.phase.single_frame.windowed_fourier import filtered, ridges

PICTURES = Path(__file__).resolve().parents[2] / "docs" / "pictures"
HEIGHT, WIDTH, PERIOD = 300, 420, 15.0
X, Y = np.arange(WIDTH), np.arange(HEIGHT)[:, None]
RELIEF = 2 * np.pi * X / PERIOD + 6 * np.exp(-((X - 200) ** 2 + (Y - 150) ** 2) / (2 * 60.0**2))
LIGHT = 110 + 25 * np.sin(X / 130) * np.cos(Y / 100)
MODULATION = 0.6 * LIGHT
INNER = (slice(30, -30), slice(30, -30))
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def scene() -> tuple[Any, Any]:
    """Return the frame and the phase that it shows."""
    phase = RELIEF + 2.2 * ((X > 300) & (Y > 180))
    frame = LIGHT + MODULATION * np.cos(phase) + np.random.default_rng(1).normal(0, 2, phase.shape)
    frame[40:90, 40:110] = 14
    frame[210:250, 70:120] = 260
    return np.clip(np.rint(frame), 0, 255).astype(np.float32), phase


def decoded(frame: Any) -> tuple[SingleFrame, Band]:
    """Decode a frame as the plug-in does."""
    band = band_around(find_carrier(frame, 1 / 18), 0.9, 0.9, 0.5)
    saturated = frame >= 255
    valid = lit(frame, saturated, band, 3.0)
    found = analytic_signal(frame, valid, band)
    return single_frame(found, frame, valid, saturated, band, noise=frame_noise(frame)), band


def error(phase: Any, true: Any) -> Any:
    """Return the wrapped error."""
    return np.angle(np.exp(1j * (phase - true)))


def against_noise(axes: Any) -> None:
    """Draw the error of each method against noise, on the relief alone."""
    levels = np.array([0.5, 1, 2, 4, 8, 16, 32])
    lines: dict[str, list[float]] = {}
    for noise in levels:
        frame = (LIGHT + MODULATION * np.cos(RELIEF) + np.random.default_rng(2).normal(0, noise, RELIEF.shape)).astype(
            np.float32
        )
        band = Band(1 / PERIOD, 0.0, 0.9 / PERIOD, 0.9 / PERIOD)
        found = analytic_signal(frame, np.ones(frame.shape, bool), band)
        kept = single_frame(
            found, frame, np.ones(frame.shape, bool), np.zeros(frame.shape, bool), band,
            noise=NoiseModel(float(noise**2), 0.0),
        )  # fmt: skip
        carrier = 2 * np.pi / PERIOD
        bank = Bank((0.1 * carrier, 1.9 * carrier), (-0.9 * carrier, 0.9 * carrier), PERIOD)
        threshold = 3 * noise_of_coefficients(float(noise), PERIOD, is_complex=False)
        phases = {
            "fourier": np.arctan2(found.sine, found.cosine),
            "windowed-fourier, filter": np.angle(filtered(found.continued, bank, threshold, periodic=True).field),
            "windowed-fourier, ridges": ridges(found.continued, bank, periodic=True).phase_rad,
            "Takeda in three lines": _textbook(frame),
        }
        for name, phase in phases.items():
            off = error(phase[:HEIGHT, :WIDTH], RELIEF)[INNER]
            lines.setdefault(name, []).append(float(np.sqrt(np.mean(off**2))))
        lines.setdefault("stated noise of fourier", []).append(float(np.nanmedian(kept.sigma_rad)))
    for (name, values), colour, mark in zip(lines.items(), (*COLOURS, INK), "osD^ ", strict=True):
        style = {"linestyle": "--", "linewidth": 1.0} if mark == " " else {"marker": mark, "markersize": 4}
        axes.loglog(levels / np.mean(MODULATION), values, color=colour, label=name, **style)
    axes.legend(fontsize=7, frameon=False)
    axes.grid(alpha=0.3)
    titled(axes, "error against noise", simulated=False)
    labelled(axes, "noise of a frame over the modulation", "rms error (rad)")


def _textbook(frame: Any) -> Any:
    down, right = np.fft.fftfreq(HEIGHT)[:, None], np.fft.fftfreq(WIDTH)[None, :]
    distance = np.hypot(right - 1 / PERIOD, down) * PERIOD / 0.6
    return np.angle(np.fft.ifft2(np.fft.fft2(frame) * np.where(distance < 1, 1 + np.cos(np.pi * distance), 0)))


def cleaned(axes: Any) -> Any:
    """Draw a noisy phase map, and the same filtered, side by side."""
    noisy = RELIEF + np.random.default_rng(3).normal(0, 0.6, RELIEF.shape)
    carrier = 2 * np.pi / PERIOD
    bank = Bank((0.5 * carrier, 1.5 * carrier), (-0.25, 0.25), 10.0)
    threshold = 3 * noise_of_coefficients(0.6, 10.0, is_complex=False)
    clear = filtered(np.exp(1j * noisy).astype(np.complex64), bank, threshold)
    both = np.where(X < WIDTH / 2, error(noisy, 0), np.angle(clear.field))
    image = axes.imshow(both[90:210, 130:290], cmap="twilight", interpolation="nearest", vmin=-np.pi, vmax=np.pi)
    left, right = (float(np.std(error(p, RELIEF)[INNER])) for p in (noisy, np.angle(clear.field)))
    titled(axes, f"noisy map ({left:.2f} rad), filtered ({right:.3f})", simulated=False)
    axes.set_xticks([])
    axes.set_yticks([])
    return image


def small(path: Path, colours: int = 224) -> None:
    """Write the picture again with few colours: noise does not compress."""
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(colours, dither=Image.Dither.NONE).save(path, optimize=True)


def main() -> None:
    """Draw the picture."""
    frame, true = scene()
    found, band = decoded(frame)
    drawn = figure(12.0, 6.0)
    axes = drawn.subplots(2, 3).ravel()
    axes[0].imshow(frame, cmap="gray", interpolation="nearest")
    titled(axes[0], "one frame: relief, step, shadow, glare", simulated=False)
    spectrum = np.fft.fftshift(
        np.abs(np.fft.fft2((frame - frame.mean()) * np.outer(np.hanning(HEIGHT), np.hanning(WIDTH))))
    )
    half = np.log10(spectrum[:, WIDTH // 2 : WIDTH // 2 + 90] + 1)
    axes[1].imshow(half, cmap="magma", extent=(0, 90 / WIDTH, 0.5, -0.5), aspect="auto", vmin=1.5)
    turn = np.linspace(0, 2 * np.pi, 100)
    axes[1].plot(band.along + band.half_along * np.cos(turn), band.across + band.half_across * np.sin(turn), color="w")
    axes[1].set_ylim(-0.12, 0.12)
    titled(axes[1], "spectrum, and the band that is kept", simulated=False)
    labelled(axes[1], "along (cycles / px)", "across (cycles / px)")
    axes[2].set_facecolor("#d9d9d4")
    image = axes[2].imshow(found.phase_rad, cmap="twilight", interpolation="nearest")
    titled(axes[2], "its phase; grey: dropped, with a reason", simulated=False)
    colour_bar(drawn, image, axes[2], "rad")
    axes[3].set_facecolor("#d9d9d4")
    image = axes[3].imshow(error(found.phase_rad, true), cmap="RdBu_r", vmin=-0.1, vmax=0.1, interpolation="nearest")
    titled(axes[3], "error: small but beside steps and borders", simulated=False)
    colour_bar(drawn, image, axes[3], "rad", extend="both")
    against_noise(axes[4])
    colour_bar(drawn, cleaned(axes[5]), axes[5], "rad")
    for index in (0, 2, 3):
        axes[index].set_xticks([])
        axes[index].set_yticks([])
    small(save(drawn, PICTURES / "single-frame.png"))


if __name__ == "__main__":
    main()
