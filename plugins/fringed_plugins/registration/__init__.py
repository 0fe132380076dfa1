"""Registration of organised range images: arrays in, arrays out.

Small parts that compose, so that a family of methods can share them:

    surface     range image -> decimated levels with normals, boundaries and noise
    scan        what a registration needs of a view
    patches     a smooth quadratic patch for every pixel, with its curvatures
    starts      first guesses: principal axes, turns about the image's axes
    invariant   a coarse stage by place and principal curvatures
    guesses     motions between views that nobody has told anything about
    starting    which of them are tried, in what order
    clouds      points without a grid -> levels, as `surface`
    features    curvatures and invariants, of grids and of clouds
    coarse      a tournament of the guesses on few points
    matching    closest points on a level
    rejection   which pairs count: Zhang's adaptive limit, boundaries, normals, Tukey's weights
    minimisers  the rigid motion of matched points: SVD, unit quaternion, dual quaternion
    plane       one linearised step of the point-to-plane and symmetric errors, and its information
    icp         the loop around them
    projective  the last stage: all points, foot to foot on patches
    family      the methods of the literature, composed of policies
    verify      whether the result can be believed
    register    all of it for one pair of views
    footpoints  full-resolution foot points of one view's points on another view
    chaining    many views, one after the other
    views       many views at once: graph, loops, all surfaces together
    merging     many registered views to one cloud without redundancy
    meshing     many registered views to one mesh

Knows nothing of the daemon, of plug-ins or of files. Lengths are millimetres, angles radians.
"""
