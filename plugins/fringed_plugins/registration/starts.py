"""First guesses of the motion between two views that nobody has told anything about.

Owns principal axes (thesis, section 4.4.1) and turns about the image's axes. Principal axes need views
that show nearly the same; turns cover partial views whose object turned in front of the camera.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from fringed_plugins.registration.transforms import FloatArray, rigid, rotation, translation

TURNS_ABOUT_COLUMNS_DEG = (-60.0, -40.0, -20.0, 20.0, 40.0, 60.0)
TURNS_ABOUT_ROWS_DEG = (-25.0, 25.0)
BEHIND = 0.25  # of the extent


def principal_axes(reference: FloatArray, model: FloatArray) -> list[FloatArray]:
    """Return the four proper motions that bring both clouds' (n, 3) means and principal axes together.

    Eigenvectors have no sign: of the eight combinations four are rotations (thesis: R0 = E_P E_Q^T).

    Raises
    ------
    ValueError
        a cloud without three points.
    """
    if min(len(reference), len(model)) < 3:
        raise ValueError(f"clouds of {len(reference)} and {len(model)} points; principal axes need at least 3")
    mean_p, mean_q = reference.mean(0), model.mean(0)
    axes_p = np.linalg.eigh(np.cov((reference - mean_p).T))[1]
    axes_q = np.linalg.eigh(np.cov((model - mean_q).T))[1]
    guesses = []
    for a, b in product((1.0, -1.0), repeat=2):
        R = axes_p @ np.diag([a, b, 1.0]) @ axes_q.T
        R = R if np.linalg.det(R) > 0 else axes_p @ np.diag([a, b, -1.0]) @ axes_q.T
        guesses.append(rigid(R, mean_p - R @ mean_q))
    return guesses


def turns(reference: FloatArray, model: FloatArray, between_mm: FloatArray) -> list[FloatArray]:
    """Return turns of the model: about its middle, about a point behind it, and brought to the reference's middle.

    Parameters
    ----------
    reference, model
        (n, 3) points, each relative to its own origin.
    between_mm
        (3,) the model's origin minus the reference's, in the camera's frame: where the model stands
        if nothing moved.

    A scanner sees the front only; what turns, turns about its own middle, some way behind.
    """
    middle_p, middle_q = np.median(reference, axis=0), np.median(model, axis=0)
    vectors = [np.array([0.0, np.radians(angle), 0.0]) for angle in TURNS_ABOUT_COLUMNS_DEG]
    vectors += [np.array([np.radians(angle), 0.0, 0.0]) for angle in TURNS_ABOUT_ROWS_DEG]
    span = np.percentile(model, 98, axis=0) - np.percentile(model, 2, axis=0)
    behind = middle_q + np.array([0.0, 0.0, BEHIND * float(np.linalg.norm(span))])
    guesses = [translation(between_mm)]
    for R in map(rotation, vectors):
        guesses.append(rigid(R, between_mm + middle_q - R @ middle_q))
        guesses.append(rigid(R, between_mm + behind - R @ behind))
        guesses.append(rigid(R, middle_p - R @ middle_q))
    return guesses
