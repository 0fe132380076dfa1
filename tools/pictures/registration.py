"""Draw docs/pictures/registration-*.png: two noisy views of a head, registered by methods old and new.

.venv/bin/python tools/pictures/registration.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "unit" / "registration"))

from analytic_relief import pose, see  # type: ignore[import-not-found]  # noqa: E402
from shrink import shrink  # noqa: E402

from fringed.data import IterationRecord, Provenance, RangeImage, Registration  # noqa: E402
from fringed_client.pictures.convergence import draw_histories  # noqa: E402
from fringed_client.pictures.registration import draw_error_map, draw_registration  # noqa: E402
from fringed_plugins.registration.family.pair import register_by  # noqa: E402
from fringed_plugins.registration.family.presets import METHODS  # noqa: E402
from fringed_plugins.registration.register import register  # noqa: E402
from fringed_plugins.registration.result import Alignment  # noqa: E402
from fringed_plugins.registration.surface import prepare  # noqa: E402

FOLDER = ROOT / "docs" / "pictures"
NOISE_MM = 0.1
TURNED_DEG = 25.0
COMPARED = ("icpif", "zhang", "besl-mckay", "chen-medioni")
SHOWN_WRONG = "zhang"
WIDEST_PX = 1000


def main() -> None:
    fixed = see(noise_mm=NOISE_MM, seed=1).xyz_mm
    moving = see(T=pose((0, TURNED_DEG, 0), (12, -6, 20)), noise_mm=NOISE_MM, seed=2).xyz_mm
    surfaces = prepare(fixed), prepare(moving)
    found = {"default": register(*surfaces)}
    found |= {name: register_by(METHODS[name], *surfaces) for name in COMPARED}
    views = ranged(fixed), ranged(moving)
    product = {name: registration(one) for name, one in found.items()}
    for name, one in found.items():
        print(name, len(one.history), "converged" if one.converged else f"NOT converged: {one.reason}")
    drawn = [
        draw_histories(
            FOLDER / "registration-convergence.png", {name: one.history for name, one in product.items()}, True,
            f"two views of a head, {TURNED_DEG:g}° apart, by five methods",
        ),
        draw_registration(FOLDER / "registration-views.png", *views, product["default"]),
        draw_error_map(FOLDER / "registration-error.png", *views, product[SHOWN_WRONG]),
    ]  # fmt: skip
    for path in drawn:
        picture = Image.open(path).convert("RGB")
        picture.thumbnail((WIDEST_PX, 2000), Image.Resampling.LANCZOS)
        picture.save(path)
        print(shrink(path), path.stat().st_size)


def ranged(xyz_mm: Any) -> RangeImage:
    bad = ~np.isfinite(xyz_mm[..., 2])
    rejected = np.where(bad, 2, 0).astype(np.uint16)
    grey = np.full(bad.shape, 128, np.uint8)
    return RangeImage(xyz_mm, rejected, grey, provenance=Provenance(simulated=True))


def registration(found: Alignment) -> Registration:
    history = tuple(
        IterationRecord(
            one.rms_mm, one.pairs, one.threshold_mm, one.rotation_rad, one.translation_mm, one.stage, one.alpha_mm
        )
        for one in found.history
    )
    return Registration(
        "", "", found.T_reference_model, found.converged, found.reason, float(found.rms_mm), found.overlap,
        history=history,
    )  # fmt: skip


if __name__ == "__main__":
    main()
