"""Parameters of the simulated rig; defaults from hardware.md's last table, [R] recalled or [A] assumed.

Owns names, units and limits of what can be simulated; the physics is in `fringed.simulation`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

Vector = tuple[float, float, float]


class SimSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every section: unknown keys are errors."""


class SceneConfig(SimSection, frozen=True, kw_only=True):
    """What stands in front of the rig; the object turns about its own origin, then moves."""

    object: Annotated[
        str,
        Meta(
            description="plane, sphere, ball-bar, steps, freeform, face, hand, mesh, board, or a plug-in's scene",
            min_length=1,
        ),
    ] = "face"
    options: Annotated[dict[str, Any], Meta(description="the object's own, such as radius_mm, path, formula")] = {}
    rotation_deg: Annotated[Vector, Meta(description="about x, then y, then z")] = (0.0, 0.0, 0.0)
    translation_mm: Vector = (0.0, 0.0, 0.0)
    velocity_mm_s: Annotated[Vector, Meta(description="motion during acquisition")] = (0.0, 0.0, 0.0)
    backdrop: Annotated[Literal["black", "grey", "none"], Meta(description="a far plane behind the object")] = "black"
    backdrop_distance_mm: Annotated[float, Meta(gt=0)] = 1250.0
    albedo: Annotated[float, Meta(ge=0.01, le=1)] = 0.75
    specular: Annotated[float, Meta(ge=0, le=1)] = 0.0
    ambient: Annotated[float, Meta(ge=0, le=1, description="of the projector's white")] = 0.03


class GeometryConfig(SimSection, frozen=True, kw_only=True):
    """Where camera and projector stand. The camera is the origin and looks along +z. [A]."""

    working_distance_mm: Annotated[float, Meta(gt=50, le=1e5)] = 1000.0
    field_mm: Annotated[float, Meta(gt=5, le=1e5, description="width seen at the working distance")] = 400.0
    baseline_mm: Annotated[float, Meta(gt=1, le=1e5, description="projector to the camera's right")] = 280.0
    projector_field_mm: Annotated[float, Meta(gt=5, le=1e5, description="width lit at the working distance")] = 470.0
    camera_distortion: tuple[float, float, float, float, float] = (-0.08, 0.03, 0.0004, -0.0003, 0.0)
    projector_distortion: tuple[float, float, float, float, float] = (-0.03, 0.01, -0.0002, 0.0005, 0.0)


class ProjectorOptics(SimSection, frozen=True, kw_only=True):
    """The projector's light. [R]."""

    width_px: Annotated[int, Meta(ge=16, le=8192)] = 1024
    height_px: Annotated[int, Meta(ge=16, le=8192)] = 768
    gamma: Annotated[float, Meta(ge=1, le=3)] = 2.2
    s_curve: Annotated[float, Meta(ge=0, le=0.3)] = 0.03
    black_level: Annotated[float, Meta(ge=0, le=0.2)] = 1 / 400
    blur_px: Annotated[float, Meta(ge=0, le=10, description="Gaussian sigma in focus")] = 0.65
    blur_px_per_mm: Annotated[float, Meta(ge=0, le=1, description="growth off the focal distance")] = 0.008
    misconvergence_px: Annotated[tuple[float, float], Meta(description="red and blue against green")] = (0.0, 0.0)
    vignetting: Annotated[float, Meta(ge=0, le=1, description="loss at the corners")] = 0.15
    flicker: Annotated[float, Meta(ge=0, le=0.2, description="amplitude at twice the mains [R]")] = 0.01
    mains_hz: Annotated[float, Meta(gt=0, le=500)] = 50.0
    display_hz: Annotated[float, Meta(gt=1, le=1000)] = 60.0
    latency_frames: Annotated[int, Meta(ge=0, le=20)] = 2
    settle_s: Annotated[float, Meta(ge=0, le=1, description="until an LCD pixel is within 0.1 %")] = 0.010


class SensorConfig(SimSection, frozen=True, kw_only=True):
    """The camera's sensor: 3 CCDs behind one lens. [R] except the size [V]."""

    width_px: Annotated[int, Meta(ge=8, le=8192)] = 1392
    height_px: Annotated[int, Meta(ge=8, le=8192)] = 1040
    full_well_electrons: Annotated[float, Meta(gt=0)] = 13000.0
    read_noise_electrons: Annotated[float, Meta(ge=0)] = 12.0
    dark_electrons_per_s: Annotated[float, Meta(ge=0)] = 20.0
    prnu: Annotated[float, Meta(ge=0, le=0.2)] = 0.01
    dsnu_electrons: Annotated[float, Meta(ge=0)] = 2.0
    offset_dn: Annotated[float, Meta(ge=0, le=64, description="black level of 8-bit frames")] = 2.0
    crosstalk: Annotated[
        tuple[Vector, Vector, Vector], Meta(description="rows: camera R, G, B; columns: projector R, G, B")
    ] = ((0.90, 0.08, 0.02), (0.07, 0.85, 0.08), (0.01, 0.09, 0.90))
    blur_px: Annotated[float, Meta(ge=0, le=5, description="Gaussian sigma of the camera's lens")] = 0.0
    vignetting: Annotated[float, Meta(ge=0, le=1, description="loss at the corners")] = 0.15
    reference_exposure_us: Annotated[
        float,
        Meta(gt=0, description="exposure that brings a white plane to 80 % of full scale"),
    ] = 8333.333
    period_s: Annotated[float, Meta(gt=0, le=10, description="free-running frame period")] = 0.1335


class FaultConfig(SimSection, frozen=True, kw_only=True):
    """How often each fault strikes a frame, 0 to 1; faults can also be ordered while running."""

    late: Annotated[float, Meta(ge=0, le=1)] = 0.0
    repeated: Annotated[float, Meta(ge=0, le=1)] = 0.0
    blended: Annotated[float, Meta(ge=0, le=1)] = 0.0
    dropped: Annotated[float, Meta(ge=0, le=1)] = 0.0
    torn: Annotated[float, Meta(ge=0, le=1)] = 0.0
    vanish: Annotated[float, Meta(ge=0, le=1)] = 0.0
    stall: Annotated[float, Meta(ge=0, le=1)] = 0.0
    garbage: Annotated[float, Meta(ge=0, le=1)] = 0.0


FAULTS = FaultConfig.__struct_fields__


class SimulationConfig(SimSection, frozen=True, kw_only=True):
    """The simulated rig."""

    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 1
    real_time: Annotated[bool, Meta(description="false: as fast as it computes")] = True
    noise: Annotated[bool, Meta(description="false: no shot, read or fixed-pattern noise")] = True
    quantise: Annotated[bool, Meta(description="false is only for measuring systematic errors: 16-bit frames")] = True
    geometry: GeometryConfig = GeometryConfig()
    scene: SceneConfig = SceneConfig()
    projector: ProjectorOptics = ProjectorOptics()
    sensor: SensorConfig = SensorConfig()
    faults: FaultConfig = FaultConfig()
