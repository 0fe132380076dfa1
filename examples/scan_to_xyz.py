"""Scan what stands before the rig and get its points."""

import numpy as np

from fringed_client import Station

with Station() as station:
    result = station.scan(on_progress=lambda state: print(f"{state.state} {state.progress:.0%}"))
    image = result.range_image

points_mm = image.xyz_mm[image.rejected == 0]  # (n, 3) float32, camera frame, z away from the camera
simulated = " SIMULATED" if image.provenance.simulated else ""
print(f"{len(points_mm)} points, z from {points_mm[:, 2].min():.1f} to {points_mm[:, 2].max():.1f} mm{simulated}")
np.savetxt("points.xyz", points_mm, fmt="%.4f")
