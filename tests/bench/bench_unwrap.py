"""Spatial unwrapping of 1392 x 1040 pixels beside scikit-image and NumPy: time, and points at a wrong multiple of 2 pi.

Every map is made from a known surface; wrong are the points whose multiple of 2 pi differs from that of most,
where there is light. All are timed in turns in one run; medians are compared, the best is printed too. Memory
is kept as a worker keeps it.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from stationkit import figure, info

from fringed.workers.memory import keep_freed_pages
from fringed_plugins.unwrap.branch_cut import unwrap_branch_cut
from fringed_plugins.unwrap.least_squares import unwrap_least_squares
from fringed_plugins.unwrap.spatial import unwrap

try:
    from skimage.restoration import unwrap_phase
except ImportError:
    unwrap_phase = None

HEIGHT, WIDTH, ROUNDS, PEER_ROUNDS = 1040, 1392, 15, 3
TIMES_FASTER, LONGEST_S = 8.0, 1.0
Array = np.ndarray[Any, np.dtype[Any]]


class Map(NamedTuple):
    """A phase before wrapping, where it is masked, and where it is lit."""

    name: str
    truth: Array
    masked: Array
    lit: Array

    @property
    def wrapped(self) -> Array:
        return (self.truth - 2 * np.pi * np.rint(self.truth / (2 * np.pi))).astype(np.float32)


def surface() -> tuple[Array, Array]:
    """Return a smooth phase and a mask of two shadows."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    hill = 60 * np.exp(-(((x - 700) / 300) ** 2 + ((y - 520) / 260) ** 2))
    shadow = (np.abs((x - 500) - 0.4 * (y - 500)) < 60) & (np.abs(y - 500) < 330)
    shadow |= (x - 1050) ** 2 + (y - 300) ** 2 < 90**2
    return hill + x / 20 + 6 * np.sin(x / 70) * np.cos(y / 90), shadow


def face() -> tuple[Array, Array, Array]:
    """Return the phase of a face less that of a plane, what is no face, and the shadow beside the nose."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    u, v = (x - 696) / 430, (y - 520) / 480
    head = 45 * np.sqrt(np.clip(1 - u**2 - v**2, 0, None))
    nose = 14 * np.exp(-((u / 0.13) ** 2 + ((v - 0.05) / 0.25) ** 2))
    eyes = -6 * np.exp(-(((np.abs(u) - 0.35) / 0.16) ** 2 + ((v + 0.2) / 0.1) ** 2))
    lips = 2.2 * (np.abs(v - 0.45 - 0.1 * u**2) < 0.05) * (np.abs(u) < 0.3)
    shadow = ((u - 0.2) / 0.09) ** 2 + ((v - 0.12) / 0.2) ** 2 < 1
    return head + nose + eyes + lips, u**2 + v**2 > 0.97, shadow


def maps() -> Iterator[Map]:
    """Yield the maps that the figures hold for, then the hopeless one."""
    rng = np.random.default_rng(0)
    whole, shadow = surface()
    nowhere = np.zeros(whole.shape, bool)
    noisy = whole + rng.normal(0, 0.5, whole.shape)
    dark = rng.uniform(-np.pi, np.pi, whole.shape)
    yield Map("smooth", whole, nowhere, ~nowhere)
    yield Map("shadow, masked", whole, shadow, ~shadow)
    yield Map("shadow, not masked", np.where(shadow, dark, whole), nowhere, ~shadow)
    yield Map("noise 0.5 rad", noisy, nowhere, ~nowhere)
    yield Map("noise 0.5 rad, shadow masked", noisy, shadow, ~shadow)
    yield Map("noise 0.5 rad, shadow not masked", np.where(shadow, dark, noisy), nowhere, ~shadow)
    relief, outside, beside = face()
    lit = ~(outside | beside)
    relief = np.where(beside, dark, relief)
    yield Map("face, noise 0.1 rad", relief + rng.normal(0, 0.1, whole.shape), outside, lit)
    yield Map("face, noise 0.4 rad", relief + rng.normal(0, 0.4, whole.shape), outside, lit)
    yield Map("27 thousand residues (noise 0.8 rad)", whole + rng.normal(0, 0.8, whole.shape), nowhere, ~nowhere)


def wrong(phase: Array, one: Map) -> int:
    """Count the lit, known points whose multiple of 2 pi is not that of most."""
    turns = np.rint((np.asarray(phase, float) - one.truth) / (2 * np.pi))[one.lit & np.isfinite(phase)].astype(int)
    return int(turns.size - np.bincount(turns - turns.min()).max())


def timed(job: Callable[[], Any], taken: list[float]) -> Any:
    start = time.perf_counter()
    result = job()
    taken.append(1e3 * (time.perf_counter() - start))
    return result


def told(taken: list[float], off: int) -> str:
    return f"median {statistics.median(taken):.0f} ms, best {min(taken):.0f} ms, {off} wrong"


def compare(one: Map) -> None:
    """Time ours and the peers in turns on one map and print the figures."""
    full = one.wrapped
    phase = np.where(one.masked, np.float32(np.nan), full)
    peer_input = np.ma.masked_array(full, mask=one.masked) if one.masked.any() else full
    ours: list[float] = []
    peer: list[float] = []
    plain: list[float] = []
    for turn in range(ROUNDS):
        got = timed(lambda: unwrap(phase), ours).phase_rad
        if turn < PEER_ROUNDS:
            rows = timed(lambda: np.unwrap(np.unwrap(full, axis=1), axis=0), plain)
            if unwrap_phase is not None:
                theirs = timed(lambda: unwrap_phase(peer_input, rng=0), peer)
    off = wrong(got, one)
    figure(f"{one.name}: time", told(ours, off), "under 1 s", max(ours) < 1e3 * LONGEST_S)
    info(f"{one.name}: np.unwrap along rows, then columns", told(plain, wrong(rows, one)))
    if unwrap_phase is None:
        info(f"{one.name}: scikit-image", "not installed: pip install scikit-image")
        return
    their_off = wrong(np.ma.filled(theirs, np.nan), one)
    info(f"{one.name}: scikit-image", told(peer, their_off))
    ratio = statistics.median(peer) / statistics.median(ours)
    figure(f"{one.name}: times faster than scikit-image", f"{ratio:.1f}", "at least 8", ratio >= TIMES_FASTER)
    figure(f"{one.name}: wrong points", f"{off}, scikit-image {their_off}", "no more than it", off <= their_off)


def others(one: Map) -> None:
    """Time the two other methods of the family."""
    phase = np.where(one.masked, np.float32(np.nan), one.wrapped)
    for name, method in (("branch-cut", unwrap_branch_cut), ("least-squares", unwrap_least_squares)):
        taken: list[float] = []
        for _ in range(PEER_ROUNDS):
            result = timed(lambda method=method: method(phase), taken)  # type: ignore[misc]
        info(f"{one.name}: {name}", told(taken, wrong(result.phase_rad, one)))


def main() -> None:
    keep_freed_pages(400)
    for method in (unwrap, unwrap_branch_cut, unwrap_least_squares):  # compile
        for wild in (0.1, 3.0):
            method(np.sin(wild * np.arange(900, dtype=np.float32) ** 2).reshape(30, 30) * np.float32(3))
    for one in maps():
        compare(one)
        others(one)
    noise = np.random.default_rng(1).uniform(-np.pi, np.pi, (HEIGHT, WIDTH)).astype(np.float32)
    taken: list[float] = []
    for _ in range(PEER_ROUNDS):
        timed(lambda: unwrap(noise), taken)
    figure("nothing but noise: longest time", f"{max(taken):.0f} ms", "under 1 s", max(taken) < 1e3 * LONGEST_S)
    try:
        import cv2

        known = hasattr(cv2, "phase_unwrapping")
    except ImportError:
        known = False
    info("OpenCV's phase_unwrapping", "there, not run" if known else "not in this OpenCV (contrib only): not compared")


if __name__ == "__main__":
    main()
