"""The synthetic surface of the benches, for tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "bench"))

from thesis_data import errors_percent, height, moved, pose, surface

__all__ = ["errors_percent", "height", "moved", "pose", "surface"]
