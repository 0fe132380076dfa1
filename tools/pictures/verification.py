"""Draw docs/pictures/verification.png: a plane that holds, and the same scan by a calibration whose distortion is off.

.venv/bin/python tools/pictures/verification.py
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from bench_accuracy import simulated, take  # noqa: E402
from bench_verify import ARTEFACTS, off_by, ranged, verified  # noqa: E402
from shrink import LARGEST_BYTES  # noqa: E402

from fringed.data import Provenance  # noqa: E402
from fringed_client.pictures.verification import draw_verification  # noqa: E402

PICTURE = ROOT / "docs" / "pictures" / "verification.png"
PANELS = (("ball-bar", ""), ("plane", "camera's k1 off by 0.01"))


def main() -> None:
    pictures = []
    with TemporaryDirectory() as folder:
        for number, (name, kind) in enumerate(PANELS):
            rig = simulated(ARTEFACTS[name][0], 1)
            image = ranged(take(rig), off_by(rig.calibration(), kind))
            found = replace(verified(name, image), provenance=Provenance(simulated=True))
            path = draw_verification(Path(folder) / f"{number}.png", found, image)
            pictures.append(Image.open(path).convert("RGB"))
    width = max(picture.width for picture in pictures)
    whole = Image.new("RGB", (width, sum(picture.height for picture in pictures)), "#fafaf8")
    top = 0
    for picture in pictures:
        whole.paste(picture, (0, top))
        top += picture.height
    whole.thumbnail((760, 2000), Image.Resampling.LANCZOS)
    # By maximum coverage: the median cut of `shrink` has no green left for the light, which is few pixels.
    whole.quantize(224, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(PICTURE, optimize=True)
    if PICTURE.stat().st_size > LARGEST_BYTES:
        raise ValueError(f"{PICTURE} has {PICTURE.stat().st_size} bytes; draw it smaller")
    print(PICTURE)


if __name__ == "__main__":
    main()
