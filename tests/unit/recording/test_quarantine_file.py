"""The quarantine survives restarts, and a damaged file of it is put aside."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from fringed.errors import StorageError
from fringed.messages import QuarantineEntry
from fringed.recording import Store


def entry(subject: str, pipeline: str = "hierarchical", reason: str = "os._exit") -> QuarantineEntry:
    return QuarantineEntry(subject, pipeline, reason, 3, "2026-01-02T03:04:05+00:00")


def test_entries_survive_a_restart(store: Store) -> None:
    store.add_quarantine(entry("a"))
    store.add_quarantine(entry("b"))
    store.add_quarantine(entry("a", reason="again"))
    store.add_quarantine(entry("a", "thesis"))
    expected = (entry("b"), entry("a", reason="again"), entry("a", "thesis"))
    assert store.quarantine() == Store(store.data_dir).quarantine() == expected


def test_clearing_one_subject_or_all(store: Store) -> None:
    for subject in "aab":
        store.add_quarantine(entry(subject))
    assert store.clear_quarantine("c") == 0
    assert store.clear_quarantine("a") == 1
    assert Store(store.data_dir).quarantine() == (entry("b"),)
    assert store.clear_quarantine() == 1
    assert Store(store.data_dir).quarantine() == ()


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b"null"])
def test_a_damaged_file_is_put_aside(store: Store, content: bytes, caplog: pytest.LogCaptureFixture) -> None:
    path = store.data_dir / "quarantine.json"
    path.write_bytes(content)
    with caplog.at_level(logging.ERROR):
        assert store.quarantine() == ()
    assert "put aside" in caplog.text
    assert (store.data_dir / "quarantine.damaged").read_bytes() == content
    store.add_quarantine(entry("a"))
    assert Store(store.data_dir).quarantine() == (entry("a"),)


def test_an_entry_is_in_force_even_where_the_disk_refuses(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("not a folder")
    store = Store(tmp_path / "data")
    with pytest.raises(StorageError):
        store.add_quarantine(entry("a"))
    assert store.quarantine() == (entry("a"),)
