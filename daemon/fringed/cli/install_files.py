"""Files that are put below a root folder all together, or not at all; and removed the same way.

Owns plan, changed files, the list of what was installed, and the way back. Knows nothing of systemd: commands are
lists of words, and who runs them is passed in.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fringed.errors import FringedError, StorageError, UsageError

MANIFEST = "/etc/fringed/installed.json"
Action = Literal["write", "replace", "same", "keep", "changed", "remove", "gone"]
Command = tuple[str, ...]
Run = Callable[[Command], None]
"""Runs a command; raises FringedError with what it said where it fails."""


@dataclass(frozen=True)
class Wanted:
    """A file by its path on the machine; `keep` is written where there is none, and is the user's from then on."""

    path: str
    content: bytes
    mode: int = 0o644
    keep: bool = False


@dataclass(frozen=True)
class Step:
    """What is to happen to one file; `wanted` is None where it is to be removed."""

    path: str
    action: Action
    wanted: Wanted | None = None


@dataclass(frozen=True)
class Back:
    """What undoes commands: `first`, while the files are still the new ones, and `last`, when they are the old ones."""

    first: Mapping[Command, Command] = field(default_factory=dict)
    last: Mapping[Command, Command] = field(default_factory=dict)


def place(root: Path, path: str) -> Path:
    """Return where a path of the machine lies below `root`; raises UsageError where links lead out of it."""
    target = root / path.lstrip("/")
    if not target.parent.resolve().is_relative_to(root.resolve()):
        raise UsageError(
            f"{target.parent} leads to {target.parent.resolve()}, out of {root}; expected a root without such links"
        )
    return target


def plan_install(root: Path, wanted: Iterable[Wanted]) -> list[Step]:
    """Return what has to be done for the wanted files; files that somebody changed are "changed"."""
    known = read_manifest(root)
    return [Step(item.path, _action(place(root, item.path), item, known), item) for item in wanted]


def plan_removal(root: Path) -> list[Step]:
    """Return what has to be removed: every file of the list that is still as it was installed."""
    steps = []
    for path, digest in read_manifest(root).items():
        target = place(root, path)
        present = _digest(target)
        action: Action = "remove" if present == digest else "changed" if os.path.lexists(target) else "gone"
        steps.append(Step(path, action))
    return steps


def manifest_of(root: Path, wanted: Iterable[Wanted]) -> Wanted:
    """Return the list of what is installed, files of an earlier installation that are still there included."""
    old = {path: digest for path, digest in read_manifest(root).items() if _digest(place(root, path)) is not None}
    new = {item.path: hashlib.sha256(item.content).hexdigest() for item in wanted if not item.keep}
    text = json.dumps({"files": old | new}, indent=2, sort_keys=True) + "\n"
    return Wanted(MANIFEST, text.encode())


def read_manifest(root: Path) -> dict[str, str]:
    """Return the paths that were installed with their digests; none where nothing was.

    Raises
    ------
    StorageError
        the list is there and cannot be read.
    """
    target = place(root, MANIFEST)
    try:
        files = json.loads(target.read_bytes())["files"]
        return {str(path): str(digest) for path, digest in files.items()}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise StorageError(
            f"the list of installed files {target} cannot be read: {error}; correct it, or remove it: files that are "
            "there then count as changed"
        ) from error


class Transaction:
    """Change files and run commands; on any failure, put everything back as it was."""

    def __init__(self, root: Path, run: Run) -> None:
        self._root, self._run = root, run
        self._undo: list[Callable[[], None]] = []

    def carry_out(
        self, steps: Sequence[Step], before: Sequence[Command], after: Sequence[Command], back: Back
    ) -> None:  # fmt: skip
        """Run `before`, change the files, run `after`.

        Raises
        ------
        StorageError
            a file could not be written or removed, or a command failed; says what was undone.
        """
        done: list[Command] = []
        try:
            for command in before:
                self._run(command)
                done.append(command)
            for step in steps:
                self._change(step)
            for command in after:
                done.append(command)  # half of what it does may be done where it fails
                self._run(command)
        except (OSError, FringedError, KeyboardInterrupt) as error:
            left = self._run_back(done, back.first) + self._restore() + self._run_back(done, back.last)
            said = error.message if isinstance(error, FringedError) else _said(error)
            state = "everything is as it was before" if not left else f"not undone: {'; '.join(left)}"
            raise StorageError(f"{said}; {state}. {_advice(error)}") from error

    def _change(self, step: Step) -> None:
        target = place(self._root, step.path)
        if step.action in ("write", "replace", "changed") and step.wanted is not None:
            self._make_folders(target.parent)
            self._remember(target)
            _write(target, step.wanted.content, step.wanted.mode)
        elif step.action in ("remove", "changed"):
            self._remember(target)
            target.unlink()

    def _make_folders(self, folder: Path) -> None:
        missing = [path for path in (folder, *folder.parents) if not path.exists()]
        for path in reversed(missing):
            path.mkdir(mode=0o755)
            self._undo.append(path.rmdir)

    def _remember(self, target: Path) -> None:
        """Note how `target` becomes what it is now."""
        if target.is_symlink():
            aim = target.readlink()
            self._undo.append(lambda: _link(target, aim))
        elif target.exists():
            content, mode = target.read_bytes(), stat.S_IMODE(target.stat().st_mode)
            self._undo.append(lambda: _write(target, content, mode))
        else:
            self._undo.append(lambda: target.unlink(missing_ok=True))

    def _restore(self) -> list[str]:
        left = []
        while self._undo:
            try:
                self._undo.pop()()
            except OSError as error:
                left.append(_said(error))
        return left

    def _run_back(self, done: Sequence[Command], back: Mapping[Command, Command]) -> list[str]:
        left = []
        for command in reversed([command for command in done if command in back]):
            try:
                self._run(back[command])
            except FringedError as error:
                left.append(error.message)
        return left


def _action(target: Path, item: Wanted, known: Mapping[str, str]) -> Action:
    if not os.path.lexists(target):
        return "write"
    if item.keep:
        return "keep"
    if target.is_dir() and not target.is_symlink():
        raise UsageError(f"{target} is a folder, where a file is to be written; move it away")
    present = _digest(target)
    if present == hashlib.sha256(item.content).hexdigest():
        return "same" if stat.S_IMODE(target.stat().st_mode) == item.mode else "replace"
    ours = item.path == MANIFEST or (present is not None and present == known.get(item.path))
    return "replace" if ours else "changed"


def _digest(target: Path) -> str | None:
    """Return a plain file's SHA-256; None where there is none, or a link."""
    try:
        return None if target.is_symlink() else hashlib.sha256(target.read_bytes()).hexdigest()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None


def _write(target: Path, content: bytes, mode: int) -> None:
    """Write a file in one step: readers see the old one or the new one, never half of it."""
    descriptor, name = tempfile.mkstemp(prefix=".fringed-", dir=target.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fchmod(descriptor, mode)
            os.fsync(descriptor)
        Path(name).replace(target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _link(target: Path, aim: Path) -> None:
    target.unlink(missing_ok=True)
    target.symlink_to(aim)


def _said(error: BaseException) -> str:
    if isinstance(error, OSError):
        return f"{error.filename or 'a file'}: {error.strerror or error}"
    return "interrupted" if isinstance(error, KeyboardInterrupt) else str(error)


def _advice(error: BaseException) -> str:
    if isinstance(error, PermissionError):
        return "Run it as root (sudo), or give --root a folder that this user may write"
    if isinstance(error, OSError) and not isinstance(error, FringedError):
        return "Make room or make the folder writable, then try again"
    return "Correct that, then try again"
