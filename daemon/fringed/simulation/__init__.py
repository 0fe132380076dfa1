"""The simulated rig: scene, optics, light, sensor and one virtual clock, with the truth for every camera pixel.

Owns the physics; knows nothing of acquisition, sockets or plug-ins. Only the simulated devices import it.
`numba` is imported by the first picture, not by importing this package.
"""
