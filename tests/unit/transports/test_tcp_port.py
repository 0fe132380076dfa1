"""The TCP transport against a socket of this process."""

from __future__ import annotations

import socket

import pytest

from fringed.errors import DeviceAbsent, UsageError
from fringed.transports.tcp import TcpPort

PATIENCE_S = 10.0


@pytest.fixture
def listener():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        yield server


def connected(listener):
    port = TcpPort("127.0.0.1", listener.getsockname()[1])
    port.open()
    return port, listener.accept()[0]


def test_bytes_pass_both_ways(listener):
    port, peer = connected(listener)
    with peer:
        port.write(b"\x02\x0d")
        assert peer.recv(10) == b"\x02\x0d"
        peer.sendall(b"\x06")
        assert port.read(PATIENCE_S) == b"\x06"
        assert port.read(0) == b""
        port.close()
        port.close()
        assert peer.recv(1) == b""
    with pytest.raises(DeviceAbsent, match=r"tcp://127.0.0.1:\d+ is closed: open it"):
        port.write(b"x")


def test_a_peer_that_hangs_up_is_lost_and_can_be_had_again(listener):
    port, peer = connected(listener)
    peer.close()
    with pytest.raises(DeviceAbsent, match="is lost: the other side hung up; it is tried again"):
        port.read(PATIENCE_S)
    port.open()
    with listener.accept()[0] as again:
        again.sendall(b"x")
        assert port.read(PATIENCE_S) == b"x"
    port.close()


def test_nobody_there_says_what_to_check(listener):
    number = listener.getsockname()[1]
    listener.close()
    with pytest.raises(DeviceAbsent, match=f"nobody listens on TCP {number}: enable that port"):
        TcpPort("127.0.0.1", number).open()
    with pytest.raises(DeviceAbsent, match="there is no host 'no such host'"):
        TcpPort("no such host", 23).open()
    with pytest.raises(UsageError, match="a port from 1 to 65535"):
        TcpPort("projector", 0)
