"""The blocking and the asyncio client against a station that answers as told."""

from __future__ import annotations

import asyncio
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from fakestation import SILENT, FakeStation, scan_state, state

from fringed.data import Provenance, RangeImage
from fringed.errors import ConnectionLost, LeaseError, NoStation, RequestTimeout, UsageError, VersionMismatch
from fringed.messages import Event
from fringed_client import AsyncStation, Station
from fringed_client.address import Address


def image() -> RangeImage:
    xyz = np.zeros((4, 5, 3), np.float32)
    kept = np.zeros((4, 5), np.uint8)
    return RangeImage(xyz, kept, kept, id="r", provenance=Provenance(simulated=True))


def serve_scan(fake: FakeStation) -> None:
    product = {"id": "r", "kind": "RangeImage", "stage": "range", "role": ""}
    fake.verbs["scan"] = lambda _: scan_state("queued")
    fake.verbs["wait"] = lambda _: scan_state("done", 1.0, products=(product,), frame_sets={"object": "f"})
    fake.verbs["get"] = lambda _: image()


def test_nobody_there_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(NoStation, match="fringed run"):
        Station(tmp_path)


def test_socket_file_without_a_station_is_noticed_at_once(tmp_path: Path) -> None:
    (tmp_path / "control").touch()
    with pytest.raises(NoStation, match="refused"):
        Station(tmp_path)


def test_other_protocol_version_is_refused(fake: FakeStation) -> None:
    fake.protocol = 99
    with pytest.raises(VersionMismatch):
        Station(fake.runtime)


def test_scan_brings_products_that_are_fetched_when_used(fake: FakeStation) -> None:
    serve_scan(fake)
    seen = []
    with Station(fake.runtime) as station:
        result = station.scan("hierarchical", on_progress=lambda s: seen.append(s.state))
        assert "get" not in fake.names()
        assert result.range_image.xyz_mm.shape == (4, 5, 3)
        assert result.range_image is result.range_image
        assert fake.names().count("get") == 1
        assert not result.range_image.xyz_mm.flags.writeable
    assert seen == ["queued", "done"]


def test_errors_of_the_station_are_raised(fake: FakeStation) -> None:
    def refuse(_: object) -> None:
        raise LeaseError("held by ann")

    fake.verbs["scan"] = refuse
    with Station(fake.runtime) as station, pytest.raises(LeaseError, match="ann") as caught:
        station.scan()
    assert caught.value.__notes__ == ["a detail"]


def test_no_answer_is_a_time_out(fake: FakeStation) -> None:
    fake.verbs["plugins"] = lambda _: SILENT
    with Station(fake.runtime) as station, pytest.raises(RequestTimeout, match="plugins"):
        station.request("plugins", timeout_s=0.2)


def test_lost_connection_is_raised_while_waiting(fake: FakeStation) -> None:
    fake.verbs["plugins"] = lambda _: SILENT
    with Station(fake.runtime) as station:
        threading.Timer(0.2, fake.stop).start()
        began = time.monotonic()
        with pytest.raises(ConnectionLost):
            station.request("plugins", timeout_s=60)
        assert time.monotonic() - began < 30


def test_subscription_yields_typed_messages_with_what_was_missed(fake: FakeStation) -> None:
    with Station(fake.runtime) as station, station.subscribe("event") as subscription:
        with pytest.raises(RequestTimeout):
            subscription.next(timeout_s=0.3)
        for seq in (3, 4, 4, 9):
            fake.publish(Event("scan.progress", "now"), "event", seq)
        got = [subscription.next(timeout_s=5) for _ in range(3)]
    assert [(m.seq, m.missed) for m in got] == [(3, 0), (4, 0), (9, 4)]
    assert got[0].content.name == "scan.progress"


def test_latest_skips_to_the_newest_of_each_topic(fake: FakeStation) -> None:
    with Station(fake.runtime) as station, station.subscribe("event", "product", latest=True) as subscription:
        with pytest.raises(RequestTimeout):
            subscription.next(timeout_s=0.3)
        fake.publish(image(), "product/range-image", 1)
        for seq in range(1, 30):
            fake.publish(Event("e", "now"), "event", seq)
        time.sleep(0.5)
        newest = {}
        for _ in range(20):
            try:
                message = subscription.next(timeout_s=0.3)
            except RequestTimeout:
                break
            newest[message.topic] = message
    assert newest["event"].seq == 29 or newest["event"].missed > 0
    assert newest["product/range-image"].seq == 1


def test_subscription_notices_a_lost_station(fake: FakeStation) -> None:
    with Station(fake.runtime) as station, station.subscribe("event") as subscription:
        with pytest.raises(RequestTimeout):
            subscription.next(timeout_s=0.3)
        fake.stop()
        with pytest.raises(ConnectionLost):
            subscription.next(timeout_s=30)


def test_lease_is_sent_with_requests_renewed_and_given_back(fake: FakeStation) -> None:
    fake.verbs["lease.acquire"] = lambda _: {"token": "t0", "expires_in_s": 0.3}
    fake.verbs["lease.renew"] = lambda _: {"token": "t0", "expires_in_s": 0.3}
    fake.verbs["lease.release"] = lambda _: {}
    with Station(fake.runtime) as station:
        with station.lease("ann", ttl_s=0.3):
            time.sleep(0.5)
            station.status()
        station.status()
    tokens = [r.lease for r in fake.requests if r.verb == "status"]
    assert tokens == ["t0", ""]
    assert "lease.renew" in fake.names() and "lease.release" in fake.names()


def test_async_client_scans_and_asks_meanwhile(fake: FakeStation) -> None:
    serve_scan(fake)

    async def work() -> tuple[str, tuple[int, ...]]:
        async with AsyncStation(fake.runtime) as station:
            result, status = await asyncio.gather(station.scan(), station.status())
            found = await result.last("RangeImage")
            return status.name, found.xyz_mm.shape

    assert asyncio.run(work()) == ("fake", (4, 5, 3))


def test_async_cancellation_cancels_the_scan(fake: FakeStation) -> None:
    fake.verbs["scan"] = lambda _: scan_state("queued")
    fake.verbs["wait"] = lambda _: SILENT
    fake.verbs["cancel"] = lambda _: scan_state("cancelled")

    async def work() -> None:
        async with AsyncStation(fake.runtime) as station:
            task = asyncio.create_task(station.scan())
            await asyncio.sleep(0.2)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    asyncio.run(work())
    assert fake.names()[-1] == "cancel"


def test_async_subscription_and_lost_connection(fake: FakeStation) -> None:
    async def follow(station: AsyncStation, seqs: list[int]) -> None:
        async for message in station.subscribe("state"):
            seqs.append(message.seq)
            if len(seqs) == 2:
                fake.stop()

    async def work() -> list[int]:
        async with AsyncStation(fake.runtime) as station:
            seqs: list[int] = []
            with pytest.raises(ConnectionLost):
                await follow(station, seqs)
            with pytest.raises(ConnectionLost):
                await station.status()
            return seqs

    assert len(asyncio.run(work())) >= 2


def test_async_nobody_there(tmp_path: Path) -> None:
    async def work() -> None:
        with pytest.raises(NoStation):
            await AsyncStation(tmp_path).open()

    asyncio.run(work())


def test_addresses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRINGED_STATION", str(tmp_path))
    assert Address.of().control == f"ipc://{tmp_path}/control"
    with pytest.raises(UsageError, match="keys"):
        Address.of("tcp://rig:7601", tmp_path)
    for wrong in ("http://rig", "tcp://rig:99999", "tcp://"):
        with pytest.raises(UsageError):
            Address.of(wrong, tmp_path)
    with pytest.raises(UsageError, match="shorter"):
        Address.of("/" + "x" * 120)


def test_tcp_stream_is_on_the_host_that_was_named() -> None:
    address = Address("tcp://rig.lab:7601")
    assert address.stream("tcp://0.0.0.0:7602") == "tcp://rig.lab:7602"


def test_notebooks_see_thumbnails_and_the_simulated_mark(fake: FakeStation) -> None:
    serve_scan(fake)
    fake.verbs["get"] = lambda r: image()
    with Station(fake.runtime) as station:
        html = station.scan()._repr_html_()
    assert "data:image/png;base64," in html and "SIMULATED" in html
    assert state().simulated
