"""A context that closes its sockets, and a reactor."""

from collections.abc import Iterator

import pytest
import zmq

from fringed.serving.reactor import Reactor


@pytest.fixture
def context() -> Iterator[zmq.Context]:
    made = zmq.Context()
    kept = []
    make = made.socket

    def socket(*arguments, **options):
        kept.append(make(*arguments, **options))
        return kept[-1]

    made.__dict__["socket"] = socket
    yield made
    for one in kept:
        one.close(linger=0)
    made.term()


@pytest.fixture
def reactor() -> Iterator[Reactor]:
    made = Reactor()
    yield made
    made.close()
