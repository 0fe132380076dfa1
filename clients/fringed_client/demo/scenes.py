"""What the demonstration puts before the rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

YAWS_DEG = (0.0, -25.0, 25.0)  # the first view gives the model its frame


@dataclass(frozen=True)
class Shown:
    """One object: its scene, and what people call it."""

    name: str
    title: str
    scene: str

    def view(self, yaw_deg: float) -> dict[str, Any]:
        """Return the scene with the object turned about its vertical axis."""
        return {"object": self.scene, "rotation_deg": [0.0, yaw_deg, 0.0]}


OBJECTS = (Shown("face", "A face-like object", "face"), Shown("hand", "A plaster-like mould of a hand", "hand"))


def rig(quick: bool) -> dict[str, Any]:
    """Return the private station's configuration; `quick` has a third of the pixels in each direction."""
    from fringed.config import merged
    from fringed_client.private import SIMULATED_RIG

    sensor = {"width_px": 464, "height_px": 348} if quick else {"width_px": 1392, "height_px": 1040}
    simulation = {"sensor": sensor, "projector": {"width_px": 1024, "height_px": 768}}
    return merged(SIMULATED_RIG, {"name": "demo", "simulation": simulation})
