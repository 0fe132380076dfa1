"""What differs from head to head: proportions, and where a face is not symmetrical.

Owns the numbers and how they are drawn; the form that they shape is in `head`. The same number gives the same person
everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fringed.data import Array, Float32Array

_LIMIT = 2.0  # standard deviations: beyond them parts would part from each other
_STREAM = 20_000  # so that variant n has nothing in common with seed n
_UNEVEN_MM = (0.5, 1.0)
_WAVES = 6
_SEED_SPREAD = {
    "width": 0.04, "jaw": 0.08, "nose": 0.12, "nose_width": 0.15, "brow": 0.25, "lips": 0.15, "chin": 0.12,
    "ears": 0.12, "eyes": 0.04,
}  # fmt: skip
_SPREAD = {
    "width": 0.035, "jaw": 0.06, "nose": 0.07, "nose_width": 0.10, "brow": 0.15, "lips": 0.13, "chin": 0.10,
    "ears": 0.07, "eyes": 0.035, "skull_height": 0.03, "skull_depth": 0.035, "forehead_mm": 1.6, "face_length_mm": 2.6,
    "jaw_height": 0.06, "cheeks": 0.07, "cheeks_out_mm": 1.6, "cheeks_up_mm": 2.0, "hollow_mm": 1.0,
    "chin_out_mm": 2.0, "nose_length_mm": 2.2, "bridge": 0.13, "bridge_out_mm": 1.5, "hook_mm": 1.1, "brow_out_mm": 1.2,
    "sockets": 0.07, "eyeballs": 0.03, "mouth_width": 0.07, "mouth_out_mm": 1.2, "ears_out": 0.05, "ears_lean": 0.05,
    "ears_up_mm": 2.5, "neck": 0.06, "neck_forward_mm": 3.0,
}  # fmt: skip


@dataclass(frozen=True)
class Proportions:
    """What differs from person to person: factors, 1 the mean; lengths in mm and slopes that are added, 0 the mean."""

    width: float = 1.0
    jaw: float = 1.0
    nose: float = 1.0
    nose_width: float = 1.0
    brow: float = 1.0
    lips: float = 1.0
    chin: float = 1.0
    ears: float = 1.0
    eyes: float = 1.0
    skull_height: float = 1.0
    skull_depth: float = 1.0
    jaw_height: float = 1.0
    cheeks: float = 1.0
    bridge: float = 1.0
    sockets: float = 1.0
    eyeballs: float = 1.0
    mouth_width: float = 1.0
    neck: float = 1.0
    forehead_mm: float = 0.0
    face_length_mm: float = 0.0
    cheeks_out_mm: float = 0.0
    cheeks_up_mm: float = 0.0
    hollow_mm: float = 0.0
    chin_out_mm: float = 0.0
    nose_length_mm: float = 0.0
    bridge_out_mm: float = 0.0
    hook_mm: float = 0.0
    brow_out_mm: float = 0.0
    mouth_out_mm: float = 0.0
    ears_out: float = 0.0
    ears_lean: float = 0.0
    ears_up_mm: float = 0.0
    neck_forward_mm: float = 0.0

    @property
    def mouth_down_mm(self) -> float:
        """How much lower the mouth is: it stays between nose and chin."""
        return 0.5 * self.face_length_mm + 0.4 * self.nose_length_mm


def proportions(seed: int, variant: int) -> Proportions:
    """Return the proportions: 0 is the mean; `seed` varies nine of them, `variant` all, and both add up."""
    mean = Proportions()
    drawn = {}
    if variant:
        normal = np.random.default_rng((_STREAM, variant)).standard_normal(len(_SPREAD))
        deviations = np.clip(normal, -_LIMIT, _LIMIT)
        drawn = {
            name: getattr(mean, name) + sd * float(z) for (name, sd), z in zip(_SPREAD.items(), deviations, strict=True)
        }
    if seed:
        uniform = np.random.default_rng(seed).uniform(-1, 1, len(_SEED_SPREAD))
        for (name, half), u in zip(_SEED_SPREAD.items(), uniform, strict=True):
            drawn[name] = drawn.get(name, 1.0) * float(1.0 + u * half)
    return replace(mean, **drawn)


def uneven_mm(directions: Array, variant: int) -> Float32Array:
    """Return by how much a head stands out along `directions` (..., 3), not the same on both sides.

    A few waves of some 60 degrees over the sphere of directions, so that they are smooth everywhere; 0.5 to 1 mm RMS.
    """
    if not variant:
        return np.zeros(directions.shape[:-1], np.float32)
    rng = np.random.default_rng((_STREAM + 1, variant))
    axes = rng.normal(size=(_WAVES, 3))
    axes *= rng.uniform(3.0, 7.0, (_WAVES, 1)) / np.linalg.norm(axes, axis=1, keepdims=True)
    phases = rng.uniform(0, 2 * np.pi, _WAVES)
    field = np.zeros(directions.shape[:-1], np.float32)
    for axis, phase in zip(axes.astype(np.float32), phases, strict=True):
        field += np.sin(directions @ axis + np.float32(phase))
    return np.asarray(field * np.float32(rng.uniform(*_UNEVEN_MM) / np.sqrt(_WAVES / 2)))
