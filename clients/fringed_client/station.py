"""The blocking client of a station.

Owns a connection and the names of what can be asked; the conversations are in `protocol.flows`.
"""

from __future__ import annotations

import getpass
import os
import socket as hostnames
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import zmq

from fringed.data import PatternSequence
from fringed.errors import UsageError
from fringed.messages import ScanState, StationState
from fringed_client.address import Address
from fringed_client.files import write_aside
from fringed_client.lease import Lease
from fringed_client.link import Link
from fringed_client.protocol import flows
from fringed_client.protocol.flows import Flow, OnProgress
from fringed_client.results import ScanResult
from fringed_client.subscription import Subscription

T = TypeVar("T")
JOB_TIMEOUT_S = 300.0


def client_name() -> str:
    """Return how this client is called in the station's log: user, machine and process."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user without a name, as in some containers
        user = str(os.getuid())
    return f"{user}@{hostnames.gethostname()}:{os.getpid()}"


class Station:
    """A station, for one thread: `with Station() as station: ...`.

    Parameters
    ----------
    where
        a runtime folder, `tcp://host[:port]`, or None for $FRINGED_STATION or the usual folder.
    keys
        folder of the CURVE keys for tcp.
    client
        how the station's log names this client.

    Raises
    ------
    NoStation
        nobody serves there; the message says what to do.
    VersionMismatch
        the station speaks another protocol version.

    Every call raises ConnectionLost as soon as the station is gone; open a new Station then. Every wait has a
    time-out.
    """

    def __init__(
        self, where: str | Path | Address | None = None, keys: str | Path | None = None, client: str | None = None
    ) -> None:
        self.address = Address.of(where, keys)
        self._context: zmq.Context[Any] = zmq.Context()
        self._subscriptions: list[Subscription] = []
        self._leases: list[Lease] = []
        try:
            self._link = Link(self._context, self.address, client or client_name())
            self.hello = self._run(flows.hello(str(self.address)))
        except BaseException:
            self._context.destroy(linger=0)
            raise

    def __enter__(self) -> Station:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __repr__(self) -> str:
        simulated = " SIMULATED" if self.hello.get("simulated") else ""
        return f"<Station {self.hello.get('name')} at {self.address}{simulated}>"

    def close(self) -> None:
        """Give leases back and close every socket; harmless when closed."""
        for lease in self._leases:
            lease.release()
        for subscription in self._subscriptions:
            subscription.close()
        self._link.close()
        if not self._context.closed:
            self._context.destroy(linger=0)

    def _run(self, flow: Flow[T]) -> T:
        try:
            call = next(flow)
            while True:
                try:
                    answer = self._link.call(call)
                except BaseException as error:  # noqa: BLE001  it goes into the flow, which raises it again
                    call = flow.throw(error)
                else:
                    call = flow.send(answer)
        except StopIteration as stop:
            result: T = stop.value
            return result

    def request(self, verb: str, /, timeout_s: float = 10.0, **params: Any) -> Any:
        """Ask anything by its verb, such as "quarantine.clear"."""
        return self._run(flows.ask(verb, timeout_s, **params))

    def status(self) -> StationState:
        """Return how the station is."""
        state: StationState = self.request("status")
        return state

    def device_settings(self, device: str, timeout_s: float = 30.0) -> list[dict[str, Any]]:
        """Return the own settings of "camera" or "projector", asked now: name, value, unit, limits."""
        return list(self.request("device.get", timeout_s=timeout_s, device=device)["settings"])

    def set_device(self, device: str, name: str, value: Any, timeout_s: float = 60.0) -> list[dict[str, Any]]:
        """Set one of them and return all; raises UsageError for what it does not allow."""
        answer = self.request("device.set", timeout_s=timeout_s, device=device, name=name, value=value)
        return list(answer["settings"])

    def config(self) -> dict[str, Any]:
        """Return the configuration in force, every default written out."""
        return dict(self.request("config"))

    def plugins(self) -> dict[str, Any]:
        """Return the loaded and broken plug-ins and the schemas of their parameters."""
        return dict(self.request("plugins", timeout_s=30.0))

    def patterns(
        self,
        encoder: str,
        params: Mapping[str, Any] | None = None,
        size_px: tuple[int, int] | None = None,
        timeout_s: float = flows.FETCH_TIMEOUT_S,
    ) -> PatternSequence:
        """Return what an encoder would project: every frame's description and its exact picture; nothing is projected.

        `size_px` is the projector's width and height, None the station's own; `plugins()["schemas"]["encoder"]` has
        the encoders' names and parameters.

        Raises
        ------
        NotFound, ConfigurationError
            no such encoder, or parameters that it does not have.
        UsageError
            patterns that nobody could decode, with the reason.
        """
        sequence: PatternSequence = self._run(flows.patterns(encoder, params, size_px, timeout_s))
        return sequence

    def scan(  # noqa: PLR0913  each is a thing of its own that a scan may override
        self,
        pipeline: str | None = None,
        preset: str | None = None,
        *,
        roles: Sequence[str] | None = None,
        encoder_params: Mapping[str, Any] | None = None,
        camera: Mapping[str, Any] | None = None,
        role_camera: Mapping[str, Mapping[str, Any]] | None = None,
        stages: Mapping[str, Mapping[str, Any]] | None = None,
        frame_sets: Mapping[str, str] | None = None,
        truth: bool | None = None,
        process: bool | None = None,
        on_progress: OnProgress | None = None,
        timeout_s: float = JOB_TIMEOUT_S,
    ) -> ScanResult:
        """Take the sets of a pipeline and process them.

        Parameters
        ----------
        pipeline, preset
            names from the station's configuration; its default pipeline where neither is given.
        roles
            the sets to take, all that the pipeline names by default.
        encoder_params, camera, role_camera, stages
            parameters that override the pipeline's: of the patterns, the camera, the camera for one role's set,
            and of stages by name.
        frame_sets
            recorded sets to use for a role instead of taking it, such as yesterday's reference.
        truth
            record what the simulated rig knows as well.
        process
            False: only take and record the sets, such as a reference for later.
        on_progress
            called with each new ScanState.

        Raises
        ------
        LeaseError
            somebody else holds the rig.
        AcquisitionError, QualityError, PluginError
            the scan failed, and why.
        """
        asked = {
            "pipeline": pipeline, "preset": preset, "roles": list(roles) if roles else None,
            "encoder_params": encoder_params, "camera": camera, "role_camera": role_camera,
            "stages": stages, "frame_sets": frame_sets, "truth": truth, "process": process,
        }  # fmt: skip
        return self._submit("scan", asked, timeout_s, on_progress)

    def process(
        self,
        inputs: Mapping[str, Any],
        pipeline: str | None = None,
        *,
        stages: Sequence[Mapping[str, Any]] | None = None,
        params: Mapping[str, Mapping[str, Any]] | None = None,
        on_progress: OnProgress | None = None,
        timeout_s: float = JOB_TIMEOUT_S,
    ) -> ScanResult:
        """Run a pipeline's stages, or the given ones, on recorded or given inputs.

        `inputs` maps each input's name to an id, a list of ids, or a data object.
        """
        asked = {"pipeline": pipeline, "stages": stages, "inputs": dict(inputs), "params": params}
        return self._submit("process", asked, timeout_s, on_progress)

    def register(
        self,
        views: Sequence[Any],
        processor: str | None = None,
        params: Mapping[str, Any] | None = None,
        *,
        merge: bool = True,
        on_progress: OnProgress | None = None,
        timeout_s: float = JOB_TIMEOUT_S,
    ) -> ScanResult:
        """Bring range images (ids or objects) together: one Model, or with `merge=False` one Registration."""
        asked = flows.register_params(views, processor, params, merge)
        return self._submit("process", asked, timeout_s, on_progress)

    def _submit(
        self, verb: str, asked: Mapping[str, Any], timeout_s: float, on_progress: OnProgress | None = None
    ) -> ScanResult:
        return ScanResult(self._run(flows.submit(verb, asked, timeout_s, on_progress)), self.get)

    def wait(
        self, id: str, on_progress: OnProgress | None = None, timeout_s: float = JOB_TIMEOUT_S, until: str = ""
    ) -> ScanResult:
        """Wait for a scan or job that was started before, to its end or that state; it is left alone after that."""
        return ScanResult(self._run(flows.watch(id, timeout_s, on_progress, until=until)), self.get)

    def cancel(self, id: str) -> ScanState:
        """Stop a scan or job."""
        state: ScanState = self.request("cancel", id=id)
        return state

    def get(self, id: str) -> Any:
        """Return a recorded frame set or product."""
        return self._run(flows.fetch(id))

    def list(
        self, kind: str | None = None, scan: str | None = None, limit: int = 100, before: str | None = None
    ) -> list[dict[str, Any]]:
        """Return what is recorded, newest first."""
        return list(self.request("list", timeout_s=30.0, kind=kind, scan=scan, limit=limit, before=before))

    def add(self, content: Any) -> str:
        """Record a data object of yours; it is marked as given. Returns its id."""
        return str(self.request("import", timeout_s=flows.FETCH_TIMEOUT_S, content=content)["id"])

    def export(
        self,
        item: Any,
        format: str,
        path: str | Path,
        params: Mapping[str, Any] | None = None,
        timeout_s: float = JOB_TIMEOUT_S,
    ) -> Path:
        """Write a product (its id, or the object) as a file; the file appears whole or not at all."""
        if item is None:
            raise UsageError("nothing to export; give an id or a product")
        artifact = self._run(flows.export(item, format, params, timeout_s))
        return write_aside(Path(path), artifact.content.data)

    def subscribe(self, *topics: str, latest: bool = False) -> Subscription:
        """Return an iterator of messages whose topic begins with one of `topics` (all, for none).

        With `latest` a slow reader skips to the newest message of each topic.
        """
        subscription = Subscription(
            self._context, self.address, self.address.stream(str(self.hello["stream"])), topics, latest
        )
        self._subscriptions = [s for s in self._subscriptions if not s.closed] + [subscription]
        return subscription

    def lease(self, holder: str | None = None, ttl_s: float = 30.0, scope: str = "rig") -> Lease:
        """Hold the rig: `with station.lease("calibration"): ...`; renewed until released."""
        lease = Lease(self._link, self._context, holder or self._link.core.client, ttl_s, scope)
        self._leases = [lease]
        return lease

    def measure_latency(self, timeout_s: float = JOB_TIMEOUT_S) -> ScanResult:
        """Measure the delay from the display to the camera, and have the station use it."""
        return self._submit("latency", {}, timeout_s)

    def set_scene(self, scene: Mapping[str, Any], timeout_s: float = JOB_TIMEOUT_S) -> None:
        """Put another scene before the simulated rig; a table as `simulation.scene` in the configuration."""
        self.request("simulate.scene", timeout_s=timeout_s, scene=dict(scene))
