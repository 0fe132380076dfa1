"""Kernels whose compiled code is kept on disk, and is made anew when any module that goes into it has changed.

Owns one decorator. Numba keeps compiled code by the text of the file that a kernel is in; what the kernel calls in
other modules is inlined, and a change there would go unnoticed, after an upgrade too.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from numba import njit


def kept(*modules: ModuleType, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator: `njit(cache=True, **options)`, kept for these texts of the modules that it calls into.

    The texts' digest becomes part of the kernel's name, and with it of the name of the file on disk.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        digest = hashlib.sha256()
        for module in modules:
            digest.update(Path(inspect.getfile(module)).read_bytes())
        function.__qualname__ = f"{function.__qualname__}_{digest.hexdigest()[:12]}"
        return njit(cache=True, **options)(function)

    return decorate
