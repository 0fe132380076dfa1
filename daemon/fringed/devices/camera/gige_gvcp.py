"""Ask a GigE Vision camera, with one datagram, who controls it. Any program may ask, whoever controls.

Aravis would wait for 5 s and more where a camera is gone or in other hands; this says so within 0.5 s.
"""

from __future__ import annotations

import ipaddress
import socket
import time

PORT = 3956  # GigE Vision's control port [V: run against Debian's fake camera]
_PRIVILEGE = 0x0A00  # the register that says who controls [V]
_READ, _READ_ACK = 0x0080, 0x0081
TRIES, TRY_S = 3, 0.15


def is_address(device: str) -> bool:
    """Whether `device` is an IP address."""
    try:
        ipaddress.ip_address(device)
    except ValueError:
        return False
    return True


def request(number: int) -> bytes:
    """Return the datagram that reads the register; `number` comes back in its answer."""
    header = b"\x42\x01" + b"".join(value.to_bytes(2, "big") for value in (_READ, 4, number))
    return header + _PRIVILEGE.to_bytes(4, "big")


def answer(datagram: bytes, number: int) -> int | None:
    """Return the register's value in the answer to request `number`, None for any other datagram."""
    status, kind, length, came = (int.from_bytes(datagram[at : at + 2], "big") for at in (0, 2, 4, 6))
    if len(datagram) != 12 or (status, kind, length, came) != (0, _READ_ACK, 4, number):
        return None
    return int.from_bytes(datagram[8:], "big")


def privilege(address: str) -> int | None:
    """Return who controls the camera at `address`: 0 for nobody; None where no camera answers."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for number in range(1, TRIES + 1):
            end_s = time.monotonic() + TRY_S
            try:
                asking.sendto(request(number), (address, PORT))
                while (left_s := end_s - time.monotonic()) > 0:
                    asking.settimeout(left_s)
                    value = answer(asking.recv(1024), number)
                    if value is not None:
                        return value
            except OSError:  # silence, or the network says that nobody listens
                time.sleep(max(0.0, end_s - time.monotonic()))
    return None
