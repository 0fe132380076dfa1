"""Range scans of the Stanford repository: organised `range_grid` PLY files in ASCII, and their published poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

BUNNY = Path(__file__).resolve().parents[1].parent / "shared" / "data" / "stanford-bunny"


def read_range_grid(path):
    """Return points (rows, columns, 3) float64, NaN where the grid is empty."""
    lines = iter(Path(path).read_text(encoding="latin-1").splitlines())
    counts, size = {}, {}
    for line in lines:
        words = line.split()
        if words[:1] == ["obj_info"] and words[1] in {"num_cols", "num_rows"}:
            size[words[1]] = int(words[2])
        elif words[:1] == ["element"]:
            counts[words[1]] = int(words[2])
        elif words == ["end_header"]:
            break
    points = np.array([next(lines).split()[:3] for _ in range(counts["vertex"])], np.float64)
    grid = np.full((counts["range_grid"], 3), np.nan)
    for place in range(counts["range_grid"]):
        words = next(lines).split()
        if words[0] != "0":
            grid[place] = points[int(words[1])]
    return grid.reshape(size["num_rows"], size["num_cols"], 3)


def published_poses(path):
    """Return {file name: T_world_scan (4, 4)}: world = R(q)^T p + t, q as x y z w."""
    poses = {}
    for line in Path(path).read_text().splitlines():
        words = line.split()
        if words[:1] == ["bmesh"]:
            T = np.eye(4)
            T[:3, :3] = Rotation.from_quat([float(word) for word in words[5:9]]).as_matrix().T
            T[:3, 3] = [float(word) for word in words[2:5]]
            poses[words[1]] = T
    return poses


def overlapping(grids, poses, least=1 / 3, near=0.001):
    """Return the pairs (reference, model, overlap) of which `least` of the model lies on the reference."""
    from scipy.spatial import cKDTree

    world = {
        name: points[np.isfinite(points[..., 0])] @ poses[name][:3, :3].T + poses[name][:3, 3]
        for name, points in grids.items()
    }
    found = []
    for a, cloud in world.items():
        tree = cKDTree(cloud)
        for b, other in world.items():
            share = float((tree.query(other[::7])[0] < near).mean()) if a != b else 0.0
            if share > least:
                found.append((a, b, share))
    return found
