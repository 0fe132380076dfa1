"""Fewer iterations of the same method: Besl and McKay's extrapolation, Anderson's mixing.

Owns the policies of acceleration. Each is asked after an iteration where to go on from; the loop goes back to the
plain iterate where the error rose.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.transforms import FloatArray, rigid


class Memory(Protocol):
    """An acceleration under way."""

    def __call__(self, before: FloatArray, after: FloatArray, error: float) -> FloatArray:
        """Return where to go on from, after the plain iteration took `before` to `after` (4, 4)."""
        ...

    def forget(self) -> None:
        """Start again: what was proposed made it worse."""
        ...


class Acceleration(Protocol):
    """Speed up."""

    def begin(self, extent: float) -> Memory:
        """Return a memory for points of this extent about the origin."""
        ...


@dataclass(frozen=True)
class Plain:
    """No acceleration."""

    def begin(self, extent: float) -> Memory:
        """Return what goes on from the iterate itself."""
        return _Plain()


class _Plain:
    def __call__(self, before: FloatArray, after: FloatArray, error: float) -> FloatArray:
        return after

    def forget(self) -> None:
        pass


@dataclass(frozen=True)
class Extrapolation:
    """A longer step where the last ones went the same way (Besl & McKay 1992, section IV-C).

    While three registration vectors turn by less than `degrees`, a line or a parabola through their errors says
    how far; at most `most` times the last step.
    """

    degrees: float = 10.0
    most: float = 25.0

    def begin(self, extent: float) -> Memory:
        """Return an empty memory."""
        return _Extrapolation(self, extent)


@dataclass
class _Extrapolation:
    policy: Extrapolation
    extent: float
    vectors: list[FloatArray] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)

    def forget(self) -> None:
        self.vectors.clear()
        self.errors.clear()

    def __call__(self, before: FloatArray, after: FloatArray, error: float) -> FloatArray:
        if not self.vectors:
            self.vectors.append(_vector(before, self.extent))
        self.vectors, self.errors = [*self.vectors[-3:], _vector(after, self.extent)], [*self.errors[-2:], error]
        if len(self.vectors) < 4 or len(self.errors) < 3:
            return after
        steps = np.diff(np.array(self.vectors), axis=0)
        length = np.linalg.norm(steps, axis=1)
        if not (length > 0).all():
            return after
        turn = [np.dot(a, b) / (np.linalg.norm(a) * np.linalg.norm(b)) for a, b in pairwise(steps)]
        if min(turn) < np.cos(np.radians(self.policy.degrees)):
            return after
        v = np.array([-(length[-1] + length[-2]), -length[-1], 0.0])  # arc lengths of the last three
        longest = self.policy.most * length[-1]
        line, parabola = np.polyfit(v, self.errors, 1), np.polyfit(v, self.errors, 2)
        to_line = -line[1] / line[0] if line[0] < 0 else -1.0
        to_parabola = -parabola[1] / (2 * parabola[0]) if parabola[0] > 0 else -1.0
        reach = [x for x in (to_line, to_parabola) if x > 0]
        if not reach:
            return after
        return _pose(self.vectors[-1] + min(*reach, longest) * steps[-1] / length[-1], self.extent)


@dataclass(frozen=True)
class Anderson:
    """Anderson's mixing of the last iterates, as in fast and robust ICP (Zhang, Yao, Deng 2021)."""

    depth: int = 5

    def begin(self, extent: float) -> Memory:
        """Return an empty memory."""
        return _Anderson(self.depth, extent)


@dataclass
class _Anderson:
    depth: int
    extent: float
    images: list[FloatArray] = field(default_factory=list)
    residuals: list[FloatArray] = field(default_factory=list)

    def forget(self) -> None:
        self.images.clear()
        self.residuals.clear()

    def __call__(self, before: FloatArray, after: FloatArray, error: float) -> FloatArray:
        image = _vector(after, self.extent)
        self.images.append(image)
        self.residuals.append(image - _vector(before, self.extent))
        del self.images[: -self.depth - 1], self.residuals[: -self.depth - 1]
        if len(self.images) < 2:
            return after
        F, G = np.diff(np.array(self.residuals), axis=0).T, np.diff(np.array(self.images), axis=0).T
        mix = np.linalg.lstsq(F, self.residuals[-1], rcond=1e-8)[0]
        return _pose(image - G @ mix, self.extent)


def _vector(T: FloatArray, extent: float) -> FloatArray:
    """Return (rotation vector, translation / extent) of a rigid transform."""
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3] / extent])


def _pose(vector: FloatArray, extent: float) -> FloatArray:
    return rigid(Rotation.from_rotvec(vector[:3]).as_matrix(), vector[3:] * extent)
