"""What a scan or a job brought: its state, and its products, fetched when they are first asked for.

Owns the lazy view of a station's products; the fetching itself is given.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Mapping
from typing import Any

from fringed.data import FrameSet, Model, PhaseMap, RangeImage, Registration, Truth
from fringed.messages import ScanState
from fringed_client.protocol.flows import last_product


class Lazy(Mapping[str, Any]):
    """A mapping of names to recorded objects, each fetched once, when it is asked for."""

    def __init__(self, ids: Mapping[str, str], fetch: Callable[[str], Any]) -> None:
        self.ids = dict(ids)
        self._fetch = fetch

    def __getitem__(self, name: str) -> Any:
        return self._fetch(self.ids[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self.ids)

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        return f"Lazy({self.ids})"


class ScanResult:
    """The end of a scan or of a processing job.

    Products come from the station when they are first used, and are kept. They stay available from
    the station by `state.products` ids for ever.
    """

    def __init__(self, state: ScanState, fetch: Callable[[str], Any]) -> None:
        self.state = state
        self._get = fetch
        self._kept: dict[str, Any] = {}

    def fetch(self, item_id: str) -> Any:
        """Return a product or frame set by its id, kept from the first time on."""
        if item_id not in self._kept:
            self._kept[item_id] = self._get(item_id)
        return self._kept[item_id]

    @property
    def id(self) -> str:
        """The scan's identity."""
        return self.state.id

    @property
    def timings_s(self) -> Mapping[str, float]:
        """Seconds of each part, such as "acquire", "phase" and "last_frame_to_range_image"."""
        return self.state.timings_s

    @property
    def frame_sets(self) -> Mapping[str, FrameSet]:
        """The frame sets by role."""
        return Lazy(self.state.frame_sets, self.fetch)

    @property
    def products(self) -> Mapping[str, Any]:
        """Every product by its stage's name."""
        return Lazy({str(p.get("stage") or p["id"]): str(p["id"]) for p in self.state.products}, self.fetch)

    def last(self, kind: str) -> Any:
        """Return the last product of a type by its name.

        Raises
        ------
        NotFound
            the pipeline makes none.
        """
        return self.fetch(last_product(self.state, kind))

    @property
    def range_image(self) -> RangeImage:
        """The last range image."""
        found: RangeImage = self.last("RangeImage")
        return found

    @property
    def phase_map(self) -> PhaseMap:
        """The last phase map."""
        found: PhaseMap = self.last("PhaseMap")
        return found

    @property
    def truth(self) -> Truth:
        """What the simulated rig knows of the object's set; asked for with `truth=True`."""
        found: Truth = self.last("Truth")
        return found

    @property
    def registration(self) -> Registration:
        """The last registration."""
        found: Registration = self.last("Registration")
        return found

    @property
    def model(self) -> Model:
        """The last model."""
        found: Model = self.last("Model")
        return found

    def __repr__(self) -> str:
        kinds = ", ".join(str(p.get("kind")) for p in self.state.products) or "no products"
        return f"<ScanResult {self.state.id} {self.state.pipeline} {self.state.state}: {kinds}>"

    def _repr_html_(self) -> str:
        from fringed_client.html import result_html

        return result_html(self)


class AsyncScanResult:
    """The end of a scan or job; products are awaited: `await result.last("RangeImage")`."""

    def __init__(self, state: ScanState, fetch: Callable[[str], Awaitable[Any]]) -> None:
        self.state = state
        self.id = state.id
        self.timings_s = state.timings_s
        self._get = fetch

    async def last(self, kind: str) -> Any:
        """Return the last product of a type by its name, such as "RangeImage".

        Raises
        ------
        NotFound
            the pipeline makes none.
        """
        return await self._get(last_product(self.state, kind))

    async def frame_set(self, role: str = "object") -> Any:
        """Return the frame set of a role.

        Raises
        ------
        KeyError
            the scan has no such role.
        """
        return await self._get(self.state.frame_sets[role])
