"""Pairs of views whose motion is known, as levels, and whether a guess of it is right."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from analytic_relief import hand, head, pose, see, truth
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import translation

# a loop that goes on from a guess comes home from within 12 degrees and 5 % of the extent (the basin is 60)
RIGHT_DEG = 12.0
RIGHT_PART = 0.05


@lru_cache(maxsize=8)
def relief_pair(shape="head", apart_deg=60.0, roll_deg=0.0, unit_mm=1.0):
    """Return surfaces of a relief seen from both sides, the model's camera rolled, and the motion between origins."""
    outline = {"head": head, "hand": hand}[shape]
    rolled = np.eye(4)
    rolled[:3, :3] = Rotation.from_euler("z", roll_deg, degrees=True).as_matrix()
    views = (
        see(outline, pose((0, -apart_deg / 2, 0)), noise_mm=0.1, seed=1),
        see(outline, rolled @ pose((0, apart_deg / 2, 0)), noise_mm=0.1, seed=2),
    )
    T = truth(*views)
    T[:3, 3] /= unit_mm
    p, q = (prepare((view.xyz_mm / unit_mm).astype(np.float32)) for view in views)
    return p, q, translation(-p.origin) @ T @ translation(q.origin)


def off(T, T_true, model):
    """Return the rotation error in degrees and the RMS distance error as a part of the model's extent."""
    turn = np.degrees(Rotation.from_matrix(T[:3, :3] @ T_true[:3, :3].T).magnitude())
    points = model.level(2500).points
    apart = points @ (T - T_true)[:3, :3].T + (T - T_true)[:3, 3]
    return turn, float(np.sqrt((apart**2).sum(1).mean())) / model.diagonal_mm


def rank(guesses, T_true, model):
    """Return the place of the first right guess, None where there is none."""
    for place, guess in enumerate(guesses):
        turn, part = off(guess.T_reference_model, T_true, model)
        if turn < RIGHT_DEG and part < RIGHT_PART:
            return place
    return None
