"""Whatever encodes, decodes or processes is described on a page, and every page is linked from the index."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fringed.loading import load_plugins

DOCS = Path(__file__).resolve().parents[2] / "docs"
INDEX = (DOCS / "methods.md").read_text(encoding="utf-8")
PAGES = sorted((DOCS / "methods").glob("*.md"))
LINK = re.compile(r"\]\(([^)#\s]*)(?:#[^)]*)?\)")
LARGEST_PICTURE_BYTES = 150_000


def names() -> list[str]:
    provided = load_plugins().provided
    return sorted({*provided["encoder"], *provided["processor"]})


@pytest.mark.parametrize("name", names())
def test_each_encoder_and_processor_is_in_the_index_and_described(name: str) -> None:
    assert f"`{name}`" in INDEX, f"docs/methods.md does not name {name}: add a row that links its page"
    pages = {page.name for page in PAGES if f"`{name}`" in page.read_text(encoding="utf-8")}
    assert pages or f"## `{name}`" in INDEX, f"no page of docs/methods and no section of methods.md describes {name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.name))
def test_each_page_is_linked_and_links_to_what_is_there(page: Path) -> None:
    assert f"(methods/{page.name}" in INDEX
    assert f"(methods/{page.name})" in (DOCS / "README.md").read_text(encoding="utf-8")
    targets = [link for link in LINK.findall(page.read_text(encoding="utf-8")) if link and "://" not in link]
    missing = [link for link in targets if not (page.parent / link).exists()]
    assert not missing, f"{page.name} links to {missing}"


@pytest.mark.parametrize("picture", sorted((DOCS / "pictures").glob("*.png")), ids=lambda path: str(path.name))
def test_each_picture_is_shown_somewhere_and_small(picture: Path) -> None:
    shown = "".join(page.read_text(encoding="utf-8") for page in [*DOCS.rglob("*.md"), DOCS.parent / "README.md"])
    assert f"pictures/{picture.name}" in shown, f"no page shows {picture.name}"
    if picture.name != "demo.png":
        size = picture.stat().st_size
        assert size <= LARGEST_PICTURE_BYTES, f"{size} bytes: reduce it with tools/pictures/shrink.py"
