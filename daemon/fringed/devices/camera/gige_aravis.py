"""A GenICam camera by Aravis: GigE Vision and USB3 Vision.

Owns the library's objects: the camera, its stream and buffers. Used by one thread.
"""

from __future__ import annotations

import ctypes as c
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from fringed.data import Array
from fringed.devices.camera.gige_gvcp import is_address, privilege
from fringed.devices.camera.gige_library import Library, load
from fringed.devices.camera.gige_port import COMPLETE, Delivery, FeatureError
from fringed.errors import DeviceAbsent, DeviceError

_NOTHING: Array = np.empty(0, np.uint8)


@dataclass(frozen=True)
class Found:
    """A camera that Aravis has found."""

    id: str
    serial: str
    physical_id: str
    address: str
    protocol: str


class AravisPort:
    """One camera. `packet_bytes` sets the size of GigE Vision's packets, 0 leaves it to Aravis."""

    def __init__(self, packet_bytes: int = 0) -> None:
        self._packet_bytes = packet_bytes
        self._library: Library | None = None
        self._camera: int | None = None
        self._stream: int | None = None
        self._address = ""
        self._gone = False  # once gone it has to be opened afresh, even if something answers at its address again

    def open(self, device: str) -> str:
        """Open the camera of that name, or the only one for none; return its identity; raises DeviceAbsent."""
        self._library = self._library or load()
        self._gone = False
        self._address = device if is_address(device) else self._find(device)
        name = self._address or device
        if self._address:
            holder = privilege(self._address)
            if holder is None:
                raise DeviceAbsent(f"no GigE Vision camera answers at {name}. {self._advice(self.found())}")
            if holder:
                raise DeviceAbsent(f"another program controls the camera {name}: end it; after a crash, wait 3 s")
        try:
            self._camera = self._call("arv_camera_new", name.encode() or None)
        except FeatureError as error:
            raise DeviceAbsent(f"the camera {name} does not open: {error.message}") from error
        if not self._camera:
            raise DeviceAbsent(f"the camera {name} does not open: unplug it and plug it in again")
        try:
            return self._identity()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release it; harmless when closed."""
        gone = bool(self._address and self._camera) and not self.alive()
        stream, camera = self._stream, self._camera
        self._stream = self._camera = None
        if gone:  # Aravis says good-bye to it for 10 s, and nobody has to wait for that
            threading.Thread(target=self._release, args=(stream, camera), name="gige-release", daemon=True).start()
        else:
            self._release(stream, camera)

    def alive(self) -> bool:
        """Whether the camera answers and is ours; ends within 0.7 s."""
        if self._camera and not self._gone:
            if self._address:
                self._gone = not privilege(self._address)
            else:
                self._gone = True
                with suppress(FeatureError):
                    self._gone = not self.number("Width", whole=True)
        return bool(self._camera) and not self._gone

    def has(self, feature: str) -> bool:
        """Whether the camera has a feature, now."""
        with suppress(FeatureError):
            return bool(self._ask("arv_camera_is_feature_available", feature))
        return False

    def choices(self, feature: str) -> tuple[str, ...]:
        """Return the entries of an enumeration that are available now."""
        count = c.c_uint()
        entries = self._ask("arv_camera_dup_available_enumerations_as_strings", feature, c.byref(count))
        names = tuple(entries[place].decode() for place in range(count.value))
        self._call("g_free", c.cast(entries, c.c_void_p))
        return names

    def text(self, feature: str) -> str:
        """Return a string or an enumeration's entry."""
        found = self._ask("arv_camera_get_string", feature)
        return (found or b"").decode(errors="replace")

    def number(self, feature: str, whole: bool = False) -> float:
        """Return a float, or an integer for `whole`."""
        return float(self._ask("arv_camera_get_integer" if whole else "arv_camera_get_float", feature))

    def limits(self, feature: str, whole: bool = False) -> tuple[float, float]:
        """Return the least and the greatest value of a number."""
        kind: Any = c.c_int64 if whole else c.c_double
        low, high = kind(), kind()
        name = "arv_camera_get_integer_bounds" if whole else "arv_camera_get_float_bounds"
        self._ask(name, feature, c.byref(low), c.byref(high))
        return float(low.value), float(high.value)

    def put(self, feature: str, value: str | float | int | bool) -> None:
        """Set a feature: an enumeration by str, a float, an integer by int, a boolean."""
        if isinstance(value, bool):
            self._ask("arv_camera_set_boolean", feature, int(value))
        elif isinstance(value, str):
            self._ask("arv_camera_set_string", feature, value.encode())
        elif isinstance(value, int):
            self._ask("arv_camera_set_integer", feature, value)
        else:
            self._ask("arv_camera_set_float", feature, value)

    def execute(self, command: str) -> None:
        """Execute a command."""
        self._ask("arv_camera_execute_command", command)

    def start(self, buffers: int) -> None:
        """Begin to receive into that many buffers; the camera is told by a command of its own."""
        self.stop()
        camera = self._opened()
        if self._packet_bytes and self._address:
            self._call("arv_camera_gv_set_packet_size", camera, self._packet_bytes)
        payload = self._call("arv_camera_get_payload", camera)
        self._stream = self._call("arv_camera_create_stream", camera, None, None)
        if not self._stream:
            raise DeviceError(
                "the camera's stream cannot be made: look at the firewall, and at the memory that is free"
            )
        for _ in range(buffers):
            self._call("arv_stream_push_buffer", self._stream, self._call("arv_buffer_new_allocate", payload))

    def stop(self) -> None:
        """End receiving; harmless when not begun."""
        stream, self._stream = self._stream, None
        if stream:
            self._call("g_object_unref", stream)  # its thread and its buffers end with it

    def pop(self, timeout_s: float) -> Delivery | None:
        """Return the next buffer, None where none comes in time."""
        if self._stream is None:
            raise DeviceError("the camera does not stream: start it first")
        buffer = self._call("arv_stream_timeout_pop_buffer", self._stream, max(0, int(timeout_s * 1e6)))
        if not buffer:
            return None
        try:
            return self._delivery(buffer)
        finally:
            self._call("arv_stream_push_buffer", self._stream, buffer)

    def statistics(self) -> dict[str, int]:
        """Return the stream's counts, by name: frames, failures, missing packets and more."""
        if self._stream is None:
            return {}
        count = self._call("arv_stream_get_n_infos", self._stream)
        names = [self._call("arv_stream_get_info_name", self._stream, place).decode() for place in range(count)]
        return {
            name.removeprefix("n_"): int(self._call("arv_stream_get_info_uint64", self._stream, place))
            for place, name in enumerate(names)
        }

    def _delivery(self, buffer: int) -> Delivery:
        status = self._call("arv_buffer_get_status", buffer)
        age_s = time.time() - self._call("arv_buffer_get_system_timestamp", buffer) * 1e-9
        data, size, code = _NOTHING, (0, 0), 0
        if status == COMPLETE:
            length = c.c_size_t()
            place = self._call("arv_buffer_get_image_data", buffer, c.byref(length))
            if place and length.value:
                data = np.ctypeslib.as_array((c.c_uint8 * length.value).from_address(place)).copy()
            size = tuple(self._call(f"arv_buffer_get_image_{side}", buffer) for side in ("width", "height"))
            code = self._call("arv_buffer_get_image_pixel_format", buffer)
        frame_id, stamp_ns = (self._call(f"arv_buffer_get_{what}", buffer) for what in ("frame_id", "timestamp"))
        return Delivery(data, size, code, status, frame_id, stamp_ns, time.monotonic() - max(0.0, age_s))

    def _call(self, name: str, *arguments: Any) -> Any:
        if self._library is None:
            raise DeviceAbsent("the camera is closed: open it")
        return self._library.call(name, *arguments)

    def _ask(self, name: str, feature: str, *arguments: Any) -> Any:
        return self._call(name, self._opened(), feature.encode(), *arguments)

    def _opened(self) -> int:
        if not self._camera:
            raise DeviceAbsent("the camera is closed or has vanished: open it")
        return self._camera

    def _release(self, *objects: int | None) -> None:
        for one in objects:
            if one:
                self._call("g_object_unref", one)

    def found(self) -> list[Found]:
        """Return the cameras on this machine's networks and USB; that takes 1 s. Raises DeviceAbsent without Aravis."""
        self._library = self._library or load()
        self._call("arv_update_device_list")
        names = ("id", "serial_nbr", "physical_id", "address", "protocol")
        return [
            Found(*((self._call(f"arv_get_device_{name}", place) or b"").decode(errors="replace") for name in names))
            for place in range(self._call("arv_get_n_devices"))
        ]

    def _find(self, device: str) -> str:
        """Return the address of the camera of that name, nothing for one on USB; raises DeviceAbsent."""
        found = self.found()
        meant = [one for one in found if not device or device in (one.id, one.serial, one.physical_id)]
        if len(meant) != 1:
            what = f"camera.options.device {device!r}" if device else "camera.options.device is empty and"
            raise DeviceAbsent(
                f"{what} names {len(meant) or 'no'} camera{'s' * (len(meant) > 1)}. {self._advice(found)}"
            )
        return meant[0].address if meant[0].protocol == "GigEVision" else ""

    def _advice(self, found: list[Found]) -> str:
        if found:
            return f"Found are {', '.join(one.id for one in found)}: set camera.options.device to one of these"
        return (
            "None is found: check its power and cable, that its address is in the network of this port, that the "
            "firewall lets UDP in, and for USB3 the permission of its device file"
        )

    def _identity(self) -> str:
        names = (n for n in ("DeviceVendorName", "DeviceModelName", "DeviceSerialNumber", "DeviceID") if self.has(n))
        known = [self.text(name) for name in names]
        return " ".join(dict.fromkeys(known)) + (f" at {self._address}" if self._address else "")
