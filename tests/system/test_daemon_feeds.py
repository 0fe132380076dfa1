"""A real daemon whose worker gets the frames while they are taken: the same products as from the recording."""

import numpy as np
import pytest
from daemonkit import Daemon

from fringed.data import RangeImage
from fringed_client import Station

SCANS = 8  # at the simulator's pace a worker may fall behind; of so many scans one is fed


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    daemon = Daemon(tmp_path_factory.mktemp("daemon")).until_ready().until_worker()
    with daemon.client() as made:
        yield made
    daemon.end()


def fed(client: Station) -> int:
    return client.status().counters.get("work_sets_fed", 0)


def scan_until_fed(client: Station, fault: str = ""):
    """Return a scan whose set its worker was fed."""
    for _ in range(SCANS):
        before = fed(client)
        if fault:
            client.request("simulate.fault", fault=fault, count=1)
        result = client.scan(pipeline="hierarchical")
        if fed(client) > before:
            return result
    pytest.fail(f"none of {SCANS} scans was fed: {client.status().counters}")


def range_of(client: Station, state) -> RangeImage:
    [identity] = [product["id"] for product in state.products if product["kind"] == "RangeImage"]
    return client.get(identity)


@pytest.mark.parametrize("fault", ["", "repeated"])
def test_product_of_a_fed_set_is_that_of_its_recording(client, fault):
    state = scan_until_fed(client, fault).state
    assert state.retakes == (1 if fault else 0)
    image = range_of(client, state)
    [phase] = [product["id"] for product in state.products if product["kind"] == "PhaseMap"]
    assert state.frame_sets["object"] in client.get(phase).provenance.inputs
    again = client.process({"object": state.frame_sets["object"]}, pipeline="hierarchical").state
    other = range_of(client, again)
    assert np.mean(image.rejected != other.rejected) < 1e-3  # sums in another order round otherwise
    both = (image.rejected == 0) & (other.rejected == 0)
    assert both.any()
    assert np.abs(image.xyz_mm[both] - other.xyz_mm[both]).max() < 0.01


def test_every_set_of_a_scan_is_fed(client):
    for _ in range(SCANS):
        before = fed(client)
        result = client.scan(pipeline="thesis")
        if fed(client) == before + 2:
            break
    else:
        pytest.fail(f"none of {SCANS} scans was fed twice: {client.status().counters}")
    assert set(result.state.frame_sets) == {"reference", "object"}


def test_cancelled_scan_leaves_no_feed_behind(client):
    state = client.request("scan", pipeline="hierarchical")
    client.request("cancel", id=state.id)
    assert scan_until_fed(client).state.state == "done"
