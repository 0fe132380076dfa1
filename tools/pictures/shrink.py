"""Reduce a picture of the documentation to a palette: they stay below 150 kB, so that a clone stays small."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

LARGEST_BYTES = 150_000


def shrink(path: Path, colours: int = 200) -> Path:
    """Write the PNG again with as many colours as fit into `LARGEST_BYTES`.

    Raises
    ------
    ValueError
        it does not fit with 32 colours: draw it smaller.
    """
    picture = Image.open(path).convert("RGB")
    for count in (colours, colours // 2, 64, 32):
        picture.quantize(count, dither=Image.Dither.NONE).save(path, optimize=True)
        if path.stat().st_size <= LARGEST_BYTES:
            return path
    raise ValueError(
        f"{path} has {path.stat().st_size} bytes with 32 colours, more than {LARGEST_BYTES}; draw it smaller"
    )
