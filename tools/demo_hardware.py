"""The real drivers on an emulated laboratory, against the pure simulation: the same phase map, to the sensor's noise.

Real are the drivers, the window, the X server's scan-out, the serial ports' bytes, USB3 Vision's bytes, the daemon and
its pipeline; simulated are the photons between the frame buffer and the sensor. Both scans see the same scene with the
same exposure and other noise. Then every cable is pulled once and put back.

    .venv/bin/python tools/demo_hardware.py --output demo-hardware
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from emulated import EmulatedStation, emulated_station  # noqa: E402

from fringed.data import PhaseMap, RangeImage  # noqa: E402
from fringed.emulators.lab import BRIDGE  # noqa: E402
from fringed.errors import FringedError  # noqa: E402
from fringed_client.pictures.maps import draw_depth, draw_map  # noqa: E402
from fringed_client.private import SIMULATED_RIG, PrivateStation  # noqa: E402

SCENE = {"object": "face"}
SHOWN_S, READY_S = 1.0, 5.0
SPREAD = 0.1  # of the predicted noise: how much more the difference may scatter
OFF_SIGMA = 0.1  # of the noise: its median
CABLES = {
    "projector's serial cable": ("cpx260", "projector", {"do": "unplug", "seconds": 600}, {"do": "plug"}),
    "camera's serial cable": ("ms3100", "camera", {"do": "unplug"}, {"do": "plug"}),
    "camera's USB cable": (BRIDGE, "camera", {"do": "unplug"}, {"do": "plug"}),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("demo-hardware"))
    parser.add_argument("--small", action="store_true", help="a small sensor: quicker, for tests")
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    simulation = {"scene": SCENE, "seed": 1}
    if asked.small:
        simulation["sensor"] = {"width_px": 348, "height_px": 260}
    report: dict[str, Any] = {"simulated": "the photons alone", "figures": []}
    with emulated_station(asked.output / "station", simulation) as station:
        told(report, "both devices ready after the start", station.wait_ready(), "s", None)
        began = time.perf_counter()
        emulated = station.client.scan(timeout_s=180.0)
        told(report, "first scan, the display's delay measured before", time.perf_counter() - began, "s", None)
        began = time.perf_counter()
        emulated = station.client.scan(timeout_s=180.0)
        told(report, "another scan", time.perf_counter() - began, "s", None)
        frames = emulated.frame_sets["object"]
        pure = purely_simulated(simulation, frames.settings.exposure_us)
        compare(report, emulated, pure, asked.output)
        for name, cable in CABLES.items():
            pulled(report, station, name, cable)
        again = station.client.scan(timeout_s=180.0)
        told(report, "kept pixels of a scan after all that", float((again.range_image.rejected == 0).mean()), "", None)
    (asked.output / "report.json").write_text(json.dumps(report, indent=1))
    print(f"INFO  report and pictures are in {asked.output}")
    return 0 if all(figure["good"] is not False for figure in report["figures"]) else 1


def purely_simulated(simulation: dict[str, Any], exposure_us: float) -> Any:
    """Return the same scan without any device: other noise, the same exposure."""
    rig = {**SIMULATED_RIG, "simulation": {**simulation, "seed": 2, "real_time": False}}
    with PrivateStation(rig) as station:
        result = station.scan(camera={"channel": "green", "exposure_us": exposure_us})
        _ = result.phase_map, result.range_image, result.frame_sets["object"]  # fetched while the station is there
        return result


def compare(report: dict[str, Any], emulated: Any, pure: Any, folder: Path) -> None:
    """Compare phase maps and range images pixel by pixel."""
    a, b = emulated.phase_map, pure.phase_map
    assert isinstance(a, PhaseMap) and isinstance(b, PhaseMap)
    both = (a.rejected == 0) & (b.rejected == 0)
    told(
        report,
        "pixels that one keeps and the other does not",
        float(((a.rejected == 0) != (b.rejected == 0)).mean()),
        "",
        0.01,
    )
    off = np.where(both, a.phase_rad.astype(np.float64) - b.phase_rad, np.nan)
    expected = np.sqrt(a.sigma_rad[both].astype(np.float64) ** 2 + b.sigma_rad[both].astype(np.float64) ** 2)
    scaled = off[both] / expected
    told(report, "phase maps: median difference, in its noise", float(abs(np.median(scaled))), "sigma", OFF_SIGMA)
    spread = 1.4826 * float(np.median(np.abs(scaled - np.median(scaled))))
    told(report, "phase maps: scatter of the difference, in its noise", spread, "sigma", 1 + SPREAD)
    draw_map(folder / "phase-difference.png", np.clip(scaled_map(off, both, expected), -4, 4),
             "emulated hardware against pure simulation", "difference / sigma", simulated=True)  # fmt: skip
    x, y = emulated.range_image, pure.range_image
    assert isinstance(x, RangeImage) and isinstance(y, RangeImage)
    kept = (x.rejected == 0) & (y.rejected == 0)
    depth = x.xyz_mm[..., 2][kept].astype(np.float64) - y.xyz_mm[..., 2][kept]
    told(report, "range images: median difference in depth", float(abs(np.median(depth))), "mm", 0.005)
    told(report, "range images: scatter", 1.4826 * float(np.median(np.abs(depth - np.median(depth)))), "mm", None)
    draw_depth(folder / "depth.png", x)


def scaled_map(off: Any, both: Any, expected: Any) -> Any:
    """Return the difference in units of its noise, NaN where one of both is rejected."""
    out = np.full(off.shape, np.nan)
    out[both] = off[both] / expected
    return out


def pulled(report: dict[str, Any], station: EmulatedStation, name: str, cable: tuple[str, str, Any, Any]) -> None:
    """Pull a cable, see how soon the state says so, put it back, and see how soon the device is ready."""
    emulator, device, pull, put = cable
    station.wait_ready()
    station.lab.order(emulator, **pull)
    shown = station.wait(lambda states: states[device] in {"ABSENT", "CONNECTING", "FAULT"}, 30.0)
    told(report, f"{name}: unplugged to shown", shown, "s", SHOWN_S)
    try:
        station.client.scan(timeout_s=60.0)
        told(report, f"{name}: a scan without it", 0.0, "was taken", -1.0)
    except FringedError as error:
        print(f"INFO  {name}: a scan without it: {error.message[:160]}")
    station.lab.order(emulator, **put)
    told(report, f"{name}: plugged to ready", station.wait_ready(), "s", READY_S)


def told(report: dict[str, Any], what: str, value: float, unit: str, most: float | None) -> None:
    """Print a figure beside what it has to reach, and keep it."""
    good = None if most is None else bool(value <= most)
    report["figures"].append({"what": what, "value": value, "unit": unit, "most": most, "good": good})
    verdict = {None: "INFO", True: "PASS", False: "MISS"}[good]
    limit = "" if most is None else f" (at most {most:g})"
    print(f"{verdict}  {what}: {value:.4g} {unit}{limit}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
