"""Optics behind a frame buffer: what is scanned out is what a camera sees, as the pure simulation has it."""

from __future__ import annotations

import struct
import time

import msgspec
import numpy as np
import pytest

from fringed.config.simulated import SimulationConfig
from fringed.data import CameraSettings
from fringed.emulators.framebuffer import FrameBuffer, reduced
from fringed.emulators.scanned import ScannedOptics
from fringed.errors import DataError
from fringed.simulation.display import Picture
from fringed.simulation.rig import SimulatedRig

SIZE = (256, 192)


def an_x_server(path, size=SIZE, bits=32):
    """Write an empty frame buffer as Xvfb does, and return a function that draws in it."""
    width, height = size
    head = [100 + 8, 7, 2, 24, width, height, 0, 0, 32, 0, 32, bits, 4 * width, 5, 0xFF0000, 0xFF00, 0xFF, 8, 256, 0]
    path.write_bytes(struct.pack(">25I", *head, *[0] * 5) + b"screen\0\0" + bytes(4 * width * height))
    memory = np.memmap(path, np.uint8, "r+", 108, (height, width, 4))

    def draw(picture):
        memory[..., 2::-1] = np.broadcast_to(picture, (height, width, 3))
        memory.flush()

    return draw


def a_configuration():
    return msgspec.convert(
        {
            "noise": False,
            "real_time": True,
            "sensor": {"width_px": 120, "height_px": 90},
            "projector": {"width_px": SIZE[0], "height_px": SIZE[1]},
        },
        SimulationConfig,
    )


def test_frame_buffer_is_read_as_colours(tmp_path):
    draw = an_x_server(tmp_path / "fb")
    picture = np.random.default_rng(0).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    draw(picture)
    buffer = FrameBuffer(tmp_path / "fb")
    assert buffer.size_px == SIZE and np.array_equal(buffer.picture(), picture)
    buffer.close()


def test_other_files_are_refused(tmp_path):
    with pytest.raises(DataError, match="no frame buffer"):
        FrameBuffer(tmp_path / "none")
    an_x_server(tmp_path / "deep", bits=16)
    with pytest.raises(DataError, match="16 bits"):
        FrameBuffer(tmp_path / "deep")


def test_patterns_of_rows_and_columns_are_known_again():
    row = np.arange(256, dtype=np.uint8)[None, :, None]
    full = np.broadcast_to(row, (192, 256, 3))
    assert np.array_equal(reduced(full), row)
    assert reduced(full.transpose(1, 0, 2)).shape == (256, 1, 1)
    coloured = full.copy()
    coloured[..., 1] = 0
    assert reduced(coloured).shape == (1, 256, 3)
    assert reduced(np.zeros((192, 256, 3), np.uint8)).shape == (1, 1, 1)


def test_camera_sees_what_is_scanned_out(tmp_path):
    draw = an_x_server(tmp_path / "fb")
    buffer = FrameBuffer(tmp_path / "fb")
    optics = ScannedOptics(a_configuration(), buffer)
    optics.start()
    try:
        fringe = np.rint(127.5 + 127.5 * np.cos(np.arange(SIZE[0]) / 3)).astype(np.uint8)[None, :, None]
        dark = optics.image(time.monotonic(), 0.01)
        seen = optics.pictures
        draw(np.repeat(fringe, 3, axis=2))
        while optics.pictures == seen:
            time.sleep(0.01)
        time.sleep(0.3)  # latency and settling
        settings = CameraSettings(channel="green", trigger="software")
        optics.settings = settings
        start_s = time.monotonic()
        image = optics.image(start_s, settings.exposure_us * 1e-6)
    finally:
        optics.close()
        buffer.close()
    pure = SimulatedRig(a_configuration())
    pure.display.appear(Picture(fringe), start_s - 1.0)
    expected = pure.image(start_s, start_s + settings.exposure_us * 1e-6, pure.sensor.in_force(settings), 2)
    assert dark.mean() < 0.5 * image.mean()
    assert np.abs(image.astype(int) - expected).max() <= 1


def test_optics_need_the_real_clock(tmp_path):
    an_x_server(tmp_path / "fb")
    buffer = FrameBuffer(tmp_path / "fb")
    with pytest.raises(ValueError, match="real clock"):
        ScannedOptics(msgspec.structs.replace(a_configuration(), real_time=False), buffer)
    buffer.close()
