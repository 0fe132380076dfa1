"""Registration by the libraries that others use, each with its best settings; raw arrays in, T_reference_model out.

Gates and leaf sizes are lengths there: they are given as parts of the clouds' extent, which is what their users tune.
A peer that is not installed is not in `PEERS`.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import sys

import numpy as np

THREADS = 2


@contextlib.contextmanager
def quiet():
    """Send what libraries print themselves nowhere."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _extent(cloud):
    return float(np.linalg.norm(np.ptp(cloud, axis=0)))


def small_gicp_two_calls(reference, model, start=None):
    """GICP, coarse to fine: what was best for it over leaves and gates."""
    import small_gicp

    size = _extent(reference)
    T = np.eye(4) if start is None else start
    for leaf, reach in ((size / 70, size / 9), (size / 230, size / 70)):
        T = small_gicp.align(
            reference, model, init_T_target_source=T, num_threads=THREADS, registration_type="GICP",
            downsampling_resolution=leaf, max_correspondence_distance=reach,
        ).T_target_source  # fmt: skip
    return T


def small_gicp_vgicp(reference, model, start=None):
    """Voxelised GICP."""
    import small_gicp

    size = _extent(reference)
    T = np.eye(4) if start is None else start
    return small_gicp.align(
        reference, model, init_T_target_source=T, num_threads=THREADS, registration_type="VGICP",
        downsampling_resolution=size / 230, voxel_resolution=size / 70,
    ).T_target_source  # fmt: skip


def open3d_multi_scale(reference, model, start=None):
    """Open3D's tensor multi-scale ICP, point to plane."""
    import open3d as o3d

    size = _extent(reference)
    clouds = [o3d.t.geometry.PointCloud(o3d.core.Tensor(cloud.astype(np.float32))) for cloud in (reference, model)]
    clouds[0].estimate_normals(max_nn=20, radius=size / 50)
    treg = o3d.t.pipelines.registration
    criteria = [treg.ICPConvergenceCriteria(1e-8, 1e-8, n) for n in (60, 40, 30)]
    leaves = o3d.utility.DoubleVector([size / 60, size / 150, size / 350])
    gates = o3d.utility.DoubleVector([size / 8, size / 40, size / 120])
    T = o3d.core.Tensor(np.eye(4) if start is None else start)
    found = treg.multi_scale_icp(
        clouds[1], clouds[0], leaves, criteria, gates, T, treg.TransformationEstimationPointToPlane()
    )
    return found.transformation.numpy()


def kiss_then_gicp(reference, model, start=None):
    """KISS-Matcher's global alignment, then GICP; it takes no start."""
    import kiss_matcher

    scale = 100.0 / _extent(reference)  # its voxels have a least size in whatever unit
    config = kiss_matcher.KISSMatcherConfig(1.0)
    clouds = [(scale * cloud).astype(np.float32) for cloud in (model, reference)]
    found = kiss_matcher.KISSMatcher(config).estimate(*clouds)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.array(found.rotation), np.array(found.translation).reshape(3) / scale
    return small_gicp_two_calls(reference, model, T)


_ALL = (
    ("small_gicp", "GICP twice", small_gicp_two_calls),
    ("small_gicp", "VGICP", small_gicp_vgicp),
    ("open3d", "Open3D multi-scale", open3d_multi_scale),
    ("kiss_matcher", "KISS + GICP", kiss_then_gicp),
)
PEERS = {
    name: work
    for module, name, work in _ALL
    if all(importlib.util.find_spec(one) for one in {module, "small_gicp" if "kiss" in module else module})
}
