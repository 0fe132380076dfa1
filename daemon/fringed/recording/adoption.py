"""Which calibrations have been put in force, kept across restarts as one small JSON file.

Owns that file, a log that only grows; knows nothing of what a calibration is or whether it fits the rig.
"""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Literal

import msgspec

from fringed.recording.disk import make_folder, replace_file, storage_errors

log = logging.getLogger(__name__)
NAME = "calibration.json"


class Adoption(msgspec.Struct, frozen=True, kw_only=True):
    """One act: a calibration (its id, hash and rig) was put in force, or the one before it was again.

    An empty `id` means what the configuration says by itself.
    """

    action: Literal["use", "revert"]
    id: str
    hash: str = ""
    rig: str = ""
    time: str = ""
    by: str = ""


class AdoptionFile:
    """The acts, in memory and on the disk; safe to use from several threads."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._history = self._load()

    @property
    def history(self) -> tuple[Adoption, ...]:
        """Every act, the oldest first."""
        return self._history

    @property
    def stack(self) -> tuple[Adoption, ...]:
        """What was put in force and not reverted, the one in force last."""
        kept: list[Adoption] = []
        for act in self._history:
            if act.action == "use":
                kept.append(act)
            elif not act.id:
                kept.clear()
            elif kept:
                kept.pop()
        return tuple(kept)

    def append(self, act: Adoption) -> None:
        """Write an act down; raises StorageError, and nothing has changed then."""
        with self._lock:
            history = (*self._history, act)
            with storage_errors(self._path.parent):
                make_folder(self._path.parent)
                replace_file(self._path, msgspec.json.format(msgspec.json.encode(history), indent=1))
            self._history = history

    def _load(self) -> tuple[Adoption, ...]:
        try:
            return msgspec.json.decode(self._path.read_bytes(), type=tuple[Adoption, ...])
        except FileNotFoundError:
            return ()
        except ValueError as error:
            aside = self._path.with_suffix(".damaged")
            log.error("the adopted calibrations %s are damaged (%s); put aside as %s", self._path, error, aside.name)
            with storage_errors(self._path.parent):
                self._path.rename(aside)
            return ()
        except OSError as error:
            log.error("the adopted calibrations %s cannot be read: %s", self._path, error)
            return ()
