"""Scans, processing, leases and recordings, through the sockets of a real daemon."""

import random
import time
from dataclasses import replace

import numpy as np
import pytest
import zmq
from daemonkit import Daemon

from fringed import wire
from fringed.data import FrameSet, PhaseMap, RangeImage
from fringed.errors import (
    ConfigurationError,
    LeaseError,
    NotFound,
    QualityError,
    UsageError,
)
from fringed.messages import Request
from fringed_client.protocol.requests import Call


@pytest.fixture(scope="module")
def station_daemon(tmp_path_factory):
    made = Daemon(tmp_path_factory.mktemp("daemon")).until_ready().until_worker()
    yield made
    made.end()


@pytest.fixture
def client(station_daemon):
    with station_daemon.client() as made:
        yield made


def done(client, state, timeout_s=60.0):
    """Wait for the end of a scan or job, whatever it is."""
    deadline = time.monotonic() + timeout_s
    while state.state not in ("done", "failed", "cancelled"):
        assert time.monotonic() < deadline, state
        time.sleep(0.02)
        state = asked(client, "wait", id=state.id, timeout_s=0.0)
    return state


def asked(client, verb, **params):
    """Ask with parameters of any name."""
    return client._run(flow(Call(verb, params)))


def flow(call):
    return (yield call)


def test_a_scan_ends_with_a_recorded_range_image(client):
    state = done(client, client.request("scan"))
    assert state.state == "done", state
    products = {product["kind"]: product["id"] for product in state.products}
    assert set(products) == {"RangeImage", "PhaseMap"}
    image = client.request("get", id=products["RangeImage"])
    frames = client.request("get", id=state.frame_sets["object"])
    assert isinstance(image, RangeImage)
    assert isinstance(frames, FrameSet)
    assert frames.frames.shape == (12, 120, 160)
    assert frames.provenance.simulated
    assert image.provenance.simulated
    assert state.frame_sets["object"] in client.request("get", id=products["PhaseMap"]).provenance.inputs
    assert np.isfinite(image.xyz_mm[image.rejected == 0]).all()
    assert {"encode", "acquire", "acquire/object", "check", "record", "phase", "range"} <= set(state.timings_s)
    assert state.timings_s["last_frame_to_range_image"] > 0


def test_what_is_announced_is_recorded_and_numbered(client, station_daemon):
    with zmq.Context() as context, context.socket(zmq.SUB) as subscriber:
        subscriber.linger = 0
        subscriber.connect(f"ipc://{station_daemon.runtime}/stream")
        subscriber.subscribe("frameset")
        subscriber.subscribe("product/")
        time.sleep(0.2)
        state = client.request("scan")
        found = {}
        while len([i for i, scan in found.items() if scan == state.id]) < 3:
            assert subscriber.poll(20_000), found
            content = wire.decode(subscriber.recv_multipart()).content
            assert client.request("get", id=content.id).id == content.id
            found[content.id] = content.scan
        assert done(client, state).state == "done"


def test_reference_and_object_of_the_thesis_pipeline_and_a_reused_reference(client):
    first = done(client, client.request("scan", pipeline="thesis"))
    assert first.state == "done", first
    assert set(first.frame_sets) == {"reference", "object"}
    again = done(
        client, client.request("scan", pipeline="thesis", frame_sets={"reference": first.frame_sets["reference"]})
    )
    assert again.state == "done", again
    assert again.frame_sets["reference"] == first.frame_sets["reference"]
    assert "acquire/reference" not in again.timings_s


def test_a_recording_is_processed_again_with_other_parameters_and_by_single_stages(client):
    scan = done(client, client.request("scan"))
    again = done(
        client, client.request("process", pipeline="hierarchical", inputs={"object": scan.frame_sets["object"]})
    )
    assert again.state == "done", again
    stages = [{"plugin": "multi-frequency", "name": "only"}]
    single = done(client, client.request("process", stages=stages, inputs={"frames": scan.frame_sets["object"]}))
    assert [product["kind"] for product in single.products] == ["PhaseMap"]
    frames = client.request("get", id=scan.frame_sets["object"])
    given = done(client, client.request("process", stages=stages, inputs={"frames": replace(frames, id="")}))
    phase = client.request("get", id=given.products[0]["id"])
    assert isinstance(phase, PhaseMap)
    assert isinstance(client.request("get", id=phase.provenance.inputs[0]), FrameSet)


@pytest.mark.parametrize(
    ("verb", "params", "error"),
    [
        ("scan", {"pipeline": "nonsense"}, NotFound),
        ("scan", {"preset": "nonsense"}, NotFound),
        ("scan", {"encoder_params": {"stepz": 3}}, ConfigurationError),
        ("scan", {"stages": {"range": {"typo": 1}}}, ConfigurationError),
        ("scan", {"typo": 1}, UsageError),
        ("scan", {"camera": {"exposure_us": -5}}, ConfigurationError),
        ("process", {"stages": [{"plugin": "nonsense"}], "inputs": {}}, NotFound),
        ("get", {"id": "20260102T030405.678901Z-1f0c"}, NotFound),
        ("get", {"id": "../../etc/passwd"}, UsageError),
        ("get", {}, UsageError),
        ("wait", {"id": "nonsense", "timeout_s": 1}, NotFound),
        ("wait", {"id": "nonsense"}, NotFound),
        ("cancel", {"id": "nonsense"}, NotFound),
        ("republish", {"id": "x", "times": 0}, UsageError),
        ("simulate.fault", {"fault": "nonsense"}, UsageError),
        ("simulate.scene", {"scene": {"object": "sphere", "typo": 1}}, ConfigurationError),
        ("import", {"content": 3}, UsageError),
        ("lease.renew", {}, LeaseError),
        ("nonsense", {}, NotFound),
    ],
)
def test_what_cannot_be_meant_is_an_error_at_once(client, verb, params, error):
    with pytest.raises(error):
        asked(client, verb, **params)


def test_a_lease_keeps_others_from_moving_the_rig_but_not_from_reading(client, station_daemon):
    with station_daemon.client() as other, other.lease("other", ttl_s=30.0):
        with pytest.raises(LeaseError, match="held by 'other'"):
            client.request("scan")
        assert client.request("list", limit=1) is not None
        assert client.status().lease.holder == "other"
        assert done(other, other.request("scan")).state == "done"
        assert client.request("lease.break", reason="test")["broken"] == "other"
        assert client.status().lease is None


def test_a_lease_keeps_others_from_stopping_a_scan_but_not_their_own_processing(client, station_daemon):
    frames = client.request("scan", process=False)
    frames = done(client, frames).frame_sets["object"]
    with station_daemon.client() as other, other.lease("other", ttl_s=30.0):
        mine = client.request("process", pipeline="hierarchical", inputs={"object": frames})
        assert client.request("cancel", id=mine.id).state == "cancelled"
        scan = other.request("scan")
        with pytest.raises(LeaseError, match="held by 'other'"):
            client.request("cancel", id=scan.id)
        assert other.request("cancel", id=scan.id).state == "cancelled"


def test_a_cancelled_scan_ends_cancelled_and_the_next_one_works(client):
    state = client.request("scan")
    assert client.request("cancel", id=state.id).state == "cancelled"
    assert done(client, client.request("scan")).state == "done"


def test_a_fault_is_found_taken_again_and_counted(client):
    client.request("simulate.fault", fault="repeated", count=1)
    state = done(client, client.request("scan"))
    assert state.state == "done", state
    assert state.retakes == 1
    client.request("simulate.fault", fault="repeated", count=1000)
    failed = done(client, client.request("scan"))
    client.request("simulate.fault", fault="repeated", count=0)
    assert failed.state == "failed"
    assert failed.error.code == QualityError.__name__
    assert done(client, client.request("scan")).state == "done"


def test_another_scene_is_in_the_next_scan(client):
    client.request("simulate.scene", scene={"object": "plane", "translation_mm": [0.0, 0.0, -30.0]})
    state = done(client, client.request("scan", truth=True))
    kinds = [product["kind"] for product in state.products]
    assert "Truth" in kinds, state
    truth = client.request("get", id=next(p["id"] for p in state.products if p["kind"] == "Truth"))
    assert truth.frame_set == state.frame_sets["object"]
    assert truth.scene["object"] == "plane"
    client.request("simulate.scene", scene={"object": "sphere"})


def test_the_scene_stays_while_a_scan_takes_its_sets(client):
    client.request("simulate.fault", fault="stall", count=1)
    state = client.request("scan")
    while state.state in ("queued", "encoding"):
        state = asked(client, "wait", id=state.id, timeout_s=5.0)
    assert state.state == "acquiring"
    with pytest.raises(UsageError, match="taking its sets"):
        client.request("simulate.scene", scene={"object": "plane"})
    assert done(client, state).state == "done"


def test_what_a_plugin_doubts_is_in_the_scans_state(client):
    state = done(client, client.request("scan", pipeline="thesis"))
    assert state.state == "done", state
    assert any("expected_depth_mm" in text for text in state.warnings)
    assert done(client, client.request("scan")).warnings == ()


def test_latency_is_measured(client):
    state = done(client, client.request("latency"))
    assert state.state == "done", state


def test_a_set_is_announced_again_as_often_as_asked(client, station_daemon):
    scan = done(client, client.request("scan"))
    with zmq.Context() as context, context.socket(zmq.SUB) as subscriber:
        subscriber.linger = 0
        subscriber.connect(f"ipc://{station_daemon.runtime}/stream")
        subscriber.subscribe("frameset")
        assert subscriber.poll(10_000)  # the last value, for a late joiner
        last = wire.decode(subscriber.recv_multipart()).seq
        client.request("republish", id=scan.frame_sets["object"], times=20, interval_s=0.0)
        seqs = []
        while last + 20 not in seqs:
            assert subscriber.poll(10_000), seqs
            seqs.append(wire.decode(subscriber.recv_multipart()).seq)
        assert [seq for seq in seqs if seq > last] == list(range(last + 1, last + 21))


def test_a_list_is_newest_first_and_filtered(client):
    state = done(client, client.request("scan"))
    mine = client.request("list", scan=state.id)
    assert {item["kind"] for item in mine} == {"FrameSet", "PhaseMap", "RangeImage"}
    ids = [item["id"] for item in client.request("list", limit=50)]
    assert ids == sorted(ids, reverse=True)
    assert all(item["kind"] == "RangeImage" for item in client.request("list", kind="range-image"))


def noise(rng, number):
    if number % 2:
        return [rng.randbytes(rng.randrange(60)) for _ in range(rng.randrange(1, 6))]
    parts = [bytearray(bytes(part)) for part in wire.encode(Request("r", "status", {"a": [1, {"b": "c"}]}))]
    for _ in range(rng.randrange(1, 4)):
        part = rng.choice(parts)
        if part:
            part[rng.randrange(len(part))] = rng.randrange(256)
    return [bytes(part) for part in parts]


@pytest.mark.parametrize(("name", "kind"), [("control", zmq.DEALER), ("work", zmq.DEALER), ("stream", zmq.XSUB)])
def test_ten_thousand_random_messages_leave_it_serving(client, station_daemon, name, kind):
    rng = random.Random(3)
    with zmq.Context() as context, context.socket(kind) as attacker:
        attacker.linger = 0
        attacker.connect(f"ipc://{station_daemon.runtime}/{name}")
        for number in range(10_000):
            attacker.send_multipart(noise(rng, number))
            while kind == zmq.DEALER and attacker.poll(0):
                attacker.recv_multipart()
    state = client.status()
    assert state.pid == station_daemon.process.pid
    assert state.counters["handler_failures"] == 0
    assert done(client, client.request("scan")).state == "done"


def test_nothing_failed_inside_while_all_this_happened(client, station_daemon):
    assert client.status().counters["handler_failures"] == 0
    assert "Traceback" not in station_daemon.log, station_daemon.log[-4000:]
    assert (station_daemon.runtime / "control").exists()
