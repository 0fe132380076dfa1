"""Known artefacts in a range image: planes, spheres and steps, found and measured. Arrays in, arrays out.

`cells` looks at the surface coarsely, `smooth` tells its pieces apart, `scatter` judges deviations; `plane`, `sphere`
and `step` measure. The terms are those of VDI/VDE 2634 part 2.
"""
