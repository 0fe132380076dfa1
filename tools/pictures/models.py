"""Draw docs/pictures/models.png: the models that three views of each of twelve heads make, and how far they are off.

.venv/bin/python tools/pictures/models.py
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from bench_models import draw, model  # noqa: E402
from heads import heads  # noqa: E402
from shrink import shrink  # noqa: E402

PICTURE = ROOT / "docs" / "pictures" / "models.png"
HEADS = 12


def main() -> None:
    views = heads(count=HEADS)
    draw(PICTURE, [model(list(group)) for group in zip(views[::3], views[1::3], views[2::3], strict=True)])
    shrink(PICTURE)
    print(PICTURE, PICTURE.stat().st_size)


if __name__ == "__main__":
    main()
