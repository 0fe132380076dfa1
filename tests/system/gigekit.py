"""Debian's GigE Vision camera in software, as a process."""

import shutil
import socket
import subprocess
import time

import pytest

from fringed.devices.camera.gige_gvcp import PORT, privilege
from fringed.devices.camera.gige_library import load
from fringed.errors import DeviceAbsent

FAKE = "arv-fake-gv-camera-0.8"
ADDRESS = "127.0.0.1"


def missing():
    if shutil.which(FAKE) is None:
        return f"there is no {FAKE}: install Debian's package aravis-tools"
    try:
        load()
    except DeviceAbsent as error:
        return error.message
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((ADDRESS, PORT))
        except OSError:
            return f"UDP port {PORT} is taken: another GigE Vision camera runs on this machine"
    return ""


class FakeCamera:
    """The camera's process; `lost` packets of a thousand never leave it."""

    def __init__(self, serial="T1", lost=0):
        self.process = subprocess.Popen(
            [FAKE, "-i", ADDRESS, "-s", serial, "-r", str(lost)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:
            if privilege(ADDRESS) is not None:
                return
        self.unplug()
        pytest.fail("the camera in software does not answer")

    def unplug(self):
        self.process.kill()
        self.process.wait(10)
