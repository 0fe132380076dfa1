"""What can go wrong with an emulated USB3 Vision camera, on request."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

Part = Literal["leader", "payload", "trailer"]


@dataclass
class Faults:
    """Faults to come. Set them at any time; what is asked for once happens once.

    `lost_fraction` of all stream transfers are lost; `lose_next` loses the next ones of these kinds;
    `short_next` cuts that many blocks short; `late_next_s` delays the next blocks; `discard_next` blocks are said to
    be discarded by the camera; `stalled` and `silent` control answers are a halted endpoint and none at all;
    `pending` answers first ask for more time; `unplug_in` stream transfers from now, the cable is pulled;
    `wrong_format` is sent in place of the pixel format that was asked for.
    """

    lost_fraction: float = 0.0
    lose_next: deque[Part] = field(default_factory=deque)
    short_next: int = 0
    late_next_s: deque[float] = field(default_factory=deque)
    discard_next: int = 0
    stalled: int = 0
    silent: int = 0
    pending: int = 0
    unplug_in: int | None = None
    wrong_format: int | None = None
    seed: int = 6

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def loses(self, part: Part) -> bool:
        """Whether this transfer is lost."""
        if self.lose_next and self.lose_next[0] == part:
            self.lose_next.popleft()
            return True
        return bool(self.lost_fraction) and self._random.random() < self.lost_fraction

    def late_s(self) -> float:
        """How much later than it should the next block comes."""
        return self.late_next_s.popleft() if self.late_next_s else 0.0

    def take(self, name: Literal["short_next", "discard_next", "stalled", "silent", "pending"]) -> bool:
        """Whether a counted fault strikes now."""
        left: int = getattr(self, name)
        if left:
            setattr(self, name, left - 1)
        return left > 0

    def unplugs(self) -> bool:
        """Whether the cable is pulled before this stream transfer."""
        if self.unplug_in is None:
            return False
        self.unplug_in -= 1
        if self.unplug_in >= 0:
            return False
        self.unplug_in = None
        return True
