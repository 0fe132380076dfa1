"""The configuration page is generated; this keeps it current."""

from __future__ import annotations

from pathlib import Path

from fringed.config.reference import reference
from fringed.config.schema import StationConfig

PAGE = Path(__file__).resolve().parents[2] / "docs" / "configuration.md"


def test_page_holds_todays_reference() -> None:
    assert reference() in PAGE.read_text(encoding="utf-8"), "run: fringed show --reference, and paste it"


def test_every_top_level_key_is_documented() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert all(name in page for name in StationConfig.__struct_fields__)
