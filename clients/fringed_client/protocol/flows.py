"""What a client asks in which order, as generators: they yield a `Call`, are sent its answer, and return a result.

Owns the conversation with a station; does no I/O. A driver executes each call and sends the answer
back, or throws the error in; that is all that the sync and the asyncio client differ in. Whoever is
interrupted during a scan (Ctrl-C, a cancelled task, a time-out) cancels it on the station first.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, TypeVar

from fringed import wire
from fringed.errors import Cancelled, ConnectionLost, NoStation, RequestTimeout, StationError, VersionMismatch
from fringed.messages import ScanState
from fringed_client.protocol.requests import Call, revive

T = TypeVar("T")
Flow = Generator[Call, Any, T]
OnProgress = Callable[[ScanState], None]

FINISHED = ("done", "failed", "cancelled")
HELLO_TIMEOUT_S = 3.0
WAIT_SLICE_S = 2.0
GRACE_S = 5.0
PROBE_TIMEOUT_S = 3.0
FETCH_TIMEOUT_S = 60.0


def hello(where: str) -> Flow[dict[str, Any]]:
    """Greet the station and check that both speak the same version."""
    try:
        greeting = yield Call("hello", {}, HELLO_TIMEOUT_S)
    except RequestTimeout as error:
        raise no_station(where, f"nobody answered within {HELLO_TIMEOUT_S:g} s") from error
    if greeting.get("protocol") != wire.VERSION:
        raise VersionMismatch(
            f"the station at {where} (fringed {greeting.get('version', '?')}) speaks protocol "
            f"{greeting.get('protocol')}; this client speaks {wire.VERSION}: install the same release on both"
        )
    return dict(greeting)


def no_station(where: str, why: str) -> NoStation:
    """Return the error that tells how to get a station."""
    return NoStation(
        f"no station at {where}: {why}. Start one with `fringed run`, or name another one with "
        "--station or FRINGED_STATION (a runtime folder, or tcp://host:port)"
    )


def ask(verb: str, /, timeout_s: float = 10.0, **params: Any) -> Flow[Any]:
    """Ask one question."""
    return (yield Call(verb, {key: value for key, value in params.items() if value is not None}, timeout_s))


def submit(
    verb: str,
    params: Mapping[str, Any],
    timeout_s: float,
    on_progress: OnProgress | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Flow[ScanState]:
    """Start a scan or a job and see it through.

    Raises
    ------
    RequestTimeout
        it took longer than `timeout_s`; it has been cancelled.
    FringedError
        whatever made it fail.
    """
    given = {key: value for key, value in params.items() if value is not None}
    state: ScanState = yield Call(verb, given, FETCH_TIMEOUT_S)
    return (yield from follow(state, timeout_s, on_progress, clock))


def follow(
    state: ScanState,
    timeout_s: float,
    on_progress: OnProgress | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Flow[ScanState]:
    """Wait until a scan or job has ended; raises its error when it failed."""
    deadline = clock() + timeout_s
    try:
        while True:
            if on_progress is not None:
                on_progress(state)
            if state.state in FINISHED:
                return (yield from _ended(state))
            left_s = deadline - clock()
            if left_s <= 0:
                raise RequestTimeout(
                    f"{state.id} is {state.state} ({state.progress:.0%}) after {timeout_s:g} s and was cancelled; "
                    "allow it a longer timeout (--timeout on the command line)"
                )
            state = yield _wait(state, min(WAIT_SLICE_S, left_s))
    except (KeyboardInterrupt, asyncio.CancelledError, GeneratorExit, RequestTimeout) as error:
        if not isinstance(error, GeneratorExit):
            yield Call("cancel", {"id": state.id}, GRACE_S)
        raise


def watch(
    scan_id: str,
    timeout_s: float,
    on_progress: OnProgress | None = None,
    clock: Callable[[], float] = time.monotonic,
    until: str = "",
) -> Flow[ScanState]:
    """Wait for what was started before, to its end or to the state `until`; whoever stops waiting leaves it running."""
    deadline = clock() + timeout_s
    state: ScanState = yield Call("wait", {"id": scan_id, "timeout_s": 0.0})
    while state.state not in FINISHED and state.state != until:
        if on_progress is not None:
            on_progress(state)
        left_s = deadline - clock()
        if left_s <= 0:
            raise RequestTimeout(f"{scan_id} is still {state.state} ({state.progress:.0%}) after {timeout_s:g} s")
        state = yield _wait(state, min(WAIT_SLICE_S, left_s))
    return (yield from _ended(state))


def _wait(state: ScanState, slice_s: float) -> Call:
    seen = {"state": state.state, "progress": state.progress, "products": len(state.products)}
    return Call("wait", {"id": state.id, "timeout_s": slice_s, "seen": seen}, slice_s + GRACE_S)


def _ended(state: ScanState) -> Flow[ScanState]:
    """Return the state of what went well. A station that stops cancels what runs: that is not what anybody asked."""
    try:
        return checked(state)
    except Cancelled as error:
        try:
            yield Call("status", {}, PROBE_TIMEOUT_S)
        except StationError:
            raise ConnectionLost(
                f"the station stopped during {state.id}; look at its log, start it again and repeat the command"
            ) from error
        raise


def checked(state: ScanState) -> ScanState:
    """Return the state of what went well; raise the error of what did not."""
    if state.error is not None:
        raise revive(state.error)
    return state


def fetch(item_id: str) -> Flow[Any]:
    """Fetch one recorded object."""
    return (yield Call("get", {"id": item_id}, FETCH_TIMEOUT_S))


def patterns(
    encoder: str, params: Mapping[str, Any] | None, size_px: tuple[int, int] | None, timeout_s: float
) -> Flow[Any]:
    """Return the PatternSequence that an encoder makes."""
    asked: dict[str, Any] = {"encoder": encoder, "params": dict(params or {})}
    if size_px is not None:
        asked |= {"width_px": size_px[0], "height_px": size_px[1]}
    return (yield Call("patterns", asked, timeout_s))


def exporter_stage(format: str, params: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """Return the one stage that makes a file of a product."""
    return [{"name": "export", "kind": "exporter", "plugin": format, "params": dict(params or {}), "keep": True}]


def export(item: Any, format: str, params: Mapping[str, Any] | None, timeout_s: float) -> Flow[Any]:
    """Return the Artifact that the exporter `format` makes of a product (its id, or the object)."""
    asked = {"stages": exporter_stage(format, params), "inputs": {"product": item}}
    state = yield from submit("process", asked, timeout_s)
    return (yield from fetch(last_product(state, "Artifact")))


def last_product(state: ScanState, kind: str) -> str:
    """Return the id of a scan's last product of that kind.

    Raises
    ------
    NotFound
        it has none.
    """
    from fringed.errors import NotFound

    found = [p["id"] for p in state.products if p.get("kind") == kind]
    if not found:
        kinds = ", ".join(sorted({str(p.get("kind")) for p in state.products})) or "nothing"
        raise NotFound(f"{state.id} ({state.pipeline or 'no pipeline'}) has no {kind}; it has {kinds}")
    return str(found[-1])


def registration_stages(processor: str, params: Mapping[str, Any] | None, merge: bool) -> list[dict[str, Any]]:
    """Return the stage that brings views together: all in one model, or one pair's transform."""
    named = {"views": "views"} if merge else {"reference": "reference", "model": "model"}
    return [{"name": "merge" if merge else "register", "kind": "processor", "plugin": processor,
             "params": dict(params or {}), "inputs": named, "keep": True}]  # fmt: skip


def register_params(
    views: Sequence[Any], processor: str | None, params: Mapping[str, Any] | None, merge: bool
) -> dict[str, Any]:
    """Return what `process` needs to register views: ids or objects, the first one is the reference.

    Raises
    ------
    UsageError
        fewer than two views, or not exactly two for one pair's transform.
    """
    from fringed.errors import UsageError

    if len(views) < 2 or (not merge and len(views) != 2):
        wanted = "two or more views" if merge else "exactly two views, reference and model"
        raise UsageError(f"{len(views)} view(s) given; registration needs {wanted}")
    stages = registration_stages(processor or ("merge" if merge else "register"), params, merge)
    inputs = {"views": list(views)} if merge else {"reference": views[0], "model": views[1]}
    return {"stages": stages, "inputs": inputs}
