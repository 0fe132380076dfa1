"""What `fringed doctor` reports: one finding for each thing looked at."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """One line: what was looked at, how it is, and what to do."""

    level: Literal["ok", "warn", "fail"]
    what: str
    found: str
    do: str = ""


Findings = Iterator[Finding]
