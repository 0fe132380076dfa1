"""The objects that a scene may hold: by name, with their options checked.

Owns the list of built-in objects; a plug-in's object arrives as a `data.Mesh`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from fringed.config.simulated import SceneConfig
from fringed.config.validation import validate
from fringed.data import Mesh
from fringed.errors import ConfigurationError, DataError, Problem
from fringed.simulation.shapes.basic import (
    BallBarOptions,
    PlaneOptions,
    SphereOptions,
    StepsOptions,
    ball_bar,
    plane,
    sphere,
    steps,
)
from fringed.simulation.shapes.board import board, board_options
from fringed.simulation.shapes.files import MeshOptions, mesh_file
from fringed.simulation.shapes.freeform import FreeformOptions, freeform
from fringed.simulation.shapes.hand import HandOptions, hand
from fringed.simulation.shapes.head import HeadOptions, head
from fringed.simulation.shapes.shape import Shape, ShapeOptions, mesh_shape

_OBJECTS: Mapping[str, tuple[type[ShapeOptions], Callable[[Any], Shape]]] = {
    "plane": (PlaneOptions, plane),
    "sphere": (SphereOptions, sphere),
    "ball-bar": (BallBarOptions, ball_bar),
    "steps": (StepsOptions, steps),
    "freeform": (FreeformOptions, freeform),
    "face": (HeadOptions, head),
    "hand": (HandOptions, hand),
    "mesh": (MeshOptions, mesh_file),
}
BOARD = "board"
OBJECTS = (*_OBJECTS, BOARD)
_AT_LEISURE = ("face", "hand")  # take some tenths of a second and cannot fail


def shape_maker(config: SceneConfig, mesh: Mesh | None = None) -> Callable[[], Shape]:
    """Return what makes the object of a scene; everything that can be wrong with it is found now.

    Raises
    ------
    ConfigurationError
        an object or option that does not exist, or a value out of its limits.
    DataError
        a mesh that cannot be read or contradicts itself.
    """
    if mesh is not None:
        shape = mesh_shape(mesh.vertices_mm, mesh.faces, mesh.albedo)
        return lambda: shape
    if config.object == BOARD:
        return partial(board, board_options(dict(config.options)))
    if config.object not in _OBJECTS:
        allowed = f"one of {', '.join(OBJECTS)}, or a plug-in's scene given as a mesh"
        problem = Problem("simulation.scene.object", repr(config.object), allowed)
        raise ConfigurationError("1 problem:", (problem,))
    options_type, make = _OBJECTS[config.object]
    options = validate(config.options, options_type, "simulation.scene.options")
    if config.object in _AT_LEISURE:
        return partial(make, options)
    try:
        shape = make(options)
    except DataError:
        raise
    except ValueError as error:
        problem = Problem("simulation.scene.options", repr(dict(config.options))[:80], str(error))
        raise ConfigurationError("1 problem:", (problem,)) from error
    return lambda: shape
