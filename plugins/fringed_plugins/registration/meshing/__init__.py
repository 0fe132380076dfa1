"""Registered range images to one triangle mesh: a signed distance volume and its zero surface.

    blocks     sparse blocks of voxels near the surface
    volume     signed distances of all views, fused in the blocks
    facing     which side of a view is outside
    distances  the kernel behind it
    cubes      marching cubes by a generated table: every closed field gives a manifold
    filling    the field where nobody has looked, for watertight meshes
    triangles  the mesh: topology, normals, specks
    colouring  normals, intensity and confidence of the vertices
    sampling   points spread evenly over triangles
    integrate  all of it for registered views

Knows nothing of the daemon, of plug-ins or of files.
"""
