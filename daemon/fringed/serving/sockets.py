"""The sockets themselves: made, bound to the runtime directory and, where configured, to TCP with CURVE.

Owns addresses and options of the transport; knows nothing of messages. TCP without keys is never bound.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zmq

from fringed.config import TcpConfig
from fringed.config.paths import endpoint
from fringed.errors import ConfigurationError, FringedError, StationBusy
from fringed.serving.keys import server_keys

if TYPE_CHECKING:
    from zmq.auth.thread import ThreadAuthenticator

ZAP_DOMAIN = b"fringed"
MAX_MESSAGE_BYTES = 4 * 1024**3


@dataclass(frozen=True)
class Remote:
    """What serving other machines needs."""

    tcp: TcpConfig
    public: bytes
    secret: bytes

    @classmethod
    def of(cls, tcp: TcpConfig | None) -> Remote | None:
        """Load the keys; raises ConfigurationError where tcp is configured without them."""
        if tcp is None:
            return None
        public, secret = server_keys(Path(tcp.keys_dir).expanduser())
        return cls(tcp, public, secret)

    def address(self, name: str) -> str:
        """Return where a socket is bound."""
        port = {"control": self.tcp.control_port, "stream": self.tcp.stream_port, "work": self.tcp.work_port}[name]
        return f"tcp://{self.tcp.bind}:{port}"


class Sockets:
    """The three sockets of a station and whatever admits remote clients."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], runtime: Path, high_water_mark: int) -> None:
        self.runtime = runtime
        self._context = context
        self._authenticator: ThreadAuthenticator | None = None
        self._clients: Path | None = None
        self.control = context.socket(zmq.ROUTER)
        self.control.setsockopt(zmq.ROUTER_HANDOVER, 1)
        self.stream = context.socket(zmq.XPUB)
        self.stream.setsockopt(zmq.XPUB_VERBOSE, 1)
        self.stream.setsockopt(zmq.SNDHWM, high_water_mark)
        for socket in (self.control, self.stream):
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.MAXMSGSIZE, MAX_MESSAGE_BYTES)

    def bind(self, work: zmq.Socket[bytes], remote: Remote | None) -> None:
        """Bind all to the runtime directory, then to TCP.

        Raises
        ------
        StationBusy
            a TCP port is taken.
        ConfigurationError
            a TCP address that is not of this machine.
        """
        named = {"stream": self.stream, "work": work, "control": self.control}  # control last: then all is there
        for name, socket in named.items():
            socket.bind(endpoint(self.runtime, name))
            (self.runtime / name).chmod(0o600)
        if remote is not None:
            self._admit(remote)
            try:
                for name, socket in named.items():
                    self._bind_tcp(name, socket, remote)
            except FringedError:
                self._dismiss()
                raise

    def addresses(self, remote: Remote | None, for_remote: bool) -> Mapping[str, str]:
        """Return where stream and work are, as somebody near or far has to call them."""
        if for_remote and remote is not None:
            return {name: remote.address(name) for name in ("stream", "work")}
        return {name: endpoint(self.runtime, name) for name in ("stream", "work")}

    def read_clients_again(self) -> None:
        """Admit clients whose keys were added since, and no longer those whose keys are gone."""
        if self._authenticator is not None and self._clients is not None:
            self._authenticator.configure_curve(domain=ZAP_DOMAIN.decode(), location=str(self._clients))

    def close(self) -> None:
        """Close what this made; the work socket belongs to its owner."""
        self.control.close(linger=300)
        self.stream.close(linger=300)
        self._dismiss()

    def _dismiss(self) -> None:
        if self._authenticator is not None:
            self._authenticator.stop()
            self._authenticator = None

    def _admit(self, remote: Remote) -> None:
        from zmq.auth.thread import ThreadAuthenticator

        authenticator = ThreadAuthenticator(self._context)
        authenticator.start()
        self._authenticator = authenticator
        self._clients = Path(remote.tcp.keys_dir).expanduser() / "clients"
        self.read_clients_again()

    @staticmethod
    def _bind_tcp(name: str, socket: zmq.Socket[Any], remote: Remote) -> None:
        socket.setsockopt(zmq.ZAP_DOMAIN, ZAP_DOMAIN)
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, remote.public)
        socket.setsockopt(zmq.CURVE_SECRETKEY, remote.secret)
        if ":" in remote.tcp.bind:
            socket.setsockopt(zmq.IPV6, 1)
        address = remote.address(name)
        try:
            socket.bind(address)
        except zmq.ZMQError as error:
            if error.errno == zmq.EADDRINUSE:
                raise StationBusy(f"{address} is in use; stop who uses it, or set tcp.{name}_port") from error
            raise ConfigurationError(f"tcp.bind {remote.tcp.bind!r} cannot be bound: {error.strerror}") from error
