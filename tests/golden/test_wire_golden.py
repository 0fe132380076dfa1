"""Today's encoder writes the bytes that were published, and today's decoder reads them.

`messages/NAME.bin` holds each part of a message after its length (4 bytes, little endian). After a change of
the format that is meant, and a new version number, write them again: FRINGED_WRITE_GOLDEN=1 pytest tests/golden
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from golden_messages import examples

from fringed.wire import decode, encode

FOLDER = Path(__file__).with_name("messages")
EXAMPLES = examples()


def packed(parts: list[Any]) -> bytes:
    raw = [bytes(part) for part in parts]
    return b"".join(len(part).to_bytes(4, "little") + part for part in raw)


def unpacked(content: bytes) -> list[bytes]:
    parts = []
    while content:
        length = int.from_bytes(content[:4], "little")
        parts.append(content[4 : 4 + length])
        content = content[4 + length :]
    return parts


def same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    if hasattr(one, "__dataclass_fields__"):
        return type(one) is type(other) and all(same(getattr(one, n), getattr(other, n)) for n in one.__dict__)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other or (one != one and other != other))


@pytest.mark.parametrize("name", EXAMPLES)
def test_encoder_writes_the_published_bytes(name: str) -> None:
    path = FOLDER / f"{name}.bin"
    now = packed(encode(*EXAMPLES[name]))
    if os.environ.get("FRINGED_WRITE_GOLDEN"):
        FOLDER.mkdir(exist_ok=True)
        path.write_bytes(now)
    assert now == path.read_bytes()


@pytest.mark.parametrize("name", EXAMPLES)
def test_decoder_reads_the_published_bytes(name: str) -> None:
    content, topic, seq = EXAMPLES[name]
    envelope = decode(unpacked((FOLDER / f"{name}.bin").read_bytes()))
    assert (envelope.topic, envelope.seq, envelope.kind) == (topic, seq, type(content).__name__)
    assert same(envelope.content, content)


def test_no_golden_file_is_left_untested() -> None:
    assert {path.stem for path in FOLDER.glob("*.bin")} == set(EXAMPLES)
