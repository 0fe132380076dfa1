"""What of the service is installed: unit, rules, links, and whether it starts at boot.

Owns where systemd and udev look, the administrator's folder first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fringed.finding.reading import entries

UNIT_FOLDERS = ("etc/systemd/system", "run/systemd/system", "usr/lib/systemd/system", "lib/systemd/system")
RULE_FOLDERS = ("etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")
UNIT, RULES, NAMES = "fringed.service", "60-fringed.rules", "61-fringed-names.rules"


@dataclass(frozen=True)
class Installed:
    """Paths without the root; empty where nothing is. `links` maps our names in /dev to the nodes behind them."""

    unit: str
    enabled: bool
    rules: str
    names: str
    links: dict[str, str]
    dangling: tuple[str, ...] = ()


def installed(root: Path) -> Installed:
    """Return what is installed below `root`."""
    wants = root / "etc/systemd/system/multi-user.target.wants" / UNIT
    links, dangling = dict[str, str](), list[str]()
    for link in entries(root / "dev/fringed"):
        name = f"/dev/fringed/{link.name}"
        if link.exists():
            links[name] = f"/dev/{link.resolve().relative_to((root / 'dev').resolve())}"
        else:
            dangling.append(name)
    return Installed(
        _first(root, UNIT_FOLDERS, UNIT), wants.is_symlink() or wants.exists(), _first(root, RULE_FOLDERS, RULES),
        _first(root, RULE_FOLDERS, NAMES), links, tuple(dangling),
    )  # fmt: skip


def other_rules(root: Path, word: str) -> list[str]:
    """Return the rules' files whose name contains `word`, such as brltty, which takes serial adapters for itself."""
    return [f"/{path.relative_to(root)}" for folder in RULE_FOLDERS for path in entries(root / folder, f"*{word}*")]


def _first(root: Path, folders: tuple[str, ...], name: str) -> str:
    return next((f"/{folder}/{name}" for folder in folders if (root / folder / name).exists()), "")
