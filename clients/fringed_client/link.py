"""A blocking connection to a station's control socket, and the watch over it.

Owns one DEALER socket with its monitor; knows nothing of verbs. A connection that breaks is noticed by
the monitor and raised at once, during a wait as well.
"""

from __future__ import annotations

import time
from typing import Any

import zmq
from zmq.utils.monitor import recv_monitor_message

from fringed.errors import ConnectionLost, NoStation, RequestTimeout
from fringed_client.address import Address
from fringed_client.protocol.flows import no_station
from fringed_client.protocol.requests import Call, RequestCore

REFUSED = int(zmq.EVENT_CONNECT_RETRIED)
KEYS_REFUSED = (
    int(zmq.EVENT_HANDSHAKE_FAILED_AUTH)
    | int(zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL)
    | int(zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL)
)
LOST = int(zmq.EVENT_DISCONNECTED)
WATCHED = REFUSED | KEYS_REFUSED | LOST


def prepare(socket: zmq.Socket[Any], address: Address) -> None:
    """Set what every client's socket has: no linger, keys, and heartbeats that find a dead host."""
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.RECONNECT_IVL, 100)
    if address.keys is not None:
        socket.setsockopt(zmq.CURVE_SERVERKEY, address.keys.server_public)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, address.keys.client_public)
        socket.setsockopt(zmq.CURVE_SECRETKEY, address.keys.client_secret)
    if not address.runtime:
        socket.setsockopt(zmq.HEARTBEAT_IVL, 1000)
        socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 5000)


def verdict(event: int, address: Address, greeted: bool) -> Exception | None:
    """Return what an event of the monitor means for a client."""
    if event & KEYS_REFUSED:
        return no_station(str(address), "it refused our CURVE keys; have `client.key` put into its keys_dir/clients")
    if event & LOST and greeted:
        return ConnectionLost(
            f"the connection to the station at {address} broke; look at its log, then open a new Station"
        )
    if event & REFUSED and not greeted:
        return no_station(str(address), "the connection was refused")
    return None


class Link:
    """Ask and be answered, blocking, each with a time-out. For one thread."""

    def __init__(self, context: zmq.Context[Any], address: Address, client: str) -> None:
        if not address.exists():
            raise no_station(str(address), "there is no control socket")
        self.address = address
        self.lease = ""
        self.greeted = False
        self.core = RequestCore(client)
        self._socket = context.socket(zmq.DEALER)
        prepare(self._socket, address)
        self._monitor = self._socket.get_monitor_socket(WATCHED)
        self._poller = zmq.Poller()
        self._poller.register(self._socket, zmq.POLLIN)
        self._poller.register(self._monitor, zmq.POLLIN)
        self._socket.connect(address.control)

    def close(self) -> None:
        """Close the socket; harmless when closed."""
        if not self._socket.closed:
            self._socket.disable_monitor()
            self._monitor.close(0)
            self._socket.close(0)

    def call(self, call: Call) -> Any:
        """Ask one question and return its answer.

        Raises
        ------
        RequestTimeout
            no answer within the call's time.
        ConnectionLost, NoStation
            the station went away, or never was there.
        FringedError
            the error that the station answered with.
        """
        if self._socket.closed:
            raise ConnectionLost(f"this client of {self.address} is closed; open a new Station")
        request_id, frames = self.core.request(call, self.lease)
        try:
            self._socket.send_multipart(frames, copy=False, track=False, flags=zmq.DONTWAIT)
            return self._await(request_id, call)
        except zmq.Again as error:
            raise RequestTimeout(f"the station at {self.address} takes no more requests; is it overloaded?") from error
        finally:
            self.core.forget(request_id)

    def _await(self, request_id: str, call: Call) -> Any:
        deadline = time.monotonic() + call.timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            ready = dict(self._poller.poll(int(left_s * 1000) + 1))
            if self._socket in ready:
                reply = self.core.receive(self._socket.recv_multipart(copy=False))
                if reply is not None and reply.id == request_id:
                    self.greeted = True
                    return self.core.result(reply)
            elif self._monitor in ready:
                self._look()
        raise RequestTimeout(
            f"the station at {self.address} did not answer {call.verb!r} within {call.timeout_s:g} s; "
            "`fringe status` tells whether it is alive"
        )

    def _look(self) -> None:
        event = int(recv_monitor_message(self._monitor)["event"])
        trouble = verdict(event, self.address, self.greeted)
        if isinstance(trouble, (NoStation, ConnectionLost)):
            raise trouble
