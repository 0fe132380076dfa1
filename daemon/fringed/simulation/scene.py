"""One scene: an object at its pose, and what is behind it.

Owns poses and the assembly of what kernels trace; knows nothing of light and sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from fringed.config.simulated import SceneConfig, SimulationConfig
from fringed.data import Float64Array, Mesh
from fringed.simulation.shapes import shape_maker
from fringed.simulation.shapes.shape import Shape

BLACK_ALBEDO = 0.002  # some tenths of a grey level: no fringe is left to see
GREY_ALBEDO = 0.5
REFERENCE = "reference"
_OBJECT_AXES = np.diag([1.0, -1.0, -1.0])  # an object's y is up and its z comes towards the camera


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene as it was configured, equal to itself only; its object is made when it is first looked at."""

    config: SceneConfig
    working_distance_mm: float
    make: Callable[[], Shape] = field(repr=False)

    @cached_property
    def shape(self) -> Shape:
        """The object in its own frame."""
        return self.make()

    def T_camera_object(self, moved_mm: Float64Array | None = None) -> Float64Array:
        """Return the object's pose (4, 4), moved by `moved_mm` (3,).

        The object stands at the working distance and turns about its own origin, about the camera's x, y, z
        axes in this order; then it moves by `translation_mm`, along the camera's axes.
        """
        transform = np.eye(4)
        transform[:3, :3] = rotation(self.config.rotation_deg) @ _OBJECT_AXES
        transform[:3, 3] = np.add(self.config.translation_mm, (0.0, 0.0, self.working_distance_mm))
        if moved_mm is not None:
            transform[:3, 3] += moved_mm
        return transform

    @property
    def moves(self) -> bool:
        """Whether the object moves while a set is taken."""
        return any(self.config.velocity_mm_s)


def build_scene(config: SceneConfig, working_distance_mm: float, mesh: Mesh | None = None) -> Scene:
    """Check a scene and return it; raises ConfigurationError or DataError for one that cannot be."""
    return Scene(config, working_distance_mm, shape_maker(config, mesh))


def rotation(angles_deg: tuple[float, float, float]) -> Float64Array:
    """Return the rotation (3, 3) about x, then y, then z, right-handed."""
    result = np.eye(3)
    for axis, angle in enumerate(np.deg2rad(angles_deg)):
        a, b = [(1, 2), (2, 0), (0, 1)][axis]
        one = np.eye(3)
        one[a, a] = one[b, b] = np.cos(angle)
        one[a, b], one[b, a] = -np.sin(angle), np.sin(angle)
        result = one @ result
    return result


def solid_of(scene: Scene, T_camera_object: Float64Array) -> Any:
    """Return the scene as kernels trace it, in the camera's frame."""
    from fringed.simulation.trace_kernels import Solid

    shape, config = scene.shape, scene.config
    R, t = T_camera_object[:3, :3], T_camera_object[:3, 3]
    vertices = shape.vertices_mm @ R.T + t
    corners = vertices[shape.faces]
    triangles = np.empty((len(shape.faces), 3, 3))
    if len(corners):
        triangles[:, 0] = corners[:, 0]
        triangles[:, 1:] = corners[:, 1:] - corners[:, :1]
    far = {"black": BLACK_ALBEDO, "grey": GREY_ALBEDO, "none": 0.0}[config.backdrop]
    return Solid(
        triangles=triangles,
        faces=np.array(shape.faces, np.int32),
        normals=shape.normals @ R.T,
        albedo=np.array(shape.albedo * config.albedo, np.float64),
        spheres=_spheres(shape, R, t, config.albedo),
        plane=np.array([config.backdrop_distance_mm if far else 0.0, far, 0.0]),
    )


def _spheres(shape: Shape, R: Float64Array, t: Float64Array, albedo: float) -> Float64Array:
    spheres = np.full((len(shape.spheres), 5), albedo)
    spheres[:, :3] = shape.spheres[:, :3] @ R.T + t
    spheres[:, 3] = shape.spheres[:, 3]
    return spheres


def reference_solid(config: SimulationConfig) -> Any:
    """Return the reference plane alone: grey, facing the camera, where the station's calibration says."""
    from fringed.simulation.trace_kernels import Solid

    none = np.zeros((0, 3))
    return Solid(
        np.zeros((0, 3, 3)), np.zeros((0, 3), np.int32), none, np.zeros(0), np.zeros((0, 5)),
        np.array([config.scene.backdrop_distance_mm, GREY_ALBEDO, 1.0]),
    )  # fmt: skip
