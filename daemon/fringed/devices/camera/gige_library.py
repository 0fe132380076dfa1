"""Aravis, as C functions: the part of libaravis-0.8 that the driver needs.

Owns the library's loading, its signatures [V: the headers of Aravis 0.8.26] and its errors as exceptions.
ctypes rather than GObject introspection: PyGObject would have to be built for each Python.
"""

from __future__ import annotations

import ctypes as c
from functools import lru_cache
from typing import Any

from fringed.devices.camera.gige_port import FeatureError
from fringed.errors import DeviceAbsent

LIBRARIES = ("libaravis-0.8.so.0", "libgobject-2.0.so.0", "libglib-2.0.so.0")
INSTALL = "install Debian's package libaravis-0.8-0 (`apt install libaravis-0.8-0`)"

_P, _S = c.c_void_p, c.c_char_p
_ERROR = c.POINTER(c.c_void_p)

# name -> (result, arguments); an argument list that ends in _ERROR is called without it.
SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_update_device_list": (None, ()),
    "arv_get_n_devices": (c.c_uint, ()),
    "arv_get_device_id": (_S, (c.c_uint,)),
    "arv_get_device_address": (_S, (c.c_uint,)),
    "arv_get_device_physical_id": (_S, (c.c_uint,)),
    "arv_get_device_protocol": (_S, (c.c_uint,)),
    "arv_get_device_serial_nbr": (_S, (c.c_uint,)),
    "arv_camera_new": (_P, (_S, _ERROR)),
    "arv_camera_is_feature_available": (c.c_int, (_P, _S, _ERROR)),
    "arv_camera_dup_available_enumerations_as_strings": (c.POINTER(_S), (_P, _S, c.POINTER(c.c_uint), _ERROR)),
    "arv_camera_get_string": (_S, (_P, _S, _ERROR)),
    "arv_camera_set_string": (None, (_P, _S, _S, _ERROR)),
    "arv_camera_get_float": (c.c_double, (_P, _S, _ERROR)),
    "arv_camera_set_float": (None, (_P, _S, c.c_double, _ERROR)),
    "arv_camera_get_float_bounds": (None, (_P, _S, c.POINTER(c.c_double), c.POINTER(c.c_double), _ERROR)),
    "arv_camera_get_integer": (c.c_int64, (_P, _S, _ERROR)),
    "arv_camera_set_integer": (None, (_P, _S, c.c_int64, _ERROR)),
    "arv_camera_get_integer_bounds": (None, (_P, _S, c.POINTER(c.c_int64), c.POINTER(c.c_int64), _ERROR)),
    "arv_camera_set_boolean": (None, (_P, _S, c.c_int, _ERROR)),
    "arv_camera_execute_command": (None, (_P, _S, _ERROR)),
    "arv_camera_get_payload": (c.c_uint, (_P, _ERROR)),
    "arv_camera_create_stream": (_P, (_P, _P, _P, _ERROR)),
    "arv_camera_gv_set_packet_size": (None, (_P, c.c_int, _ERROR)),
    "arv_stream_push_buffer": (None, (_P, _P)),
    "arv_stream_timeout_pop_buffer": (_P, (_P, c.c_uint64)),
    "arv_stream_get_n_infos": (c.c_uint, (_P,)),
    "arv_stream_get_info_name": (_S, (_P, c.c_uint)),
    "arv_stream_get_info_uint64": (c.c_uint64, (_P, c.c_uint)),
    "arv_buffer_new_allocate": (_P, (c.c_size_t,)),
    "arv_buffer_get_status": (c.c_int, (_P,)),
    "arv_buffer_get_frame_id": (c.c_uint64, (_P,)),
    "arv_buffer_get_timestamp": (c.c_uint64, (_P,)),
    "arv_buffer_get_system_timestamp": (c.c_uint64, (_P,)),
    "arv_buffer_get_image_width": (c.c_int, (_P,)),
    "arv_buffer_get_image_height": (c.c_int, (_P,)),
    "arv_buffer_get_image_pixel_format": (c.c_uint32, (_P,)),
    "arv_buffer_get_image_data": (_P, (_P, c.POINTER(c.c_size_t))),
    "g_object_unref": (None, (_P,)),
    "g_error_free": (None, (_P,)),
    "g_free": (None, (_P,)),
}


class _GError(c.Structure):
    _fields_ = (("domain", c.c_uint32), ("code", c.c_int), ("message", c.c_char_p))


class Library:
    """The functions, as methods of the same names; an error of the library is a FeatureError."""

    def __init__(self) -> None:
        try:
            aravis, gobject, glib = (c.CDLL(name) for name in LIBRARIES)
        except OSError as error:
            raise DeviceAbsent(f"the library for GenICam cameras cannot be loaded ({error}): {INSTALL}") from error
        homes = {"arv": aravis, "g_object_unref": gobject, "g_error_free": glib, "g_free": glib}
        self._functions: dict[str, Any] = {}
        for name, (result, arguments) in SIGNATURES.items():
            function = getattr(next(home for start, home in homes.items() if name.startswith(start)), name, None)
            if function is None:
                raise DeviceAbsent(f"{LIBRARIES[0]} has no {name}: it is older than 0.8.20; {INSTALL}")
            function.restype, function.argtypes = result, arguments
            self._functions[name] = function
        self._free_error = self._functions["g_error_free"]

    def call(self, name: str, *arguments: Any) -> Any:
        """Call the function `name`, without its last argument where that is the error.

        Raises
        ------
        FeatureError
            the library reports an error.
        """
        function = self._functions[name]
        if not (SIGNATURES[name][1] and SIGNATURES[name][1][-1] is _ERROR):
            return function(*arguments)
        error = c.c_void_p()
        result = function(*arguments, c.byref(error))
        if error.value:
            message = c.cast(error, c.POINTER(_GError)).contents.message or b"no reason given"
            self._free_error(error)
            raise FeatureError(message.decode(errors="replace"))
        return result


@lru_cache(maxsize=1)
def load() -> Library:
    """Return the library, loaded once; raises DeviceAbsent with the package to install."""
    return Library()
