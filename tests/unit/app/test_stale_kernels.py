"""Compiled kernels of an older version are forgotten, others kept."""

from __future__ import annotations

from pathlib import Path

from fringed.kernels import forget_stale_kernels


def package(tmp_path: Path) -> Path:
    folder = tmp_path / "package"
    (folder / "inner" / "__pycache__").mkdir(parents=True)
    (folder / "inner" / "kernel.py").write_text("one = 1\n")
    return folder


def compiled(folder: Path) -> list[Path]:
    files = [folder / "inner" / "__pycache__" / name for name in ("kernel.f-1.py311.nbi", "kernel.f-1.py311.1.nbc")]
    for file in files:
        file.write_bytes(b"x")
    return files


def test_kernels_of_the_same_sources_stay(tmp_path: Path) -> None:
    folder = package(tmp_path)
    forget_stale_kernels(folder)
    files = compiled(folder)
    assert forget_stale_kernels(folder) == 0
    assert all(file.exists() for file in files)


def test_kernels_go_when_any_source_has_changed(tmp_path: Path) -> None:
    folder = package(tmp_path)
    forget_stale_kernels(folder)
    files = compiled(folder)
    (folder / "other.py").write_text("two = 2\n")
    assert forget_stale_kernels(folder) == 2
    assert not any(file.exists() for file in files)
    assert forget_stale_kernels(folder) == 0


def test_kernels_without_a_stamp_go(tmp_path: Path) -> None:
    folder = package(tmp_path)
    compiled(folder)
    assert forget_stale_kernels(folder) == 2


def test_a_folder_that_cannot_be_written_is_left_alone(tmp_path: Path) -> None:
    folder = package(tmp_path)
    (folder / "__pycache__").write_text("a file where a folder should be")
    assert forget_stale_kernels(folder) == 0
