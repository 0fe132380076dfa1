"""Compiled code on disk is not used for changed sources."""

from __future__ import annotations

import subprocess
import sys

import pytest

INNER = "from numba import njit\n@njit\ndef inner(x):\n    return x + {}\n"
OUTER = """
import inner_module
from fringed_plugins.compiled import kept
from inner_module import inner

@kept(inner_module)
def outer(x):
    return inner(x)

print(outer(1), sum(outer.stats.cache_hits.values()))
"""


@pytest.fixture
def called(tmp_path):
    def run(number):
        (tmp_path / "inner_module.py").write_text(INNER.format(number))
        (tmp_path / "outer_module.py").write_text(OUTER)
        command = [sys.executable, "-c", "import outer_module"]
        env = {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(command, capture_output=True, text=True, env=env, timeout=100, check=True)
        return tuple(int(word) for word in done.stdout.split())

    return run


def test_a_change_in_a_module_that_is_called_makes_the_kernel_anew(called):
    assert called(10) == (11, 0)
    assert called(10) == (11, 1)  # kept on disk
    assert called(20) == (21, 0)
    assert called(20) == (21, 1)
