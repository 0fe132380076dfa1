"""Kernels that follow rays: from each camera pixel to the scene, and from there to the projector.

Owns ray intersection, visibility, shadow and shading; knows nothing of poses, patterns or the sensor. All in the
camera's frame, millimetres. Visibility is exact: every triangle whose perspective bounding box holds the ray's cell
is tested (a light buffer, Haines & Greenberg 1986), for the camera and for the projector alike.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed.simulation.lens_kernels import pixel_ray, ray_pixel

NOTHING, PLANE, SPHERE = -1, -2, -3  # spheres count downwards from there
VISIBLE, LIT, OBJECT = 1, 2, 4  # bits of Buffers.flags
_EDGE = 1e-9  # barycentric tolerance: a ray through a shared edge hits one of the two triangles
_NEAR = 1e-6
_SELF = 2e-6  # of the distance to the projector: a point does not shadow itself
_GLOSS = 40.0


class Solid(NamedTuple):
    """Everything that stands in front of the camera."""

    triangles: Any  # (n, 3, 3) corner, edge, edge
    faces: Any  # (n, 3) int32
    normals: Any  # (m, 3) of vertices
    albedo: Any  # (m,) of vertices
    spheres: Any  # (k, 5) centre, radius, albedo
    plane: Any  # (3,) its z (0: none), albedo, 1 where it is the measured object


class View(NamedTuple):
    """Both lenses, packed, and how light falls off.

    `optics`: specular, ambient, loss at the camera's and the projector's corners, distance where both axes meet,
    levels of blur per millimetre off the focus, highest level, factor that makes a white plane there 1.
    """

    camera: Any  # (11,)
    projector: Any  # (11,)
    T_projector_camera: Any  # (4, 4)
    centre: Any  # (3,) the projector
    optics: Any  # (8,)


class Buffers(NamedTuple):
    """What is known of each pixel, (height, width) float32; see geometry.Geometry."""

    column: Any
    row: Any
    level: Any
    depth: Any
    gain: Any
    base: Any
    flags: Any  # uint8


@njit(cache=True, nogil=True)
def _mesh_hit(
    triangles: Any, grid: Any, xy: tuple[float, float], ray: tuple[Any, Any], end: float, first: bool
) -> tuple[float, int, float, float]:
    """Return the nearest hit before `end` (or just any): its parameter, triangle and barycentric coordinates."""
    best, which, b1, b2 = end, NOTHING, 0.0, 0.0
    cx, cy = (xy[0] - grid.bounds[0]) * grid.bounds[2], (xy[1] - grid.bounds[1]) * grid.bounds[3]
    if not (0.0 <= cx < grid.nx and 0.0 <= cy < grid.ny):
        return best, which, b1, b2
    cell = int(cy) * grid.nx + int(cx)
    o, d = ray
    o0, o1, o2, d0, d1, d2 = o[0], o[1], o[2], d[0], d[1], d[2]
    for k in range(grid.start[cell], grid.start[cell + 1]):
        i = grid.items[k]
        ax, ay, az = triangles[i, 1, 0], triangles[i, 1, 1], triangles[i, 1, 2]
        bx, by, bz = triangles[i, 2, 0], triangles[i, 2, 1], triangles[i, 2, 2]
        px, py, pz = d1 * bz - d2 * by, d2 * bx - d0 * bz, d0 * by - d1 * bx
        det = ax * px + ay * py + az * pz
        size = abs(det)
        if size < 1e-14:
            continue
        sign, slack = (1.0 if det > 0.0 else -1.0), _EDGE * size
        sx, sy, sz = o0 - triangles[i, 0, 0], o1 - triangles[i, 0, 1], o2 - triangles[i, 0, 2]
        u = (sx * px + sy * py + sz * pz) * sign  # barycentric times |det|: few candidates are worth a division
        if u < -slack or u > size + slack:
            continue
        qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
        w = (d0 * qx + d1 * qy + d2 * qz) * sign
        if w < -slack or u + w > size + slack:
            continue
        t = (bx * qx + by * qy + bz * qz) / det
        if _NEAR < t < best:
            best, which, b1, b2 = t, i, u / size, w / size
            if first:
                break
    return best, which, b1, b2


@njit(cache=True, nogil=True, inline="always")
def _sphere_hit(spheres: Any, o: Any, d: Any) -> tuple[float, int]:
    """Return the parameter of the first intersection, or infinity, and the sphere's number."""
    nearest, which = np.inf, NOTHING
    for i in range(spheres.shape[0]):
        x, y, z = o[0] - spheres[i, 0], o[1] - spheres[i, 1], o[2] - spheres[i, 2]
        a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        b = x * d[0] + y * d[1] + z * d[2]
        c = x * x + y * y + z * z - spheres[i, 3] * spheres[i, 3]
        root = b * b - a * c
        if root < 0.0:
            continue
        t = (-b - np.sqrt(root)) / a
        if _NEAR < t < nearest:
            nearest, which = t, SPHERE - i
    return nearest, which


@njit(cache=True, nogil=True)
def _surface(
    solid: Any, which: int, p: Any, b: tuple[float, float], normal: Any, flat: Any
) -> float:  # fmt: skip
    """Write the shading and the true normal, both towards the camera; return the albedo."""
    if which == PLANE:
        normal[:] = (0.0, 0.0, -1.0)
        flat[:] = normal
        return float(solid.plane[1])
    if which <= SPHERE:
        sphere = solid.spheres[SPHERE - which]
        for k in range(3):
            normal[k] = (p[k] - sphere[k]) / sphere[3]
        flat[:] = normal
        return float(sphere[4])
    v, normals = solid.triangles, solid.normals
    f0, f1, f2 = solid.faces[which, 0], solid.faces[which, 1], solid.faces[which, 2]
    flat[0] = v[which, 1, 1] * v[which, 2, 2] - v[which, 1, 2] * v[which, 2, 1]
    flat[1] = v[which, 1, 2] * v[which, 2, 0] - v[which, 1, 0] * v[which, 2, 2]
    flat[2] = v[which, 1, 0] * v[which, 2, 1] - v[which, 1, 1] * v[which, 2, 0]
    b1, b2 = b
    b0 = 1.0 - b1 - b2
    length, along, towards = 0.0, 0.0, 0.0
    flat_length = np.sqrt(flat[0] * flat[0] + flat[1] * flat[1] + flat[2] * flat[2])
    for k in range(3):
        flat[k] /= flat_length
        normal[k] = b0 * normals[f0, k] + b1 * normals[f1, k] + b2 * normals[f2, k]
        length += normal[k] * normal[k]
        along += normal[k] * flat[k]
        towards += flat[k] * p[k]
    length = np.sqrt(length)
    for k in range(3):
        # A crease, or an edge: what is interpolated across it is no normal of either side.
        normal[k] = flat[k] if abs(along) < 0.7 * length else normal[k] / length * np.sign(along)
        if towards > 0.0:
            normal[k] = -normal[k]
            flat[k] = -flat[k]
    return float(b0 * solid.albedo[f0] + b1 * solid.albedo[f1] + b2 * solid.albedo[f2])


@njit(cache=True, nogil=True, inline="always")
def _light(view: Any, p: Any, normal: Any, pixel: tuple[float, float]) -> float:
    """Return the projector's light that reaches the camera per albedo: cosine, distance, gloss and its corners."""
    lx, ly, lz = view.centre[0] - p[0], view.centre[1] - p[1], view.centre[2] - p[2]
    far = lx * lx + ly * ly + lz * lz
    near = 1.0 / np.sqrt(far)
    cosine = (normal[0] * lx + normal[1] * ly + normal[2] * lz) * near
    given = 0.0
    if cosine > 0.0:
        lens, optics = view.projector, view.optics
        x, y = 2.0 * (pixel[0] - lens[2]) / lens[9], 2.0 * (pixel[1] - lens[3]) / lens[10]
        given = cosine
        if optics[0] > 0.0:
            eye = 1.0 / np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
            hx, hy, hz = lx * near - p[0] * eye, ly * near - p[1] * eye, lz * near - p[2] * eye
            half = (normal[0] * hx + normal[1] * hy + normal[2] * hz) / np.sqrt(hx * hx + hy * hy + hz * hz)
            given += optics[0] * max(half, 0.0) ** _GLOSS
        given *= (1.0 - optics[3] * (x * x + y * y) / 2.0) * optics[7] / far
    return float(given)


@njit(cache=True, nogil=True, inline="always")
def _project(view: Any, p: Any, q: Any) -> tuple[float, float]:
    T = view.T_projector_camera
    for k in range(3):
        q[k] = T[k, 0] * p[0] + T[k, 1] * p[1] + T[k, 2] * p[2] + T[k, 3]
    if q[2] <= _NEAR:
        return np.nan, np.nan
    return ray_pixel(q[0] / q[2], q[1] / q[2], view.projector)


@njit(cache=True, nogil=True, inline="always")
def _shadowed(solid: Any, grid: Any, view: Any, p: Any, q: Any, d: Any) -> bool:
    for k in range(3):
        d[k] = p[k] - view.centre[k]
    end = 1.0 - _SELF
    if _sphere_hit(solid.spheres, view.centre, d)[0] < end:
        return True
    xy = (q[0] / q[2], q[1] / q[2])
    return bool(_mesh_hit(solid.triangles, grid, xy, (view.centre, d), end, True)[1] != NOTHING)


@njit(cache=True, nogil=True, inline="always")
def _nearest(solid: Any, grid: Any, o: Any, d: Any) -> tuple[float, int, float, float]:
    t, which, b1, b2 = _mesh_hit(solid.triangles, grid, (d[0], d[1]), (o, d), np.inf, False)
    ball, number = _sphere_hit(solid.spheres, o, d)
    if ball < t:
        t, which = ball, number
    if 0.0 < solid.plane[0] < t:
        t, which = solid.plane[0], PLANE
    return t, which, b1, b2


@njit(cache=True, nogil=True)
def trace_rows(rows: tuple[int, int], solid: Any, grids: tuple[Any, Any], view: Any, out: Any) -> None:
    """Fill `rows`, first to end, of every buffer."""
    o, d, p, q = np.zeros(3), np.ones(3), np.empty(3), np.empty(3)
    normal, flat = np.empty(3), np.empty(3)
    camera, projector, optics = view.camera, view.projector, view.optics
    for r in range(rows[0], rows[1]):
        yd = (r - camera[3]) / camera[1]
        ahead, below, ahead_before, below_before = 0.0, 0.0, 0.0, 0.0
        for c in range(out.flags.shape[1]):
            xd = (c - camera[2]) / camera[0]
            # The neighbours' distortion, continued: it needs one iteration or two from there.
            guess = (xd + 2.0 * ahead - ahead_before, yd + 2.0 * below - below_before)
            d[0], d[1] = pixel_ray(xd, yd, guess, camera)
            d[2] = 1.0
            ahead_before, below_before, ahead, below = ahead, below, d[0] - xd, d[1] - yd
            t, which, b1, b2 = _nearest(solid, grids[0], o, d)
            out.gain[r, c], out.base[r, c], out.level[r, c], out.flags[r, c] = 0.0, 0.0, 0.0, 0
            out.column[r, c], out.row[r, c], out.depth[r, c] = np.nan, np.nan, np.nan
            if which == NOTHING:
                continue
            for k in range(3):
                p[k] = t * d[k]
            albedo = _surface(solid, which, p, (b1, b2), normal, flat)
            x, y = 2.0 * (c - camera[2]) / camera[9], 2.0 * (r - camera[3]) / camera[10]
            seen = albedo * (1.0 - optics[2] * (x * x + y * y) / 2.0)
            flags = VISIBLE
            if which != PLANE or solid.plane[2] > 0.0:
                flags |= OBJECT
            u, v = _project(view, p, q)
            facing = 0.0
            for k in range(3):
                facing += flat[k] * (view.centre[k] - p[k])
            inside = 0.0 <= u <= projector[9] - 1.0 and 0.0 <= v <= projector[10] - 1.0
            if inside and facing > 0.0 and not _shadowed(solid, grids[1], view, p, q, d):
                gain = seen * _light(view, p, normal, (u, v))
                if gain > 0.0:
                    flags |= LIT
                    out.gain[r, c] = gain
            out.level[r, c] = min(abs(q[2] - optics[4]) * optics[5], optics[6])
            out.base[r, c] = seen * optics[1]
            out.column[r, c], out.row[r, c], out.depth[r, c], out.flags[r, c] = u, v, t, flags
