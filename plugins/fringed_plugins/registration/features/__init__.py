"""Local shape of range images and of point clouds: what a registration may compare besides places.

    grid        principal curvatures of organised points, with the noise that they carry
    cloud       the same, normals and boundaries of unorganised points, and a level made of them
    invariants  moments and spherical harmonics of what lies within a radius

Curvatures are positive where the surface bulges against its normal's direction of view: towards the sensor.
Knows nothing of a second view. No length is absolute: results are in the points' own unit.
"""
