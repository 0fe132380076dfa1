"""pyzmq frees zero-copy buffers in a thread of its own, which lives as long as the process."""

from collections.abc import Iterator

import pytest
import zmq
from zmq.utils.garbage import gc

from fringed.serving.reactor import Reactor


@pytest.fixture(scope="session", autouse=True)
def _collector() -> None:
    gc.start()


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
