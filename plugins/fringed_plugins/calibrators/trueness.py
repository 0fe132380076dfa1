"""How true points can be that a calibration gives, over the volume of its poses: figures for its report.

Owns where the volume is; the propagation is `calibration.pixel.uncertainty`'s.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Artifact, Calibration
from fringed.errors import DataError
from fringed.hookspecs import Context

_PLANES = 3


class ExpectedTrueness:
    """A calibration to the standard deviation that it leaves of points: its covariance, propagated.

    Noise of the phase comes on top, point by point. What no pose has shown, such as a wrong pitch of the board, is in
    no covariance: a known length tells (`fringe verify`).

    References
    ----------
    JCGM 100:2008 (GUM), section 5.2.
    """

    name: ClassVar[str] = "expected-trueness"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "a calibration to the deviation of points that it leaves, over the volume"
    inputs: ClassVar[Mapping[str, Any]] = {"calibration": Calibration}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Artifact

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        depths_mm: Annotated[
            tuple[Annotated[float, Meta(gt=0)], ...],
            Meta(max_length=50, description="planes; empty: of the poses", extra_json_schema={"units": "mm"}),
        ] = ()
        columns: Annotated[int, Meta(ge=2, le=200, description="of the grid of pixels")] = 29
        rows: Annotated[int, Meta(ge=2, le=200, description="of the grid of pixels")] = 21

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Artifact:
        """Return JSON: `depths_mm`, `size_px`, and `sigma_mm` [depth][row][column], null beyond the projector.

        Raises
        ------
        DataError
            a calibration without covariance, or without poses where no depths are given.
        """
        from fringed_plugins.calibration.pixel.uncertainty import trueness_mm
        from fringed_plugins.calibration.rig import Pinhole

        found: Calibration = inputs["calibration"]
        depths = params.depths_mm or _depths_mm(found)
        if found.covariance is None or not depths:
            raise DataError(
                f"the calibration {found.id or found.hash} has no covariance or no poses, so its trueness cannot be "
                "told; make one with `fringe calibrate`"
            )
        camera, projector = (
            Pinhole(one.width_px, one.height_px, one.matrix, one.distortion) for one in (found.camera, found.projector)
        )
        try:
            sigma = trueness_mm(
                camera, projector, found.T_projector_camera, found.covariance, found.parameters, depths_mm=depths,
                grid=(params.rows, params.columns),
            )  # fmt: skip
        except ValueError as error:
            raise DataError(f"the calibration {found.id or found.hash}: {error}") from error
        whole = np.sqrt((sigma**2).sum(axis=-1)).astype(object)
        whole[~np.isfinite(whole.astype(float))] = None
        size = [found.camera.width_px, found.camera.height_px]
        table = {"depths_mm": list(depths), "size_px": size, "sigma_mm": whole.tolist()}
        content = np.frombuffer(json.dumps(table).encode(), np.uint8)
        return Artifact("trueness.json", "application/json", content)


def _depths_mm(found: Calibration) -> list[float]:
    """Return the nearest, the middle and the farthest depth of the poses."""
    used = [view.T_camera_board[2, 3] for view in found.views if not view.note]
    return [float(depth) for depth in np.linspace(min(used), max(used), _PLANES)] if used else []
