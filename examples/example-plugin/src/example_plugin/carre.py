"""Carré's decoder: four frames of equal, unknown phase steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import hookspecs
from fringed.data import FrameSet, PhaseMap, Reject
from fringed.errors import DataError
from fringed.hookspecs import Context


class CarreParams(hookspecs.Params, frozen=True, kw_only=True):
    """Parameters."""

    min_modulation_dn: Annotated[
        float, Meta(ge=0, le=65535, description="smallest modulation", extra_json_schema={"units": "grey level"})
    ] = 5.0


class CarreDecoder:
    """Wrapped phase of four frames with equal steps that need not be known.

    The step is taken from the frames themselves, so that a projector whose phase drifts evenly does no harm.

    References
    ----------
    Carré 1966, Metrologia 2, 13. With a = I0 - I3 and b = I1 - I2 the half step s fulfils
    tan^2 s = (3 b - a) / (a + b), and the phase in the middle of the four frames is
    atan2(sqrt((a + b)(3 b - a)), (I1 + I2) - (I0 + I3)), the signs of b and of sin s restored.
    """

    name: ClassVar[str] = "carre"
    version: ClassVar[str] = "0.1.0"
    summary: ClassVar[str] = "four frames of any equal step to a wrapped phase"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap
    Params: ClassVar[type[hookspecs.Params]] = CarreParams

    def run(self, inputs: Mapping[str, Any], params: CarreParams, context: Context) -> PhaseMap:
        """Return the wrapped phase; raise DataError for anything but four steps of one frequency."""
        frame_set = inputs.get("frames")
        if not isinstance(frame_set, FrameSet):
            raise DataError(f"carre decodes a FrameSet named 'frames', not {type(frame_set).__name__}")
        patterns = frame_set.sequence.frames
        if len(patterns) != 4 or len(frame_set.sequence.groups()) != 1:
            raise DataError(f"carre decodes four frames of one frequency, not {len(patterns)}; set steps = 4")
        context.check_cancelled()
        phase, modulation, background = carre(frame_set.frames.astype(np.float32))
        middle = float(np.mean([pattern.shift_rad for pattern in patterns]))
        phase = np.angle(np.exp(1j * (phase - middle)))
        dark = ~(modulation >= params.min_modulation_dn)
        saturated = frame_set.frames.max(axis=0) == np.iinfo(frame_set.frames.dtype).max
        rejected = dark * np.uint16(Reject.LOW_MODULATION) | saturated * np.uint16(Reject.SATURATED)
        return PhaseMap(
            phase_rad=np.where(rejected, np.nan, phase).astype(np.float32),
            modulation=np.nan_to_num(modulation).astype(np.float32),
            background=background.astype(np.float32),
            rejected=rejected.astype(np.uint16),
            kind="wrapped",
            period_px=patterns[0].period_px,
            orientation=patterns[0].orientation,
            initial_phase_rad=patterns[0].initial_phase_rad,
        )


def carre(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return phase in the middle of the four frames, modulation and background, each (height, width).

    The step must lie between 0 and pi.

    Examples
    --------
    >>> shifts = 1.4 * (np.arange(4) - 1.5)
    >>> phase, modulation, background = carre(100 + 50 * np.cos(0.7 + shifts)[:, None, None])
    >>> round(float(phase[0, 0]), 4), round(float(modulation[0, 0]), 2), round(float(background[0, 0]), 2)
    (0.7, 50.0, 100.0)
    """
    outer, inner = frames[0] - frames[3], frames[1] - frames[2]
    ends, middle = frames[0] + frames[3], frames[1] + frames[2]
    # outer = 2 B sin(phase) sin(3 s), inner = 2 B sin(phase) sin(s), middle - ends = 2 B cos(phase) (cos s - cos 3 s)
    with np.errstate(divide="ignore", invalid="ignore"):
        tangent2 = (3 * inner - outer) / (outer + inner)
        good = tangent2 > 0
        # Where sin(phase) is 0 the step is unknown; the median of all other pixels stands in.
        typical = np.median(tangent2[good]) if good.any() else 1.0
        # Outliers come from there too: keep the pixel's own step where it is near the typical one.
        near = good & (tangent2 > typical / 2) & (tangent2 < typical * 2)
        half = np.arctan(np.sqrt(np.where(near, tangent2, typical)))
    sine = (outer * np.sin(3 * half) + inner * np.sin(half)) / (2 * (np.sin(3 * half) ** 2 + np.sin(half) ** 2))
    cosine = (middle - ends) / (2 * (np.cos(half) - np.cos(3 * half)))
    modulation = np.hypot(sine, cosine)
    background = frames.mean(axis=0) - cosine * (np.cos(half) + np.cos(3 * half)) / 2
    return np.arctan2(sine, cosine), modulation, background
