"""The family of iterative closest point methods as policies that compose.

    frames        what is known of each point: normals, invariants in units of noise, boundaries
    describing    other invariants for both: moments, spherical harmonics of what lies around a point
    selection     which model points are asked: all, uniform, random, by normals, by curvature
    matching      whom they meet: closest, closest in place and invariants, projective, along normals
    rejection     which pairs are dropped: adaptive, boundary, normals, one-to-one, trimmed, least median, consensus
    weighting     how much a pair counts: alike, by distance, by normals, by noise, Tukey
    minimising    the motion: SVD, quaternions, to the plane, symmetric, plane to plane, with scale
    acceleration  extrapolation, Anderson's mixing
    method        the loop around them
    presets       the methods of the literature by name

The default method of the station is not one of these: see `registration.register`.
"""
