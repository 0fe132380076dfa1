"""Draw docs/pictures/temporal-unwrapping.png: wrong fringe orders and points that stay, against noise, per method.

    python tools/pictures/temporal_unwrapping.py

The frames come from the analytic surfaces of `tests/bench/bench_orders.py`; default sets, default parameters. The
dashed lines are pixels that stand by themselves (min_window_snr = 0 and every further test off), none of them dropped.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from bench_orders import METHODS, TARGET, seen, surfaces, wrong_and_kept  # noqa: E402

from fringed.testing import RecordingContext  # noqa: E402
from fringed_client.pictures.figures import INK, figure, labelled, save, titled  # noqa: E402

PICTURE = ROOT / "docs" / "pictures" / "temporal-unwrapping.png"
SNRS = (2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 14.0, 20.0)
LEAST = 3e-6
NAMES = [name for name in METHODS if name != "gray-code"]
COLOURS = dict(zip(NAMES, ("#0072b2", "#d55e00", "#009e73", "#cc79a7"), strict=True))  # safe for the colour-blind


def by_themselves(name: str, frames: Any, columns: Any) -> float:
    """Return how many pixels get a wrong order when none is dropped and nothing around them is asked."""
    from fringed_plugins.decoders.absolute import parts_of
    from fringed_plugins.phase.decoded import Thresholds
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.temporal.absolute import search_for, wrapped_phases
    from fringed_plugins.phase.temporal.graybits import layout_of, positions
    from fringed_plugins.phase.temporal.joint import find_orders

    parts = parts_of(frames.sequence, "auto")
    noise = NoiseModel.from_sensor(frames.settings.electrons_per_dn, frames.settings.read_noise_electrons)
    open_ = replace(Thresholds(), modulation_dn=0.0, modulation_snr=0.0, residual=10.0, window_snr=0.0)
    waves = wrapped_phases(frames.frames, parts.groups, noise, open_)
    finest = parts.groups[-1]
    if parts.bits is not None:
        found = positions(frames.frames, layout_of(parts.bits, noise, len(finest.frames)), waves.background, np.inf)
        cells = parts.bits.code.cell_px
        coded = (found.position * cells - 0.5) / finest.period_px
        own = waves.wrapped_rad[-1] / (2 * np.pi)
        turns = own + np.rint(coded - own)
    else:
        search = search_for(parts.groups, noise, parts.size_px, systematic_rad=0.0, combine=False)
        turns = find_orders(waves.wrapped_rad, waves.modulation, waves.background, search).turns
    return float((np.abs(turns * finest.period_px - columns) > finest.period_px / 2).mean())


def measure() -> dict[str, dict[str, list[float]]]:
    """Return, for each method, the shares at every SNR."""
    views = surfaces(260)
    found: dict[str, dict[str, list[float]]] = {}
    for name in NAMES:
        encoder, decoder = METHODS[name]
        sequence = encoder().encode(encoder.Params(), TARGET)
        rows: dict[str, list[float]] = {"alone": [], "wrong": [], "steps": [], "kept": []}
        for number, ratio in enumerate(SNRS):
            for view in ("smooth", "steps"):
                columns, light = views[view]
                frames = seen(sequence, columns, light, ratio, seed=number)
                phase = decoder().run({"frames": frames}, decoder.Params(), RecordingContext())
                wrong, kept, _ = wrong_and_kept(phase, columns, light)
                if view == "smooth":
                    rows["alone"].append(by_themselves(name, frames, columns))
                    rows["wrong"].append(wrong)
                    rows["kept"].append(kept)
                else:
                    rows["steps"].append(wrong)
        found[name] = rows
    return found


def main() -> None:
    found = measure()
    drawn = figure(10.5, 4.2)
    orders, stay = drawn.subplots(1, 2, gridspec_kw={"width_ratios": [1.6, 1]})
    for name, rows in found.items():
        orders.plot(SNRS, np.maximum(rows["alone"], LEAST), "--", color=COLOURS[name], linewidth=1.1)
        orders.plot(SNRS, np.maximum(rows["steps"], LEAST), "o-", color=COLOURS[name], markersize=4, label=name)
        stay.plot(SNRS, 100 * np.array(rows["kept"]), "o-", color=COLOURS[name], markersize=4)
    orders.set_yscale("log")
    orders.set_ylim(LEAST * 0.7, 1.5)
    orders.axhline(1e-4, color=INK, linewidth=0.7, linestyle=":")
    orders.text(20, 1.15e-4, "1 of 10,000", ha="right", va="bottom", fontsize=8, color=INK)
    orders.text(3.7, 0.3, "dashed: each pixel by itself, none dropped", fontsize=8, color=INK)
    orders.text(2.25, 2.5e-5, "dots: default parameters", fontsize=8, color=INK)
    orders.legend(fontsize=8, loc="upper right", frameon=False)
    stay.set_ylim(94, 100.3)
    titled(orders, "Wrong fringe orders on a board with steps", simulated=False)
    titled(stay, "Points that stay (smooth relief)", simulated=False)
    labelled(orders, "", "share of the points that stay")
    labelled(stay, "", "%")
    for axes in (orders, stay):
        axes.set_xscale("log")
        axes.set_xticks([2, 3, 5, 7, 10, 20], ["2", "3", "5", "7", "10", "20"])
        axes.minorticks_off()
        axes.set_xlabel("modulation over the noise of one frame", fontsize=9, color=INK)
        axes.grid(alpha=0.3)
    orders.set_yticks([LEAST, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1], ["none", *(f"$10^{{{n}}}$" for n in range(-5, 0)), "1"])
    orders.minorticks_off()
    save(drawn, PICTURE)


if __name__ == "__main__":
    main()
