"""The USB3 Vision driver over the emulated camera: throughput, delays, the cable pulled, faults, fuzzing.

Everything but the cable is real: PyUSB's calls, GenCP, the stream, the pixel formats. So these are the costs of the
software, and no promise of what a bus or a camera does.
"""

from __future__ import annotations

import argparse
import threading
import time
from contextlib import suppress
from functools import partial

import numpy as np

from fringed.data import CameraSettings
from fringed.devices.camera.usb3vision import Usb3VisionCamera
from fringed.devices.camera.usb3vision_options import Usb3VisionOptions
from fringed.emulators.u3v import EmulatedUsb
from fringed.emulators.u3v_camera import EmulatedU3vCamera
from fringed.emulators.u3v_memory import EmulatedIdentity
from fringed.errors import DeviceAbsent, DeviceStalled, ProtocolError
from fringed.protocols.gencp import AcknowledgeDecoder, RequestDecoder
from fringed.protocols.u3v import BlockAssembler, Leader, encode_leader, plan_transfers
from fringed.protocols.u3v_formula import evaluate
from fringed.protocols.u3v_pixels import FORMATS, decode_image, encode_image

WIDTH, HEIGHT = 1392, 1040
PACKED = ("Mono8", "Mono10p", "Mono12p", "RGB8", "RGB10p", "RGB12p")
CAMERA_PERIOD_S = 0.1335  # the MS3100's


class Still:
    """The same picture again and again, so that making it costs nothing."""

    def __init__(self, bits: int, channels: int) -> None:
        shape = (HEIGHT, WIDTH, 3)[: 2 + (channels == 3)]
        values = np.random.default_rng(1).integers(0, 2**bits, shape)
        self.image = values.astype(np.uint8 if bits == 8 else np.uint16)

    def __call__(self, start_s: float, exposure_s: float) -> np.ndarray:
        return self.image


def rig(picture=None, period_s: float = 0.00001, **identity) -> tuple[Usb3VisionCamera, EmulatedU3vCamera]:
    emulated = EmulatedU3vCamera(picture, EmulatedIdentity(**identity), period_s, buffers=10_000)
    options = Usb3VisionOptions(transfer_bytes=1 << 20)
    camera = Usb3VisionCamera(options, backend=EmulatedUsb([emulated]))
    camera.open()
    return camera, emulated


def line(name: str, value: float, unit: str, limit: float | None = None) -> bool:
    passed = limit is None or value <= limit
    verdict = "    " if limit is None else "PASS" if passed else "MISS"
    told = "" if limit is None else f" (at most {limit:g} {unit})"
    print(f"{verdict}  {name}: {value:.2f} {unit}{told}", flush=True)
    return passed


def throughput(frames: int) -> bool:
    passed = True
    for formats, packing in ((EmulatedIdentity().formats, ""), (PACKED, ", packed")):
        for bits, channel in ((8, "white"), (10, "white"), (12, "white"), (8, "rgb"), (10, "rgb"), (12, "rgb")):
            if packing and bits == 8:
                continue
            still = Still(bits, 3 if channel == "rgb" else 1)
            camera, emulated = rig(still, formats=formats, width=WIDTH, height=HEIGHT)
            camera.arm(CameraSettings(exposure_us=20.0, bits=bits, channel=channel))
            camera.read(10.0)
            pixels = emulated.pixels
            spent, copied = spent_on(partial(encode_image, still.image, pixels)), spent_on(still.image.copy)
            begun = time.perf_counter()
            for _ in range(frames):
                frame = camera.read(10.0)
            each = (time.perf_counter() - begun) / frames
            assert np.array_equal(frame.image, still.image)
            camera.close()
            rate = pixels.payload_bytes(WIDTH, HEIGHT) / each / 1e6
            own = f"{spent:.1f} ms are the emulator's packing, {copied:.1f} ms would be a plain copy"
            name = f"{pixels.name}{packing}, a frame of {WIDTH} x {HEIGHT} ({rate:.0f} MB/s; {own})"
            passed &= line(name, each * 1e3, "ms", CAMERA_PERIOD_S * 1e3)
    return passed


def spent_on(work) -> float:
    """Return the milliseconds of the fastest of three runs."""
    spent = []
    for _ in range(3):
        begun = time.perf_counter()
        work()
        spent.append((time.perf_counter() - begun) * 1e3)
    return min(spent)


def delays() -> bool:
    still = Still(8, 1)
    camera, emulated = rig(still, width=WIDTH, height=HEIGHT)
    begun = time.perf_counter()
    camera.arm(CameraSettings(exposure_us=1000.0, trigger="software"))
    armed = time.perf_counter() - begun
    added, triggers, errors = [], [], []
    starts = []
    emulated._picture = lambda start_s, exposure_s: (starts.append(start_s), still.image)[1]
    for _ in range(50):
        before = time.monotonic()
        camera.trigger()
        triggers.append(time.monotonic() - before)
        frame = camera.read(5.0)
        added.append(time.monotonic() - before - 0.001)
        errors.append(abs(frame.exposure_start_s - starts[-1]))
    camera.close()
    line("arming", armed * 1e3, "ms")
    line("a software trigger, median", float(np.median(triggers)) * 1e3, "ms")
    line("exposure start against the emulator's truth, greatest error", max(errors) * 1e6, "us", 1000)
    return line("trigger to frame beyond the exposure, median", float(np.median(added)) * 1e3, "ms", 5.0)


def cable() -> bool:
    camera, emulated = rig(Still(8, 1), width=WIDTH, height=HEIGHT)
    camera.arm(CameraSettings(exposure_us=1000.0, trigger="software"))
    pulled = []
    timer = threading.Timer(0.2, lambda: (pulled.append(time.perf_counter()), emulated.unplug()))
    timer.start()
    with suppress(DeviceAbsent):
        camera.read(10.0)
    passed = line("unplugged to known", (time.perf_counter() - pulled[0]) * 1e3, "ms", 1000)
    timer.join()
    emulated.plug()
    begun = time.perf_counter()
    camera.open()
    camera.arm(CameraSettings(exposure_us=1000.0, trigger="software"))
    camera.trigger()
    camera.read(5.0)
    passed &= line("replugged to first frame", (time.perf_counter() - begun) * 1e3, "ms", 5000)
    camera.close()
    return passed


def faults(frames: int) -> bool:
    """Lose 5 % of all transfers: every frame that comes is right, every other one is named or counted."""
    shape = (40, 64)
    taken: list[np.ndarray] = []
    random = np.random.default_rng(3)

    def picture(start_s: float, exposure_s: float) -> np.ndarray:
        taken.append(random.integers(0, 256, shape).astype(np.uint8))
        return taken[-1]

    camera, emulated = rig(picture, width=shape[1], height=shape[0])
    camera._options = Usb3VisionOptions(transfer_bytes=1024)
    camera._control._options = camera._options
    camera.arm(CameraSettings(exposure_us=100.0, trigger="software"))
    emulated.faults.lost_fraction = 0.05
    right = wrong = named = 0
    for _ in range(frames):
        camera.trigger()
        try:
            frame = camera.read(0.01)
        except (ProtocolError, DeviceStalled):
            named += 1
            continue
        if np.array_equal(frame.image, taken[frame.counter - 1]):
            right += 1
        else:
            wrong += 1
    camera.close()
    print(f"      5 % of transfers lost, {frames} frames: {right} right, {named} named", flush=True)
    return line("frames that are wrong and not named", wrong, "frames", 0)


def message(data: bytes) -> bytes:
    """Make a GenCP message of random bytes, whose length is mostly right and whose command often is."""
    known = (b"\x00\x08", b"\x01\x08", b"\x02\x08", b"\x03\x08", b"\x05\x08")
    command = known[len(data) % 5] if data[:1] < b"\xc0" else data[:2].ljust(2, b"\0")
    flags = (b"\0\0", b"\0\x40")[len(data) % 2] if data[1:2] < b"\xc0" else data[2:4].ljust(2, b"\0")
    length = len(data) if data[2:3] < b"\xf0" else len(data) // 2
    return b"U3VC" + flags + command + length.to_bytes(2, "little") + data[:2].ljust(2, b"\0") + data


def fuzz(count: int) -> bool:
    """Feed random strings, half of them behind the right prefix; anything but ProtocolError ends the run."""
    random = np.random.default_rng(6)
    plan = plan_transfers((52, 100, 32), 8, 40)
    acknowledges, requests, assembler = AcknowledgeDecoder(), RequestDecoder(), BlockAssembler(plan)
    leader = encode_leader(Leader(1, 2, FORMATS[0].code, 10, 10))
    decoders = {
        "GenCP acknowledges": (lambda data: acknowledges.feed(message(data)), b""),
        "GenCP requests": (lambda data: requests.feed(message(data)), b""),
        "stream blocks": (assembler.feed, b"U3VL"),
        "stream blocks within a frame": (lambda data: (assembler.feed(leader), assembler.feed(data)), b"U3VT"),
        "formulas": (lambda data: evaluate(data.decode("latin-1"), lambda _: 3), b"(1+2)*"),
        "pixels": (
            lambda data: decode_image(np.frombuffer(data, np.uint8), FORMATS[len(data) % len(FORMATS)], (3, 2)), b"ab",
        ),
    }  # fmt: skip
    for name, (feed, prefix) in decoders.items():
        refused = 0
        pool = random.bytes(1 << 16)
        places = random.integers(0, (1 << 16) - 64, count)
        lengths = random.integers(0, 64, count)
        for index in range(count):
            start = places[index]
            data = pool[start : start + lengths[index]]
            try:
                feed(prefix + data if index & 1 else data)
            except ProtocolError:
                refused += 1
            if index % 1000 == 0:
                acknowledges.reset()
        print(f"PASS  fuzz, {name}: {count} strings, {refused} refused, nothing but ProtocolError", flush=True)
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=20, help="frames of each format")
    parser.add_argument(
        "--fuzz", type=int, default=20_000, help="random strings into each decoder (the figure: 1000000)"
    )
    options = parser.parse_args()
    passed = [throughput(options.frames), delays(), cable(), faults(1000), fuzz(options.fuzz)]
    raise SystemExit(0 if all(passed) else 1)


if __name__ == "__main__":
    main()
