"""Registered range images to one triangle mesh.

Owns the order, voxels, distances, closing, triangles, colours, and what is left out as specks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.meshing.blocks import blocks_of, padded
from fringed_plugins.registration.meshing.colouring import coloured
from fringed_plugins.registration.meshing.cubes import joined, march, weld
from fringed_plugins.registration.meshing.distances import SIDE
from fringed_plugins.registration.meshing.facing import outward
from fringed_plugins.registration.meshing.filling import closed, membrane
from fringed_plugins.registration.meshing.triangles import TriangleMesh, compact, fanned
from fringed_plugins.registration.meshing.volume import (
    NOISES,
    Seen,
    Volume,
    fused,
    see,
    surround,
    truncation_of,
    voxel_of,
)
from fringed_plugins.registration.result import Report, between, silent
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray, checked

Array = npt.NDArray[Any]
CHUNK = 500  # blocks between two reports
SPECK = 0.002  # of all vertices: connected parts below are noise between surfaces


def integrate(
    surfaces: Sequence[Surface],
    intensities: Sequence[Array],
    T_model_view: npt.ArrayLike,
    voxel: float | None = None,
    *,
    watertight: bool = False,
    window_px: int | None = None,
    report: Report = silent,
    threads: int = 1,
) -> TriangleMesh:
    """Return one mesh of all views in the model's frame, open where nobody has looked.

    Every view gives voxels near its surface their distance along the normal of its smooth patches; the mean by the
    views' weights is zero on the mesh. `watertight` closes it with a membrane over what is not seen: closed and
    manifold always, and only as right there as a guess can be (`confidence` is zero).

    Parameters
    ----------
    surfaces
        prepared views.
    intensities
        uint8 (height, width) of each whole range image.
    T_model_view
        (n, 4, 4), takes points of each view to the model's frame.
    voxel
        side of a voxel in units of length; the views' median resolution when left out.
    window_px
        side of the windows for patches, odd; the largest of 7, 5, 3 that the surface is smooth over when left out.
    report
        hears (fraction, text) several times a second and may raise to stop the work.
    threads
        for the distances.

    Raises
    ------
    ValueError
        lists of different lengths or none, poses that are not rigid, images of another size, a voxel finer than a
        quarter of the resolution or too fine for memory, no surface.

    References
    ----------
    Curless & Levoy 1996; Lorensen & Cline 1987; Davis, Marschner, Garr & Levoy 2002.
    """
    poses = _required(surfaces, intensities, T_model_view)
    views = _seen(surfaces, poses, window_px, between(report, 0.0, 0.1))
    size = voxel_of(views, voxel)
    truncation = truncation_of(views, size)
    origin = np.mean([seen.T_model_centred[:3, 3] for seen in views], axis=0)
    keys = surround(views, origin, size, truncation, between(report, 0.1, 0.2))
    volume = fused(views, keys, (origin, size, truncation), between(report, 0.2, 0.5), threads)
    if watertight:
        field = membrane(views, origin, size, between(report, 0.5, 0.6), threads)
        volume = closed(volume, field, between(report, 0.6, 0.7))
    vertices, faces, parts = triangles_of(volume, between(report, 0.7, 0.8))
    reach = max(0.5 * size, NOISES * max(seen.patches.surface.noise_mm for seen in views))
    mesh = coloured((vertices, faces), views, intensities, reach, between(report, 0.8, 1.0))
    mesh = _without_specks(mesh, parts, watertight)
    report(1.0, f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} triangles")
    return mesh


def _seen(
    surfaces: Sequence[Surface], poses: Sequence[FloatArray], window_px: int | None, report: Report
) -> list[Seen]:
    """Return the views with weights, and normals to the outside."""
    views: list[Seen] = []
    for surface, T in zip(surfaces, poses, strict=True):
        report(len(views) / len(surfaces), f"patches of the {surface.name}")
        views.append(see(surface, T, window_px))
    return outward(views)


def triangles_of(volume: Volume, report: Report) -> tuple[FloatArray, Array, Array]:
    """Return vertices (n, 3) in the model's frame, faces (m, 3) and parts (n,) of a volume's zero surface.

    Raises
    ------
    ValueError
        there is none.
    """
    coordinates = blocks_of(volume.keys)
    low = coordinates.min(0)
    corner = (coordinates - low) * SIDE
    parts = []
    for start in range(0, len(corner), CHUNK):
        report(start / len(corner), "triangles")
        stop = min(start + CHUNK, len(corner))
        parts.append(weld(*march(padded(volume.values, volume.keys, start, stop), corner[start:stop])))
    whole = joined(parts)
    if not len(whole.faces):
        raise ValueError("no view sees a surface wide enough for a triangle: take a smaller voxel, or fuller masks")
    report(1.0, "triangles")
    taken, faces = fanned(whole.faces, whole.rim)
    vertices = (whole.vertices[taken] + low * SIDE) * volume.voxel + volume.origin
    return vertices, faces, whole.parts[taken]


def _required(
    surfaces: Sequence[Surface], intensities: Sequence[Array], T_model_view: npt.ArrayLike
) -> list[FloatArray]:
    poses = list(np.asarray(T_model_view, np.float64))
    if not surfaces or not len(surfaces) == len(intensities) == len(poses):
        raise ValueError(
            f"{len(surfaces)} views, {len(intensities)} intensities, {len(poses)} poses; expected the same number of "
            "each, at least one"
        )
    for surface, image in zip(surfaces, intensities, strict=True):
        (h, w), (top, left) = surface.valid.shape, surface.corner
        if image.ndim != 2 or image.shape[0] < top + h or image.shape[1] < left + w:
            raise ValueError(
                f"the intensity of the {surface.name} has shape {image.shape}; expected that of its whole range "
                f"image, (height, width) of at least {(top + h, left + w)}"
            )
    return [checked(T, f"T_model_view of the {surface.name}") for surface, T in zip(surfaces, poses, strict=True)]


def _without_specks(mesh: TriangleMesh, part: Array, watertight: bool) -> TriangleMesh:
    """Return the mesh without its small parts; closed ones count by what is seen of them."""
    counts = np.bincount(part, mesh.confidence > 0) if watertight else np.bincount(part).astype(np.float64)
    large = counts >= max(SPECK * counts.sum(), 1.0)
    keep = large[part[mesh.faces[:, 0]]]
    if keep.all():
        return mesh
    used, faces = compact(mesh.faces, keep, len(mesh.vertices))
    return TriangleMesh(
        mesh.vertices[used], faces, mesh.normals[used], mesh.intensity[used], mesh.confidence[used]
    )  # fmt: skip
