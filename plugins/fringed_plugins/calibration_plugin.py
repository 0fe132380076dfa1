"""Registers calibration: boards to views, views to a calibration, artefacts to verifications."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fringed.hookspecs import hookimpl
from fringed_plugins.calibrators.calibrate import Calibrate
from fringed_plugins.calibrators.detect_board import DetectBoard
from fringed_plugins.calibrators.drift import CompareCalibrations, InfieldCorrection
from fringed_plugins.calibrators.pixel_models import FitPixelModel
from fringed_plugins.calibrators.ranges import AverageRange, VerifyRange
from fringed_plugins.calibrators.suggest import SuggestPose
from fringed_plugins.calibrators.trueness import ExpectedTrueness
from fringed_plugins.calibrators.verify import VerifyPlane, VerifySphere, VerifyStep


@hookimpl
def register_processors() -> Sequence[type[Any]]:
    """Return the processors of calibration."""
    verifying = (VerifyPlane, VerifySphere, VerifyStep, VerifyRange, AverageRange)
    calibrating = (Calibrate, CompareCalibrations, InfieldCorrection, DetectBoard, ExpectedTrueness, FitPixelModel)
    return (*calibrating, SuggestPose, *verifying)
