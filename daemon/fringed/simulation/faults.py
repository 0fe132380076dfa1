"""Faults on demand and by chance.

Owns how many are ordered and when one strikes; what a fault does is the business of whoever asks.
"""

from __future__ import annotations

import random
import threading

from fringed.config.simulated import FAULTS, FaultConfig
from fringed.errors import UsageError


class Faults:
    """Which faults strike next; safe to order from any thread."""

    def __init__(self, chances: FaultConfig, seed: int) -> None:
        self._chances = chances
        self._lock = threading.Lock()
        self._ordered = dict.fromkeys(FAULTS, 0)
        self._random = {name: random.Random(f"{seed}/{name}") for name in FAULTS}

    def order(self, name: str, count: int = 1) -> None:
        """Let the next `count` occasions for this fault be struck; 0 takes the order back.

        Raises
        ------
        UsageError
            no such fault, or a negative count.
        """
        if name not in self._ordered:
            raise UsageError(f"there is no fault {name!r}; the simulated rig knows {', '.join(FAULTS)}")
        if count < 0:
            raise UsageError(f"{count} faults are ordered; it must be 0 or more")
        with self._lock:
            self._ordered[name] = count

    def strikes(self, name: str) -> bool:
        """Say whether this occasion is struck, and count it."""
        with self._lock:
            if self._ordered[name] > 0:
                self._ordered[name] -= 1
                return True
            chance = float(getattr(self._chances, name))
            return chance > 0 and self._random[name].random() < chance

    def draw(self, name: str, low: float, high: float) -> float:
        """Return a number that says how a fault looks, from its own sequence."""
        with self._lock:
            return self._random[name].uniform(low, high)
