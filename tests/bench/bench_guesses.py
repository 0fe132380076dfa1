"""Methods of guessing beside each other: how often a tournament of their guesses ends where a fine stage can go on.

Pairs of views, nothing given: simulated scans of heads 60 degrees apart, as they are and with the model turned at
random besides, and the unit tests' reliefs, 30 to 60 degrees apart and rolled. Methods guess on the levels that a
registration gives them; the same tournament (`coarse.tournament`, its default rounds) refines their guesses. Right is
within 10 degrees and 10 mm RMS over the model's points. `starting.ORDER` says which `register` tries.
Times are CPU seconds, which other work on the machine hardly changes.

    python tests/bench/bench_guesses.py [--folder FOLDER] [--count 6] [--resolution 0.5] [--only METHOD,METHOD]
"""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "registration"))
sys.path.insert(0, str(Path(__file__).parent))  # run as a module, it has no folder of its own

from bench_heads import prepared
from guessed import relief_pair
from heads import Array, HeadView, arguments, heads, say
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.coarse import tournament
from fringed_plugins.registration.guesses import GUESSERS, Guesser
from fringed_plugins.registration.result import silent
from fringed_plugins.registration.starting import GUESS_POINTS
from fringed_plugins.registration.starts import principal_axes, turns
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import rigid, translation

THREADS, COUNT = 1, 6
RIGHT_DEG, RIGHT_MM = 10.0, 10.0
RELIEFS = [(shape, apart, roll) for shape in ("head", "hand") for apart in (30, 45, 60) for roll in (0, 135)]

Method = Callable[[Surface, Surface, int], list[Array]]


class Pair(NamedTuple):
    """Two surfaces of a `kind`, and the motion between their origins."""

    kind: str
    reference: Surface
    model: Surface
    T_true: Array


class Outcome(NamedTuple):
    """What one method made of one pair: right first, right among those that are left, CPU seconds of both parts."""

    kind: str
    right: bool
    left: bool
    count: int
    guess_s: float
    tournament_s: float


def of_heads(kind: str, reference: HeadView, model: HeadView) -> Pair:
    p, q = prepared(reference, "reference"), prepared(model, "model")
    T = reference.T_camera_object @ np.linalg.inv(model.T_camera_object)
    return Pair(kind, p, q, translation(-p.origin) @ T @ translation(q.origin))


def anyhow(view: HeadView, seed: int) -> HeadView:
    """Return the view turned at random about its middle: as if its scanner had stood on its head, or lain aside."""
    R = Rotation.random(random_state=seed).as_matrix()
    middle = view.xyz_mm[view.rejected == 0].mean(0, dtype=np.float64)
    T = rigid(R, middle - R @ middle)
    xyz_mm = (view.xyz_mm @ R.T + T[:3, 3]).astype(np.float32)
    return view._replace(xyz_mm=xyz_mm, T_camera_object=T @ view.T_camera_object)


def pairs(asked: Namespace) -> Iterator[Pair]:
    views = heads(asked.folder, asked.count, asked.resolution)
    for front, *sides in zip(views[::3], views[1::3], views[2::3], strict=True):
        for seed, side in enumerate(sides, 2 * front.variant):
            yield of_heads("heads", front, side)
            yield of_heads("turned", front, anyhow(side, seed))
    for shape, apart, roll in RELIEFS:
        yield Pair("reliefs", *relief_pair(shape, float(apart), float(roll), 1.0))


def turned(reference: Surface, model: Surface, seed: int) -> list[Array]:
    p, q = reference.level(GUESS_POINTS).points, model.level(GUESS_POINTS).points
    return turns(p, q, model.origin - reference.origin) + principal_axes(p, q)


def guessed(method: Guesser) -> Method:
    def made(reference: Surface, model: Surface, seed: int) -> list[Array]:
        rng = np.random.default_rng(seed)
        found = method(reference.level(GUESS_POINTS), model.level(GUESS_POINTS), None, rng, THREADS)
        return [guess.T_reference_model for guess in found]

    return made


METHODS: dict[str, Method] = {
    "turns": turned,
    **{name: guessed(method) for name, method in GUESSERS.items()},
}


def right(T: Array, pair: Pair) -> bool:
    turn = Rotation.from_matrix(T[:3, :3] @ pair.T_true[:3, :3].T).magnitude()
    off = pair.model.level(GUESS_POINTS).points @ (T - pair.T_true)[:3, :3].T + (T - pair.T_true)[:3, 3]
    return bool(np.degrees(turn) < RIGHT_DEG and np.sqrt((off**2).sum(1).mean()) < RIGHT_MM)


def tried(method: Method, pair: Pair, seed: int) -> Outcome:
    """Guess and hold the tournament; levels are there before, since all methods need them."""
    began = time.process_time()
    found = method(pair.reference, pair.model, seed)
    guess_s = time.process_time() - began
    if not found:
        return Outcome(pair.kind, False, False, 0, guess_s, 0.0)
    began = time.process_time()
    left = tournament(pair.reference, pair.model, found, silent, THREADS)
    verdicts = [right(one.T_reference_model, pair) for one in left]
    return Outcome(pair.kind, verdicts[0], any(verdicts), len(found), guess_s, time.process_time() - began)


def show(outcomes: dict[str, list[Outcome]]) -> None:
    """Print rates of each kind of pair, and the times that a guess takes."""
    kinds = list(dict.fromkeys(one.kind for ones in outcomes.values() for one in ones))
    columns = "".join(f"{kind:>10} {'of left':>8}" for kind in kinds)
    print(f"INFO  right first, and among those that the tournament leaves ({RIGHT_DEG:g} deg, {RIGHT_MM:g} mm)")
    print(f"INFO  {'method':18}{columns} {'guesses':>8} {'median s':>9} {'worst s':>8} {'tournament s':>13}")
    for name, ones in outcomes.items():
        rates = ""
        for kind in kinds:
            some = [one for one in ones if one.kind == kind]
            rates += (
                f"{sum(one.right for one in some):>7}/{len(some):<2} {sum(one.left for one in some):>5}/{len(some):<2}"
            )
        count, seconds, race = (np.array([one[at] for one in ones]) for at in (3, 4, 5))
        print(
            f"INFO  {name:18}{rates} {np.median(count):>8.0f} {np.median(seconds):>9.2f} {seconds.max():>8.2f} "
            f"{np.median(race):>13.2f}",
            flush=True,
        )


def main() -> int:
    parser = arguments(__doc__)
    parser.set_defaults(count=COUNT)
    parser.add_argument("--only", default=",".join(METHODS), help="methods, with commas between")
    asked = parser.parse_args()
    names = asked.only.split(",")
    if unknown := set(names) - set(METHODS):
        parser.error(f"no method {', '.join(sorted(unknown))}; there are {', '.join(METHODS)}")
    outcomes: dict[str, list[Outcome]] = {name: [] for name in names}
    for number, pair in enumerate(pairs(asked)):
        for surface in (pair.reference, pair.model):
            _ = surface.level(GUESS_POINTS).tree
        for name in names:
            if not number:
                tried(METHODS[name], pair, number)  # compiles, and makes the tournament's levels
            outcomes[name].append(tried(METHODS[name], pair, number))
        say(f"{number + 1} pairs guessed")
    show(outcomes)
    return 0


if __name__ == "__main__":
    sys.exit(main())
