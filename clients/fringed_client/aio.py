"""The asyncio client of a station.

Owns the tasks that read the sockets; the conversations are the same `protocol.flows` as the blocking
client's. Requests of several tasks may be under way at the same time.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import zmq
import zmq.asyncio
from zmq.utils.monitor import recv_monitor_message

from fringed.data import PatternSequence
from fringed.errors import ConnectionLost, FringedError, RequestTimeout, WireError
from fringed.messages import Reply, ScanState, StationState
from fringed_client.address import Address
from fringed_client.files import write_aside
from fringed_client.link import LOST, WATCHED, prepare, verdict
from fringed_client.protocol import flows
from fringed_client.protocol.flows import Flow, OnProgress
from fringed_client.protocol.messages import Message, SubscriptionCore
from fringed_client.protocol.requests import Call, RequestCore
from fringed_client.results import AsyncScanResult
from fringed_client.station import JOB_TIMEOUT_S, client_name
from fringed_client.subscription import QUEUE, SILENCE_MAX_S

T = TypeVar("T")


class AsyncStation:
    """A station, for one event loop: `async with AsyncStation() as station: ...`.

    Takes the same arguments and raises the same errors as `Station`.
    """

    def __init__(
        self, where: str | Path | Address | None = None, keys: str | Path | None = None, client: str | None = None
    ) -> None:
        self.address = Address.of(where, keys)
        self.hello: dict[str, Any] = {}
        self._core = RequestCore(client or client_name())
        self._futures: dict[str, asyncio.Future[Reply]] = {}
        self._tasks: list[asyncio.Task[None]] = []
        self._trouble: Exception | None = None

    async def __aenter__(self) -> AsyncStation:
        await self.open()
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Connect and greet.

        Raises
        ------
        NoStation, VersionMismatch
            as `Station`.
        """
        if not self.address.exists():
            raise flows.no_station(str(self.address), "there is no control socket")
        self._context = zmq.asyncio.Context()
        self._socket: zmq.asyncio.Socket = self._context.socket(zmq.DEALER)
        prepare(self._socket, self.address)
        self._monitor = self._socket.get_monitor_socket(WATCHED)
        self._socket.connect(self.address.control)
        self._tasks = [asyncio.create_task(self._read()), asyncio.create_task(self._watch())]
        try:
            self.hello = await self._run(flows.hello(str(self.address)))
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Stop reading and close every socket; harmless when closed."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._tasks:
            self._tasks = []
            self._fail(ConnectionLost(f"this client of {self.address} is closed; open a new AsyncStation"))
            self._socket.disable_monitor()
            self._monitor.close(0)
            self._context.destroy(linger=0)

    def _fail(self, trouble: Exception) -> None:
        self._trouble = self._trouble or trouble
        for future in self._futures.values():
            if not future.done():
                future.set_exception(trouble)

    async def _read(self) -> None:
        while True:
            try:
                reply = self._core.receive(await self._socket.recv_multipart(copy=False))
            except FringedError as error:
                if not isinstance(error, WireError) or not self.hello:
                    self._fail(error)
                continue
            future = self._futures.pop(reply.id, None) if reply is not None else None
            if reply is not None and future is not None and not future.done():
                future.set_result(reply)

    async def _watch(self) -> None:
        while True:
            await self._monitor.poll()
            event = int((await recv_monitor_message(self._monitor))["event"])
            trouble = verdict(event, self.address, bool(self.hello))
            if trouble is not None:
                self._fail(trouble)

    async def _call(self, call: Call) -> Any:
        if self._trouble is not None:
            raise self._trouble
        request_id, frames = self._core.request(call)
        future: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._futures[request_id] = future
        try:
            async with asyncio.timeout(call.timeout_s):
                await self._socket.send_multipart(frames, copy=False)
                return self._core.result(await future)
        except TimeoutError as error:
            if isinstance(error, FringedError):
                raise
            raise RequestTimeout(
                f"the station at {self.address} did not answer {call.verb!r} within {call.timeout_s:g} s"
            ) from error
        finally:
            self._core.forget(request_id)
            self._futures.pop(request_id, None)

    async def _run(self, flow: Flow[T]) -> T:
        try:
            call = next(flow)
            while True:
                try:
                    answer = await self._call(call)
                except BaseException as error:  # noqa: BLE001  it goes into the flow, which raises it again
                    call = flow.throw(error)
                else:
                    call = flow.send(answer)
        except StopIteration as stop:
            result: T = stop.value
            return result

    async def request(self, verb: str, /, timeout_s: float = 10.0, **params: Any) -> Any:
        """Ask anything by its verb."""
        return await self._run(flows.ask(verb, timeout_s, **params))

    async def status(self) -> StationState:
        """Return how the station is."""
        state: StationState = await self.request("status")
        return state

    async def patterns(
        self,
        encoder: str,
        params: Mapping[str, Any] | None = None,
        size_px: tuple[int, int] | None = None,
        timeout_s: float = flows.FETCH_TIMEOUT_S,
    ) -> PatternSequence:
        """Return what an encoder would project, as `Station.patterns`."""
        sequence: PatternSequence = await self._run(flows.patterns(encoder, params, size_px, timeout_s))
        return sequence

    async def scan(
        self,
        pipeline: str | None = None,
        preset: str | None = None,
        *,
        roles: Sequence[str] | None = None,
        truth: bool | None = None,
        on_progress: OnProgress | None = None,
        timeout_s: float = JOB_TIMEOUT_S,
        **more: Any,
    ) -> AsyncScanResult:
        """Take the sets of a pipeline and process them; `more` and the errors as `Station.scan`."""
        asked = {
            "pipeline": pipeline, "preset": preset, "roles": list(roles) if roles else None, "truth": truth, **more
        }  # fmt: skip
        return await self._submit("scan", asked, timeout_s, on_progress)

    async def process(
        self,
        inputs: Mapping[str, Any],
        pipeline: str | None = None,
        *,
        stages: Sequence[Mapping[str, Any]] | None = None,
        params: Mapping[str, Mapping[str, Any]] | None = None,
        on_progress: OnProgress | None = None,
        timeout_s: float = JOB_TIMEOUT_S,
    ) -> AsyncScanResult:
        """Run a pipeline's stages, or the given ones, as `Station.process`."""
        asked = {"pipeline": pipeline, "stages": stages, "inputs": dict(inputs), "params": params}
        return await self._submit("process", asked, timeout_s, on_progress)

    async def register(
        self,
        views: Sequence[Any],
        processor: str | None = None,
        params: Mapping[str, Any] | None = None,
        *,
        merge: bool = True,
        timeout_s: float = JOB_TIMEOUT_S,
    ) -> AsyncScanResult:
        """Bring range images together, as `Station.register`."""
        return await self._submit("process", flows.register_params(views, processor, params, merge), timeout_s)

    async def _submit(
        self, verb: str, asked: Mapping[str, Any], timeout_s: float, on_progress: OnProgress | None = None
    ) -> AsyncScanResult:
        return AsyncScanResult(await self._run(flows.submit(verb, asked, timeout_s, on_progress)), self.get)

    async def wait(
        self, id: str, on_progress: OnProgress | None = None, timeout_s: float = JOB_TIMEOUT_S
    ) -> AsyncScanResult:
        """Wait for a scan or job that somebody else has started."""
        return AsyncScanResult(await self._run(flows.watch(id, timeout_s, on_progress)), self.get)

    async def cancel(self, id: str) -> ScanState:
        """Stop a scan or job."""
        state: ScanState = await self.request("cancel", id=id)
        return state

    async def get(self, id: str) -> Any:
        """Return a recorded frame set or product."""
        return await self._run(flows.fetch(id))

    async def list(
        self, kind: str | None = None, scan: str | None = None, limit: int = 100, before: str | None = None
    ) -> list[dict[str, Any]]:
        """Return what is recorded, newest first."""
        return list(await self.request("list", timeout_s=30.0, kind=kind, scan=scan, limit=limit, before=before))

    async def export(
        self,
        item: Any,
        format: str,
        path: str | Path,
        params: Mapping[str, Any] | None = None,
        timeout_s: float = JOB_TIMEOUT_S,
    ) -> Path:
        """Write a product as a file, as `Station.export`."""
        artifact = await self._run(flows.export(item, format, params, timeout_s))
        return await asyncio.to_thread(write_aside, Path(path), artifact.content.data)

    async def subscribe(self, *topics: str, latest: bool = False) -> AsyncIterator[Message]:
        """Iterate over typed messages, as `Station.subscribe`: `async for message in station.subscribe("state")`."""
        core = SubscriptionCore(topics)
        socket: zmq.asyncio.Socket = self._context.socket(zmq.SUB)
        prepare(socket, self.address)
        socket.setsockopt(zmq.RCVHWM, QUEUE)
        monitor = socket.get_monitor_socket(LOST)
        for prefix in core.prefixes:
            socket.subscribe(prefix)
        socket.connect(self.address.stream(str(self.hello["stream"])))
        try:
            while True:
                for frames in await _receive(socket, monitor, latest, str(self.address)):
                    message = core.receive(frames)
                    if message is not None:
                        yield message
        finally:
            with contextlib.suppress(zmq.ZMQError):  # the station may have been closed before its iterators
                socket.disable_monitor()
            monitor.close(0)
            socket.close(0)


async def _receive(
    socket: zmq.asyncio.Socket, monitor: zmq.asyncio.Socket, latest: bool, where: str
) -> list[list[Any]]:
    """Wait for the next message; with `latest`, return the newest of each topic that is there."""
    silent_s = 0.0
    while not await socket.poll(500):
        silent_s += 0.5
        if silent_s >= SILENCE_MAX_S or await monitor.poll(0):
            raise ConnectionLost(f"the connection to the station at {where} broke; open a new AsyncStation")
    found: list[list[Any]] = [await socket.recv_multipart(copy=False)]
    while latest and await socket.poll(0):
        found.append(await socket.recv_multipart(copy=False))
    newest = {frames[0].bytes: frames for frames in found}
    return list(newest.values())
