"""Board views of a known rig, by projection of its own: numerically sampled circles, noise, and faults on demand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fringed.boards import Board, board_of, diameters_mm, points_mm
from fringed.data import BoardView, Provenance

CAMERA_PX, PROJECTOR_PX = (1392, 1040), (1024, 768)
CAMERA = (3480.0, 3480.0, 695.5, 519.5, -0.08, 0.03, 0.0004, -0.0003, 0.0)
PROJECTOR = (2262.5, 2262.5, 511.5, 383.5, -0.03, 0.01, -0.0002, 0.0005, 0.0)
BOARD = Board()


def turn(degrees, axis):
    """Return a rotation by the angle about x, y or z (0, 1, 2)."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    a, b = [k for k in range(3) if k != axis]
    matrix = np.eye(3)
    matrix[a, a] = matrix[b, b] = c
    matrix[a, b], matrix[b, a] = (-s, s) if axis != 1 else (s, -s)
    return matrix


def stereo(turned_deg=0.0, moved_mm=0.0):
    """Return T_projector_camera: 280 mm to the right, aimed at 1000 mm; turned and moved as it is asked."""
    R = turn(np.degrees(np.arctan2(280.0, 1000.0)) + turned_deg, 1)
    transform = np.eye(4)
    transform[:3, :3] = R
    transform[:3, 3] = -R @ np.array([280.0 + moved_mm, 0.0, 0.0])
    return transform


def seen(numbers, points):
    """Return the pixels of points (..., 3) through a lens of nine numbers."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = numbers
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    r = x**2 + y**2
    grow = 1 + k1 * r + k2 * r**2 + k3 * r**3
    return np.stack([
        fx * (x * grow + 2 * p1 * x * y + p2 * (r + 2 * x**2)) + cx,
        fy * (y * grow + p1 * (r + 2 * y**2) + 2 * p2 * x * y) + cy,
    ], -1)  # fmt: skip


def pose(tilt_x, tilt_y, spin=0.0, at=(0.0, 0.0, 1000.0)):
    transform = np.eye(4)
    transform[:3, :3] = turn(tilt_x, 0) @ turn(tilt_y, 1) @ turn(spin, 2)
    transform[:3, 3] = at
    return transform


POSES = (
    pose(0, 25), pose(28, 0, at=(-55, -35, 950)), pose(0, -25, at=(55, 40, 950)), pose(-30, 0, 90, at=(60, -20, 1050)),
    pose(22, 22, at=(-60, 45, 1050)), pose(-18, -20, at=(65, 0, 960)), pose(25, -25, 180, at=(0, -45, 1060)),
    pose(-25, 25, 90, at=(-60, 0, 1060)), pose(10, 35, at=(0, 40, 950)), pose(-35, 5, at=(-50, 35, 960)),
    pose(20, 28, at=(50, -40, 1050)), pose(0, -18, 90, at=(25, 20, 1080)),
)  # fmt: skip


def centroid(lens, points, normal, radii):
    """Return the centroid of each circle's picture: the mean of a disc's many samples, weighed by their area in it."""
    first = np.cross(normal, [0.0, 1.0, 0.3])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    ring = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    px = seen(lens, points[:, None] + radii[:, None, None] * ring)
    middle = px.mean(axis=1, keepdims=True)
    off = px - middle
    nxt = np.roll(off, -1, axis=1)
    area = off[..., 0] * nxt[..., 1] - off[..., 1] * nxt[..., 0]
    return middle[:, 0] + ((off + nxt) * area[..., None]).sum(axis=1) / (3 * area.sum(axis=1))[:, None]


def view(place, number, rng, *, board=BOARD, T=None, lenses=(CAMERA, PROJECTOR), noise=(0.01, 0.01), scale=(1.0, 1.0)):
    """Return the view of one pose; `scale` stretches the real board along x and y, unknown to whoever estimates."""
    T = stereo() if T is None else T
    camera, projector = lenses
    flat = points_mm(board) * [*scale, 1.0]
    radii = diameters_mm(board) / 2 * float(np.sqrt(scale[0] * scale[1]))
    points = flat @ place[:3, :3].T + place[:3, 3]
    centres = centroid(camera, points, place[:3, 2], radii) if radii.any() else seen(camera, points)
    # The projector is read where the ellipse's centre is: at the point of the board that is seen there.
    exact = seen(camera, points)
    shift = centres - exact
    step = 1e-3
    along = [
        (seen(projector, _on_board(camera, exact + delta, place, T)) - seen(projector, points @ T[:3, :3].T + T[:3, 3]))
        / step
        for delta in (np.array([step, 0.0]), np.array([0.0, step]))
    ]
    jacobian = np.stack(along, -1)
    lit = seen(projector, points @ T[:3, :3].T + T[:3, 3]) + np.einsum("nij,nj->ni", jacobian, shift)
    count = len(points)
    import msgspec

    return BoardView(
        board=msgspec.to_builtins(board), camera_size_px=CAMERA_PX, projector_size_px=PROJECTOR_PX, found=True,
        index=np.arange(count, dtype=np.int32), camera_px=centres + rng.normal(0, noise[0], (count, 2)),
        camera_sigma_px=np.full(count, max(noise[0], 1e-3)),
        ellipses=np.ones((count, 5)) if radii.any() else np.zeros((0, 5)),
        projector_px=lit + rng.normal(0, noise[1], (count, 2)),
        projector_sigma_px=np.full((count, 2), max(noise[1], 1e-3)), projector_jacobian=jacobian,
        name=f"pose-{number:02d}", provenance=replace(Provenance(), rig="rig", simulated=True),
    )  # fmt: skip


def _on_board(camera, px, place, T):
    """Return the points of the board, in the projector's frame, that the camera sees at px, by iteration."""
    fx, fy, cx, cy = camera[:4]
    wanted = (px - [cx, cy]) / [fx, fy]
    xy = wanted.copy()
    for _ in range(60):
        xy += wanted - (seen((1, 1, 0, 0, *camera[4:]), np.concatenate([xy, np.ones_like(xy[:, :1])], -1)))
    rays = np.concatenate([xy, np.ones_like(xy[:, :1])], -1)
    depth = (place[:3, 2] @ place[:3, 3]) / (rays @ place[:3, 2])
    return (rays * depth[:, None]) @ T[:3, :3].T + T[:3, 3]


def views(rng, places=POSES, **more):
    return [view(place, number, rng, **more) for number, place in enumerate(places, 1)]


def chosen(one, keep):
    """Return a view of some of its points."""
    parts = {
        name: getattr(one, name)[keep]
        for name in ("index", "camera_px", "camera_sigma_px", "ellipses", "projector_px", "projector_sigma_px",
                     "projector_jacobian")
    }  # fmt: skip
    return replace(one, **parts)


def board_for(one):
    return board_of(one.board)
