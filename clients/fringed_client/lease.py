"""Hold the rig for a while: acquire, renew from a thread, release.

Owns the renewing; the station decides who holds what.
"""

from __future__ import annotations

import logging
import threading
from typing import Any

import zmq

from fringed.errors import FringedError
from fringed_client.address import Address
from fringed_client.link import Link
from fringed_client.protocol.requests import Call

log = logging.getLogger(__name__)


class Lease:
    """A held rig, as a context manager. `lost` is set when renewing failed; scans then fail with LeaseError."""

    def __init__(self, link: Link, context: zmq.Context[Any], holder: str, ttl_s: float, scope: str) -> None:
        self.holder = holder
        self.lost = False
        self._link = link
        self._context = context
        self._ttl_s = ttl_s
        self._stop = threading.Event()
        granted = link.call(Call("lease.acquire", {"holder": holder, "ttl_s": ttl_s, "scope": scope}))
        self.token = str(granted["token"])
        link.lease = self.token
        self._thread = threading.Thread(target=self._renew, name="lease", daemon=True)
        self._thread.start()

    def __enter__(self) -> Lease:
        return self

    def __exit__(self, *exc: object) -> None:
        self.release()

    def release(self) -> None:
        """Give the rig back; harmless when given back, or when the station is gone."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join(10)
        try:
            self._link.call(Call("lease.release"))
        except FringedError as error:
            log.info("the lease of %s ended by itself: %s", self.holder, error)
        self._link.lease = ""

    def _renew(self) -> None:
        link = _second(self._context, self._link.address, self.token)
        try:
            while not self._stop.wait(self._ttl_s / 3):
                link.call(Call("lease.renew", {}, min(5.0, self._ttl_s)))
        except FringedError as error:
            self.lost = True
            log.warning("the lease of %s cannot be renewed: %s", self.holder, error)
        finally:
            link.close()


def _second(context: zmq.Context[Any], address: Address, token: str) -> Link:
    """Return a connection of the renewing thread's own; sockets are for one thread."""
    link = Link(context, address, "lease")
    link.lease = token
    return link
