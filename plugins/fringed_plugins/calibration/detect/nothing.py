"""Why a picture shows no board: what can be said of it without one.

Owns the order in which causes are thought of, the surest first; every one comes with its figure and the limit.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.board_spec import Limits

Float32Array = npt.NDArray[np.float32]

_BRIGHT = 0.2  # share of the picture: more of it saturated hides a board
_NOISY = 8.0  # deviations of the noise that black and white have to differ by
_EDGE = float(np.sqrt(2 * np.pi))  # a blurred edge's height over its steepest slope, in the blur's sigma


def why_nothing(image: Float32Array, saturated: npt.NDArray[np.bool_] | None, limits: Limits) -> str:
    """Return what is wrong with a picture (height, width) as such, or "" where nothing is."""
    finite = image[np.isfinite(image)]
    low, high = (float(v) for v in np.percentile(finite, (0.5, 99.5)))
    bright = float(saturated.mean()) if saturated is not None else 0.0
    if bright > _BRIGHT:
        return f"saturated: {bright:.0%} of the picture's pixels; shorten the exposure"
    noise = _noise(image)
    if high - low <= _NOISY * noise:
        return (
            f"too dark, or too little contrast: grey levels from {low:.3g} to {high:.3g} with noise of {noise:.2g}; "
            f"they have to differ by {_NOISY:.0f} times the noise: more light, or a longer exposure"
        )
    contrast = (high - low) / (abs(high) + abs(low))
    if contrast < limits.min_contrast:
        return (
            f"low contrast: grey levels from {low:.3g} to {high:.3g}, {contrast:.0%}; "
            f"at least {limits.min_contrast:.0%}"
        )
    width = _sharpest(image, high - low)
    if width > limits.max_blur_px:
        return (
            f"blurred: the sharpest edges are about {width:.1f} px wide, at most {limits.max_blur_px:.1f}; hold the "
            "board still and within the depth of focus"
        )
    return ""


def _noise(image: Float32Array) -> float:
    """Return the deviation of the noise: of second differences, which pictures have few of (Immerkaer 1996)."""
    fine = image[1:-1, 1:-1] - 0.5 * (image[1:-1, :-2] + image[1:-1, 2:])
    fine = fine[1:] - fine[:-1]
    fine = fine[np.isfinite(fine)]
    return float(1.4826 * np.median(np.abs(fine - np.median(fine))) / np.sqrt(3.0)) if fine.size else 0.0


def _sharpest(image: Float32Array, span: float) -> float:
    """Return how wide (sigma, px) the sharpest edges are that reach from dark to bright."""
    import cv2

    smooth = cv2.GaussianBlur(np.nan_to_num(image, nan=float(np.nanmin(image))), (0, 0), 1.5)
    steep = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8))
    height = float(np.percentile(steep, 99.9))
    seen = span / (_EDGE * height) if height > 0 else np.inf
    return float(np.sqrt(max(seen**2 - 1.5**2, 0.0)))
