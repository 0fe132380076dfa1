"""Many views, one after the other: each to its nearest neighbour that holds it, then to the model's frame.

Owns the order and the composition of motions. Knows nothing of how a pair is registered but its result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.result import Alignment, Report, silent
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray

Known = Mapping[tuple[int, int], Alignment]


class ChainBrokenError(ValueError):
    """No registered view holds `view`; `partner` came closest, with `alignment`."""

    def __init__(self, view: int, partner: int, alignment: Alignment) -> None:
        super().__init__(f"view {view} does not register to view {partner}: {alignment.reason}")
        self.view, self.partner, self.alignment = view, partner, alignment


@dataclass(frozen=True)
class Link:
    """The registration that brought `view` to `partner`."""

    view: int
    partner: int
    alignment: Alignment


@dataclass(frozen=True)
class Chain:
    """Poses by view of all that are placed; links in the order of their views, failed ones included."""

    T_model_view: dict[int, FloatArray]
    links: tuple[Link, ...]


def chain(
    surfaces: Sequence[Surface],
    options: Options | None = None,
    first: int = 0,
    known: Known | None = None,
    require: bool = True,
    report: Report = silent,
) -> Chain:
    """Return every view's pose in the frame of view `first`.

    Views join outwards from `first`, each to the placed view nearest in sequence that it registers to.
    `known[(reference, model)]` is used instead of registering that pair, if it converged. Without
    `require` a view that registers nowhere is left out, and its best try is among the links.

    Raises
    ------
    ChainBrokenError
        a view registers nowhere and `require` is set.
    ValueError
        `first` is no view.
    """
    if not 0 <= first < len(surfaces):
        raise ValueError(f"reference view {first}; there are {len(surfaces)} views, counted from 0")
    poses: dict[int, FloatArray] = {first: np.eye(4)}
    links = []
    order = sorted((i for i in range(len(surfaces)) if i != first), key=lambda i: (abs(i - first), i))
    for done, view in enumerate(order):

        def tell(part: float, text: str, view: int = view, done: int = done) -> None:
            report((done + part) / len(order), f"view {view + 1}: {text}")

        link = _place(surfaces, view, sorted(poses, key=lambda j: (abs(j - view), j)), (options, known or {}), tell)
        if link.alignment.converged:
            poses[view] = poses[link.partner] @ link.alignment.T_reference_model
        elif require:
            raise ChainBrokenError(link.view, link.partner, link.alignment)
        links.append(link)
    return Chain(poses, tuple(sorted(links, key=lambda link: link.view)))


def _place(
    surfaces: Sequence[Surface], view: int, partners: list[int], how: tuple[Options | None, Known], report: Report
) -> Link:
    options, known = how
    best: Link | None = None
    for partner in partners:
        alignment = known.get((partner, view))
        if alignment is None or not alignment.converged:
            alignment = register(surfaces[partner], surfaces[view], options, report)
        if best is None or (alignment.converged, alignment.overlap) > (
            best.alignment.converged,
            best.alignment.overlap,
        ):
            best = Link(view, partner, alignment)
        if alignment.converged:
            break
    assert best is not None  # the first view is always placed
    return best
