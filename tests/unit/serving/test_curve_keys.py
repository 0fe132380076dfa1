"""Keys for TCP: private, made by a command, missing ones told with that command; strangers stay outside."""

import stat
import threading

import pytest
import zmq

from fringed import wire
from fringed.config import TcpConfig
from fringed.errors import ConfigurationError, StationBusy, UsageError
from fringed.messages import Request
from fringed.serving.control import Control
from fringed.serving.keys import new_keys, server_keys
from fringed.serving.sockets import Remote, Sockets
from fringed_client.address import Keys


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_keys_are_private_and_a_client_gets_what_it_needs(tmp_path):
    folder = tmp_path / "keys"
    new_keys(folder, "server")
    new_keys(folder, "anna")
    assert mode(folder) == 0o700
    assert mode(folder / "server.key_secret") == 0o600
    assert mode(folder / "for-anna" / "client.key_secret") == 0o600
    keys = Keys.load(folder / "for-anna")
    assert keys.server_public == server_keys(folder)[0]


def test_missing_or_open_keys_are_refused_with_the_command(tmp_path):
    folder = tmp_path / "keys"
    with pytest.raises(ConfigurationError, match="fringed keys new server"):
        server_keys(folder)
    with pytest.raises(UsageError, match="fringed keys new server"):
        new_keys(folder, "anna")
    new_keys(folder, "server")
    with pytest.raises(ConfigurationError, match="fringed keys new NAME"):
        server_keys(folder)
    new_keys(folder, "anna")
    (folder / "server.key_secret").chmod(0o644)
    with pytest.raises(ConfigurationError, match="chmod 600"):
        server_keys(folder)


def test_keys_are_never_overwritten(tmp_path):
    new_keys(tmp_path / "keys", "server")
    with pytest.raises(UsageError, match="exists already"):
        new_keys(tmp_path / "keys", "server")


def free_ports(count):
    import socket

    held = [socket.socket() for _ in range(count)]
    for one in held:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in held]
    for one in held:
        one.close()
    return ports


@pytest.fixture
def served(tmp_path, reactor, context):
    folder = tmp_path / "keys"
    new_keys(folder, "server")
    new_keys(folder, "anna")
    control, stream, work = free_ports(3)
    tcp = TcpConfig(bind="127.0.0.1", control_port=control, stream_port=stream, work_port=work, keys_dir=str(folder))
    sockets = Sockets(context, tmp_path, 2)
    Control(reactor, sockets.control, {"where": lambda call: "far" if call.remote else "near"})
    other = context.socket(zmq.ROUTER)
    remote = Remote.of(tcp)
    sockets.bind(other, remote)
    yield reactor, remote.address("control"), f"ipc://{tmp_path}/control", folder
    other.close(linger=0)
    sockets.close()


def ask(reactor, address, keys=None):
    with zmq.Context() as context, context.socket(zmq.DEALER) as client:
        client.linger = 0
        if keys is not None:
            client.curve_serverkey, client.curve_publickey, client.curve_secretkey = keys
        client.connect(address)
        client.send_multipart(wire.encode(Request("r", "where")))
        if not reactor.run_until(lambda: bool(client.poll(0)), 1.0):
            return None
        return wire.decode(client.recv_multipart()).content.result


def test_over_tcp_only_known_keys_get_in_while_ipc_needs_none(served):
    reactor, far, near, folder = served
    own = Keys.load(folder / "for-anna")
    stranger = zmq.curve_keypair()
    assert ask(reactor, near) == "near"
    assert ask(reactor, far, (own.server_public, own.client_public, own.client_secret)) == "far"
    assert ask(reactor, far, (own.server_public, *stranger)) is None
    assert ask(reactor, far) is None


def test_a_taken_tcp_port_is_told_and_leaves_no_thread(context, tmp_path):
    new_keys(tmp_path / "keys", "server")
    new_keys(tmp_path / "keys", "anna")
    taken = context.socket(zmq.REP)
    port = taken.bind_to_random_port("tcp://127.0.0.1")
    tcp = TcpConfig(
        bind="127.0.0.1", control_port=port, stream_port=port, work_port=port, keys_dir=str(tmp_path / "keys")
    )
    (tmp_path / "run").mkdir(mode=0o700)
    sockets = Sockets(context, tmp_path / "run", 2)
    before = threading.active_count()
    with pytest.raises(StationBusy, match=str(port)):
        sockets.bind(context.socket(zmq.ROUTER), Remote.of(tcp))
    assert threading.active_count() == before
