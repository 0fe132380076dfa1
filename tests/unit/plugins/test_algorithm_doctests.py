"""The examples in the algorithms' docstrings run."""

from __future__ import annotations

import doctest
import importlib

import pytest

MODULES = (
    "calibration.reference", "phase.dithering", "phase.frequencies", "phase.frequency_errors", "phase.patterns",
    "phase.pattern_rules", "phase.profiles", "phase.shifts", "unwrap.regions", "unwrap.spatial",
    "phase.accumulate", "phase.arctangent", "phase.weighting",
    "unwrap.branch_cut", "unwrap.least_squares",
    "phase.nonlinear.curve", "phase.nonlinear.harmonics", "phase.nonlinear.regional", "phase.nonlinear.response",
    "phase.nonlinear.ripple", "phase.nonlinear.rounding", "phase.nonlinear.table",
    "phase.graycode", "phase.masks.hot", "phase.masks.order_median", "phase.masks.repeated", "phase.masks.shadow",
    "phase.masks.specks", "phase.temporal.joint", "phase.temporal.sets",
    "phase.bands", "phase.colour", "phase.crosstalk", "phase.fourier", "phase.one_shot", "phase.shift_geometry",
    "phase.single_frame_rules", "phase.triangle_kernel", "phase.unknown_shifts", "phase.windowed_fourier",
)  # fmt: skip


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_hold(name):
    result = doctest.testmod(importlib.import_module(f"fringed_plugins.{name}"))
    assert result.attempted > 0
    assert result.failed == 0
