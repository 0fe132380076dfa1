"""Wrong fringe orders and the share of pixels that stay, for the default set of every temporal method.

The frames come from a few lines here that share nothing with the simulator: a smooth relief, a board of steps and a
face-like relief with a shadow, seen at 1392 x 520 through the encoder's own patterns, with Gaussian noise and 8 bits.
"SNR" is the modulation over the noise of one frame. The noise is told to the decoder, as a station's camera
settings would. Default parameters throughout.

    python tests/bench/bench_orders.py [--height 520]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from stationkit import figure, info

from fringed.data import CameraSettings, FrameSet, PatternSequence, PhaseMap
from fringed.hookspecs import ProjectorTarget
from fringed.testing import RecordingContext
from fringed_plugins.decoders.gray import GrayCodeDecoder, GrayPhaseShiftDecoder
from fringed_plugins.decoders.heterodyne import HeterodyneDecoder
from fringed_plugins.decoders.number_theoretic import NumberTheoreticDecoder
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder
from fringed_plugins.encoders.gray import GrayCodeEncoder, GrayPhaseShiftEncoder
from fringed_plugins.encoders.heterodyne import HeterodyneEncoder
from fringed_plugins.encoders.number_theoretic import NumberTheoreticEncoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder

TARGET = ProjectorTarget(1024, 768)
WIDTH_PX, MODULATION_DN, LIGHT_DN = 1392, 40.0, 80.0
METHODS: dict[str, tuple[Any, Any]] = {
    "multi-frequency": (MultiFrequencyEncoder, MultiFrequencyDecoder),
    "heterodyne": (HeterodyneEncoder, HeterodyneDecoder),
    "number-theoretic": (NumberTheoreticEncoder, NumberTheoreticDecoder),
    "gray-phase-shift": (GrayPhaseShiftEncoder, GrayPhaseShiftDecoder),
    "gray-code": (GrayCodeEncoder, GrayCodeDecoder),
}
RATIOS = (20.0, 10.0, 5.0, 3.0, 2.0)
WRONG_AT_5, WRONG_AT_2 = 1e-4, 1e-2
Image = np.ndarray[Any, Any]


def surfaces(height: int) -> dict[str, tuple[Image, Image]]:
    """Return the projector column that each pixel sees, and its light from 0 to 1."""
    y, x = np.mgrid[:height, :WIDTH_PX].astype(float)
    smooth = 30 + 900 * x / WIDTH_PX + 12 * np.sin(x / 120) * np.cos(y / 140) + 0.02 * y
    steps = smooth + 37.0 * ((x // 120 + y // 100) % 2)
    across, down = (x - WIDTH_PX / 2) / 420, (y - height / 2) / (0.45 * height)
    head = np.clip(1 - across**2 - down**2, 0, None)
    nose = np.exp(-((across / 0.12) ** 2) - ((down - 0.1) / 0.3) ** 2)
    inside = head > 0
    face = 60 + 850 * x / WIDTH_PX + np.where(inside, 60 * np.sqrt(head) + 25 * nose, 0.0)
    shadow = inside & (across > 0.13) & (across < 0.22) & (np.abs(down - 0.1) < 0.25)
    light = np.where(inside & ~shadow, 0.6 + 0.4 * np.sqrt(head), 0.0)
    full = np.ones_like(x)
    return {"smooth": (smooth, full), "steps": (steps, full), "face": (face, light)}


def seen(sequence: PatternSequence, columns: Image, light: Image, ratio: float, seed: int) -> FrameSet:
    """Return the frames; the noise is that of full light at every pixel, so that dim ones have less than `ratio`."""
    rng = np.random.default_rng(seed)
    sigma, grid = MODULATION_DN / ratio, np.arange(TARGET.width_px)
    frames = []
    for pattern in sequence.patterns:
        wave = np.interp(columns, grid, pattern.max(axis=2).ravel().astype(float) / 127.5 - 1)
        frame = LIGHT_DN + light * MODULATION_DN * wave + rng.normal(0, sigma, columns.shape)
        frames.append(np.clip(np.rint(frame), 0, 255).astype(np.uint8))
    many = 1e6  # electrons for a grey level: no shot noise
    settings = CameraSettings(electrons_per_dn=many, read_noise_electrons=sigma * many)
    return FrameSet(np.array(frames), sequence, settings=settings)


def wrong_and_kept(phase: PhaseMap, columns: Image, light: Image) -> tuple[float, float, float]:
    """Return the share of wrong orders among kept pixels, of lit pixels kept, and of unlit ones kept."""
    kept = phase.rejected == 0
    column = (phase.phase_rad - phase.initial_phase_rad) * phase.period_px / (2 * np.pi)
    wrong = kept & ~(np.abs(column - columns) < phase.period_px / 2)
    lit = light > 0
    dark = float(kept[~lit].mean()) if (~lit).any() else 0.0
    return float(wrong.sum() / max(kept.sum(), 1)), float(kept[lit].mean()), dark


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--height", type=int, default=520)
    asked = parser.parse_args()
    views = surfaces(asked.height)
    context = RecordingContext()
    for name, (encoder, decoder) in METHODS.items():
        sequence = encoder().encode(encoder.Params(), TARGET)
        for view, (columns, light) in views.items():
            for number, ratio in enumerate(RATIOS):
                frames = seen(sequence, columns, light, ratio, seed=number)
                start = time.perf_counter()
                phase = decoder().run({"frames": frames}, decoder.Params(), context)
                taken_ms = 1e3 * (time.perf_counter() - start)
                wrong, kept, dark = wrong_and_kept(phase, columns, light)
                what = f"{name} ({len(frames.frames)} frames), {view}, SNR {ratio:g}"
                text = f"{wrong:.1e} of valid points wrong, {kept:.2%} of lit points valid, {taken_ms:.0f} ms"
                text += f"; {dark:.1e} of unlit points valid" if (light == 0).any() else ""
                if ratio == 5.0 and name != "gray-code":
                    figure(what, text, f"wrong under {WRONG_AT_5:g}, most valid", wrong < WRONG_AT_5 and kept > 0.9)
                elif ratio == 2.0 and name != "gray-code":
                    figure(what, text, f"wrong under {WRONG_AT_2:g}, the rest masked", wrong < WRONG_AT_2)
                else:
                    info(what, text)
    peer(views["smooth"])


def peer(view: tuple[Image, Image]) -> None:
    """Print what the library `fringes` makes of the same frames: three frequencies of four steps."""
    try:
        from fringes import Fringes
    except ImportError:
        info("peer fringes", "not installed")
        return
    columns, _ = view
    other = Fringes()
    other.reset()
    other.D, other.X, other.Y = 1, TARGET.width_px, 1
    other.K, other.N, other.v = 3, 4, [1, 8, 64]
    lines = np.asarray(other.encode()).reshape(other.T, -1).astype(float) / 255
    grid = np.arange(TARGET.width_px)
    for ratio in (20.0, 5.0, 2.0):
        rng = np.random.default_rng(1)
        waves = [LIGHT_DN + MODULATION_DN * (2 * np.interp(columns, grid, line) - 1) for line in lines]
        noisy = [wave + rng.normal(0, MODULATION_DN / ratio, columns.shape) for wave in waves]
        stack = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        other.decode(stack[:, :8, :, None], check_overexposure=False)
        start = time.perf_counter()
        found = other.decode(stack[..., None])
        taken_ms = 1e3 * (time.perf_counter() - start)
        column = np.squeeze(np.asarray(found.x)).reshape(columns.shape)
        wrong = float(np.mean(np.abs(column - columns) > 8))
        info(
            f"peer fringes on smooth, SNR {ratio:g}", f"{wrong:.1e} of all points wrong, none masked, {taken_ms:.0f} ms"
        )


if __name__ == "__main__":
    main()
