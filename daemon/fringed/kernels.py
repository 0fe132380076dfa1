"""Compiled kernels on disk: forget those of an older version of a package.

Owns one check. Numba keeps compiled code beside the sources, or in the user's cache, and reads its list of it by
unpickling: where a class that a kernel takes has gone since, that ends in an AttributeError before any time stamp is
looked at. An upgrade leaves these files in place, since no installer knows them.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

_STAMP = "kernels.stamp"


def forget_stale_kernels(package: Path) -> int:
    """Remove the compiled kernels below the folder `package` where its sources are not those they were made from.

    Returns how many files went. A folder that cannot be written is left alone: nothing is kept there either.
    """
    digest = hashlib.sha256()
    for source in sorted(package.rglob("*.py")):
        facts = source.stat()
        digest.update(f"{source.relative_to(package)} {facts.st_size} {facts.st_mtime_ns}\n".encode())
    stamp = package / "__pycache__" / _STAMP
    wanted = digest.hexdigest()
    with contextlib.suppress(OSError):
        if stamp.read_text() == wanted:
            return 0
    removed = 0
    with contextlib.suppress(OSError):
        for kept in (*package.rglob("__pycache__/*.nbi"), *package.rglob("__pycache__/*.nbc")):
            with contextlib.suppress(FileNotFoundError):  # another process forgets them, too
                kept.unlink()
                removed += 1
        aside = stamp.with_name(f"{_STAMP}.{os.getpid()}")
        aside.parent.mkdir(exist_ok=True)
        aside.write_text(wanted)
        aside.replace(stamp)
    return removed
