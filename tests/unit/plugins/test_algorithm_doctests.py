"""The examples in the algorithms' docstrings run."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import fringed_plugins

ROOT = Path(fringed_plugins.__file__).parent
MODULES = sorted(
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts)
    for path in ROOT.rglob("*.py")
    if "    >>> " in path.read_text()
)


def test_algorithms_have_examples():
    families = {name.split(".")[1] for name in MODULES}
    assert {"phase", "unwrap", "calibration"} <= families and len(MODULES) > 30


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_hold(name):
    result = doctest.testmod(importlib.import_module(name))
    assert result.attempted > 0
    assert result.failed == 0
