"""Every fringe method on the same surfaces: error against noise, steps and gamma, frames, time.

Seen by an independent generator (`analytic.py`), 512 x 160 camera pixels, 1024 projector columns; the errors are in
projector pixels. docs/methods/comparison.md shows the same as pictures.

    python tests/bench/bench_methods.py [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from analytic import Conditions, Errors, Scene, errors_of, relief, see, without_noise
from stationkit import info

from fringed.data import Calibration, FrameSet, Lens, PatternSequence, PhaseMap
from fringed.hookspecs import ProjectorTarget
from fringed.loading import Catalogue, load_plugins
from fringed.testing import RecordingContext

WIDTH_PX, HEIGHT_PX = 1024, 768
SNRS = (50.0, 25.0, 12.0, 6.0, 3.0)
GAMMAS = (1.0, 1.4, 1.8, 2.2, 2.6)
STEPS = tuple(range(3, 13))
SKIN = (1.0, 0.7, 0.55)  # what a surface reflects of red, green and blue


@dataclass(frozen=True)
class Method:
    """One way from patterns to phase.

    `spatial` names the unwrapping that follows a wrapped phase; `seen` are conditions of the method's own: a projector
    out of focus, a coloured surface.
    """

    label: str
    encoder: str
    decoder: str
    params: Mapping[str, Any] = field(default_factory=dict)
    decoding: Mapping[str, Any] = field(default_factory=dict)
    spatial: str = ""
    seen: Mapping[str, Any] = field(default_factory=dict)


_DITHERED = {"periods": 32, "steps": 4, "style": "binary-dithered"}
METHODS = (
    Method("phase-shift N=3", "phase-shift", "phase-shift", {"periods": 64, "steps": 3}),
    Method("phase-shift N=4", "phase-shift", "phase-shift", {"periods": 64, "steps": 4}),
    Method("phase-shift N=6", "phase-shift", "phase-shift", {"periods": 64, "steps": 6}),
    Method("phase-shift N=8", "phase-shift", "phase-shift", {"periods": 64, "steps": 8}),
    Method("double steps 2 x 3", "phase-shift", "phase-shift", {"periods": 64, "steps": 3, "double": True}),
    Method("complements 2 x 3", "phase-shift", "phase-shift", {"periods": 64, "steps": 3, "inverse": True}),
    Method("dithered, blur 3 px", "phase-shift", "phase-shift", _DITHERED, {}, "", {"blur_px": 3.0}),
    Method("unknown-shifts N=5", "phase-shift", "unknown-shifts", {"periods": 64, "steps": 5}),
    Method("spatial unwrapping N=4", "phase-shift", "phase-shift", {"periods": 64, "steps": 4}, {}, "quality-guided"),
    Method("multi-frequency 3 x 4", "multi-frequency", "multi-frequency"),
    Method("multi-frequency 3 x 3", "multi-frequency", "multi-frequency", {"steps": 3}),
    Method("heterodyne", "heterodyne", "heterodyne"),
    Method("number-theoretic", "number-theoretic", "number-theoretic"),
    Method("gray-phase-shift", "gray-phase-shift", "gray-phase-shift"),
    Method("gray-code", "gray-code", "gray-code"),
    Method("fourier", "fourier", "fourier"),
    Method("windowed-fourier", "fourier", "windowed-fourier"),
    Method("one-shot-phase-shift", "one-shot-phase-shift", "one-shot-phase-shift"),
    Method("one-shot, coloured", "one-shot-phase-shift", "one-shot-phase-shift", {}, {}, "", {"colour": SKIN}),
    Method("one-shot-frequencies", "one-shot-frequencies", "one-shot-frequencies"),
    Method("one-shot-freq., coloured", "one-shot-frequencies", "one-shot-frequencies", {}, {}, "", {"colour": SKIN}),
)


def available(catalogue: Catalogue) -> list[Method]:
    """Return the methods whose plug-ins are installed."""
    encoders, decoders = catalogue.provided["encoder"], catalogue.provided["processor"]
    usable = [m for m in METHODS if m.encoder in encoders and m.decoder in decoders]
    return [m for m in usable if not m.spatial or "unwrap" in decoders]


def encoded(catalogue: Catalogue, method: Method, tone_curve: Any = None, **changes: Any) -> PatternSequence:
    """Return the method's patterns; `tone_curve` (256,) makes the light sinusoidal."""
    encoder = catalogue.get("encoder", method.encoder)
    params = encoder.Params(**{**method.params, **changes})
    return encoder().encode(params, ProjectorTarget(WIDTH_PX, HEIGHT_PX, tone_curve))


def decoded(catalogue: Catalogue, method: Method, frames: FrameSet, crosstalk: Any = None) -> PhaseMap:
    """Return the method's phase map."""
    decoder, context = catalogue.get("processor", method.decoder), RecordingContext(threads=2)
    inputs: dict[str, Any] = {decoder_input(decoder): frames}
    if crosstalk is not None and "calibration" in decoder.inputs:
        inputs["calibration"] = colours(crosstalk)
    phase: PhaseMap = decoder().run(inputs, decoder.Params(**method.decoding), context)
    if not method.spatial:
        return phase
    unwrap = catalogue.get("processor", "unwrap")
    spatial: PhaseMap = unwrap().run({"phase": phase}, unwrap.Params(method=method.spatial), context)
    return spatial


def decoder_input(decoder: Any) -> str:
    return next(
        name for name, kind in decoder.inputs.items() if kind is FrameSet or FrameSet in getattr(kind, "__args__", ())
    )


def colours(crosstalk: Any) -> Calibration:
    """Return a calibration that knows nothing but the colours."""
    lens = Lens(WIDTH_PX, HEIGHT_PX, np.eye(3), np.zeros(5))
    return Calibration(lens, lens, np.eye(4), "analytic", "test", crosstalk=np.asarray(crosstalk, float))


def measured(catalogue: Catalogue, method: Method, scene: Scene, how: Conditions, curve: Any = None) -> Errors:
    """Return the method's errors on a scene; where it refuses the frames nothing is kept."""
    from analytic import CROSSTALK

    from fringed.errors import DataError

    frames = see(encoded(catalogue, method, curve), scene, replace(how, **method.seen))
    try:
        return errors_of(decoded(catalogue, method, frames, CROSSTALK / CROSSTALK.sum(axis=1, keepdims=True)), scene)
    except DataError:
        return Errors(float("nan"), 0.0, 0.0, float("nan"))


def tone_curve(gamma: float) -> Any:
    """Return the light of each grey level."""
    return (np.arange(256) / 255.0) ** gamma


def steps_tables(catalogue: Catalogue) -> dict[str, list[float]]:
    """Return RMS errors in pixels against the number of steps of 16 px: noise alone, then three gammas alone."""
    scene = relief()
    found: dict[str, list[float]] = {}
    for steps in STEPS:
        method = Method("", "phase-shift", "phase-shift", {"periods": 64, "steps": steps})
        noisy = measured(catalogue, method, scene, Conditions(snr=SNRS[1]))
        found.setdefault(f"noise, SNR {SNRS[1]:g}", []).append(noisy.rms_px)
        found.setdefault("predicted", []).append(noisy.sigma_px)
        for gamma in GAMMAS[1:4]:
            bent = measured(catalogue, method, scene, without_noise(Conditions(), gamma=gamma))
            found.setdefault(f"gamma {gamma:g}", []).append(bent.rms_px)
    return found


def timed(work: Callable[[], Any]) -> float:
    """Return how many seconds `work` takes."""
    begun_s = time.perf_counter()
    work()
    return time.perf_counter() - begun_s


def tables(catalogue: Catalogue, methods: Sequence[Method]) -> dict[str, Any]:
    """Return everything that the comparison shows, by method."""
    smooth, stepped, large = relief(), relief(steps=True), relief(1392, 1040, slope=0.62)
    found: dict[str, Any] = {}
    for method in methods:
        sequence = encoded(catalogue, method)
        frames = see(sequence, large, Conditions(**method.seen))
        kind = decoded(catalogue, method, frames).kind  # compiled now
        seconds = [timed(lambda m=method, f=frames: decoded(catalogue, m, f)) for _ in range(5)]
        shots = {f.shot for f in sequence.frames if f.shot >= 0}
        found[method.label] = {
            "exposures": len(shots) or len(sequence.frames),
            "absolute": kind == "absolute",
            "ms": 1e3 * float(np.median(seconds)),
            "noise": [asdict(measured(catalogue, method, smooth, Conditions(snr=snr))) for snr in SNRS],
            "steps": [asdict(measured(catalogue, method, stepped, Conditions(snr=snr))) for snr in SNRS],
            "gamma": [
                asdict(measured(catalogue, method, smooth, without_noise(Conditions(), gamma=g))) for g in GAMMAS
            ],
            "compensated": [
                asdict(measured(catalogue, method, smooth, without_noise(Conditions(), gamma=g), tone_curve(g)))
                for g in GAMMAS
            ],
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write everything there too")
    asked = parser.parse_args()
    catalogue = load_plugins()
    found = tables(catalogue, available(catalogue))
    print(
        f"{'':24}exposures  ms/1.45 MP  RMS px at SNR 50 / 25 / 12 / 6 / 3             kept at 6   wrong on steps at 12"
    )
    for label, row in found.items():
        noise = " ".join(f"{point['rms_px']:7.3f}" for point in row["noise"])
        print(f"{label:24}{row['exposures']:6}{row['ms']:12.0f}    {noise}      {row['noise'][3]['kept']:8.1%}"
              f"    {row['steps'][2]['wrong']:8.2%}")  # fmt: skip
    print(f"\n{'':24}RMS px without noise at gamma 1 / 1.4 / 1.8 / 2.2 / 2.6    and precompensated")
    for label, row in found.items():
        plain, made = (" ".join(f"{point['rms_px']:7.4f}" for point in row[key]) for key in ("gamma", "compensated"))
        print(f"{label:24}{plain}    {made}")
    print(f"\n{'RMS px of 16 px at N =':24}" + " ".join(f"{steps:7}" for steps in STEPS))
    for label, errors in steps_tables(catalogue).items():
        print(f"{label:24}" + " ".join(f"{error:7.4f}" for error in errors))
    info("methods compared", f"{len(found)} of {len(METHODS)}")
    if asked.json:
        asked.json.write_text(json.dumps(found))


if __name__ == "__main__":
    main()
