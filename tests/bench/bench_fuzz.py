"""A million random byte strings into every decoder of a device's bytes: only ProtocolError may come out.

Half of the strings begin as a real message does. The decoders of USB3 Vision are in `bench_usb3vision.py --fuzz`.

    python tests/bench/bench_fuzz.py [--count 1000000]
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections.abc import Callable

from fringed.errors import ProtocolError
from fringed.protocols.duncantech import Dialect, decode_command
from fringed.protocols.duncantech_frames import FrameDecoder
from fringed.protocols.hitachi import CommandReader, ReplyDecoder
from fringed.protocols.hitachi_network import NetworkDecoder

LONGEST = 24
Feed = Callable[[bytes], None]


def drained(decoder: object, read: str) -> Feed:
    """Return what feeds a decoder and takes all that it has understood."""
    take, feed = getattr(decoder, read), decoder.feed  # type: ignore[attr-defined]
    again = getattr(decoder, "resynchronise", bytes)  # a reader of commands goes on by itself

    def fed(data: bytes) -> None:
        feed(data)
        try:
            while take() is not None:
                pass
        except ProtocolError:
            again()
            raise

    return fed


def duncantech() -> Feed:
    decoder, dialect = FrameDecoder(), Dialect()

    def fed(data: bytes) -> None:
        for frame in decoder.feed(data):
            decode_command(frame, dialect)

    return fed


DECODERS: dict[str, tuple[Feed, bytes]] = {
    "HITACHI replies": (drained(ReplyDecoder(), "next_event"), b"\x1d"),
    "HITACHI commands": (drained(CommandReader(), "next_command"), bytes.fromhex("BEEF030600")),
    "HITACHI network replies": (drained(NetworkDecoder(), "next_reply"), b"\x1f\x04"),
    "DuncanTech frames": (duncantech(), b"\x02\x02\x00"),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1_000_000)
    count = parser.parse_args().count
    for name, (feed, prefix) in DECODERS.items():
        dice, refused, other, began = random.Random(6), 0, "", time.perf_counter()
        for index in range(count):
            data = dice.randbytes(dice.randrange(LONGEST))
            try:
                feed(prefix + data if index & 1 else data)
            except ProtocolError:
                refused += 1
            except Exception as error:  # noqa: BLE001  what is looked for
                other = f"{(prefix + data).hex()}: {error!r}"
        verdict = f"MISS  fuzz, {name}: {other}" if other else f"PASS  fuzz, {name}: {count:,} strings, nothing else"
        print(f"{verdict} than ProtocolError, {refused:,} times; {time.perf_counter() - began:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
