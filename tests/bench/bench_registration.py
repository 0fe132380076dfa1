"""Registration of two views and merging of three: seconds and errors against the poses they were seen from.

The relief is a formula, each view samples it anew (about 350,000 points, noise 0.05 mm). small_gicp's GICP,
coarse to fine from the identity, runs beside it where it is installed, for information.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "registration"))

from analytic_relief import errors, hand, head, pose, see

from fringed_plugins.registration.chaining import chain
from fringed_plugins.registration.merging import merge
from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.surface import prepare

NOISE_MM = 0.05
SECONDS, DEGREES, MM = 2.0, 0.05, 0.1
FULL = {"pitch_mm": 0.29, "size": (850, 760)}


def say(name, figures, limits):
    passed = all(value < limit for value, limit in zip(figures, limits, strict=True))
    seconds, degrees, mm = figures
    print(
        f"{'PASS' if passed else 'MISS'}  {name}: {seconds:.2f} s, {degrees:.4f} deg, {mm:.4f} mm "
        f"(at most {limits[0]:g} s, {limits[1]:g} deg, {limits[2]:g} mm)",
        flush=True,
    )


def ours(reference, model):
    surfaces = prepare(reference.xyz_mm), prepare(model.xyz_mm)
    return register(*surfaces, Options(threads=2))


def gicp(reference, model):
    import small_gicp

    clouds = [view.xyz_mm[np.isfinite(view.xyz_mm[..., 0])].astype(np.float64) for view in (reference, model)]
    T = np.eye(4)
    for leaf, reach in ((4.0, 30.0), (1.2, 4.0)):
        options = {"registration_type": "GICP", "downsampling_resolution": leaf, "max_correspondence_distance": reach}
        T = small_gicp.align(*clouds, init_T_target_source=T, num_threads=2, **options).T_target_source
    return T


def timed(work, *args):
    started = time.perf_counter()
    result = work(*args)
    return time.perf_counter() - started, result


def main() -> int:
    views = {}
    for shape in (head, hand):
        for number, angle in enumerate((-25, 0, 25)):
            views[shape, number] = see(shape, pose((0, angle, 0)), noise_mm=NOISE_MM, seed=number, **FULL)
        for a, b in ((0, 1), (1, 2), (0, 2)):
            pair = views[shape, a], views[shape, b]
            ours(*pair)  # warm
            seconds, found = timed(ours, *pair)
            name = f"register {shape.__name__}, {25 * (b - a)} deg, overlap {found.overlap:.2f}"
            say(name, (seconds, *errors(found.T_reference_model, *pair)), (SECONDS, DEGREES, MM))
            try:
                seconds, T = timed(gicp, *pair)
            except ImportError:
                continue
            degrees, mm = errors(T, *pair)
            print(f"INFO  small_gicp GICP, coarse to fine, same pair: {seconds:.2f} s, {degrees:.4f} deg, {mm:.4f} mm")
        merging(shape, [views[shape, i] for i in range(3)])
    return 0


def merging(shape, views):
    started = time.perf_counter()
    surfaces = [prepare(view.xyz_mm) for view in views]
    linked = chain(surfaces, Options(threads=2))
    grey = [np.zeros(view.xyz_mm.shape[:2], np.uint8) for view in views]
    cloud = merge(surfaces, grey, np.array([linked.T_model_view[i] for i in range(3)]))
    seconds = time.perf_counter() - started
    x = cloud.points @ np.linalg.inv(views[0].T_camera_object)[:3, :3].T
    x = x + np.linalg.inv(views[0].T_camera_object)[:3, 3]
    off = x[:, 2] - shape(x[:, 0], x[:, 1])
    print(
        f"INFO  merge 3 views of {shape.__name__}: {seconds:.2f} s, {sum(s.valid.sum() for s in surfaces):,} points to "
        f"{len(x):,}, in depth {off.mean():+.4f} mm off, {off.std():.4f} mm standard deviation",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
