"""The promises of every camera, kept by the USB3 Vision driver over the emulated camera."""

import importlib.util
from pathlib import Path

import pytest

from fringed.devices.camera.usb3vision import Usb3VisionCamera
from fringed.emulators.u3v import EmulatedUsb
from fringed.emulators.u3v_camera import EmulatedU3vCamera
from fringed.emulators.u3v_memory import EmulatedIdentity

_PLACE = Path(__file__).parents[2] / "contracts" / "test_camera_contract.py"
_SPEC = importlib.util.spec_from_file_location("camera_contract", _PLACE)
_CONTRACT = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_CONTRACT)


class TestUsb3VisionCamera(_CONTRACT.CameraContract):
    @pytest.fixture
    def camera(self):
        return Usb3VisionCamera(
            backend=EmulatedUsb([EmulatedU3vCamera(identity=EmulatedIdentity(width=116, height=87), period_s=0.02)])
        )
