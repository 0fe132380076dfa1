"""`fringed run`: serve a station in this process until a signal ends it.

Owns signals and the exit code.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from types import FrameType
from typing import Any

from fringed import logs
from fringed.cli.configuration import configuration
from fringed.errors import EXIT_INTERRUPTED, EXIT_OK

_log = logging.getLogger(__name__)
_KEEP_MB = 256  # a set, its range image and its phase map, on their ways


def serve(path: Path | None, settings: Iterable[str]) -> int:
    """Build and run the station; return the exit code. Raises what `app.build` raises."""
    load_numpy_with_one_thread()
    settings = tuple(settings)
    path = path.absolute() if path else None

    def read_config() -> Any:
        return configuration(path, settings)

    config = read_config()
    logs.set_up(config.log)
    from fringed.workers.memory import keep_freed_pages

    keep_freed_pages(_KEEP_MB)
    from fringed.app import build

    station = build(config, path, read_config)
    if path is None:
        _log.warning("no configuration is given: the rig is SIMULATED")
    elif config.camera.driver in ("sim", "replay"):
        _log.warning(
            "the configuration asks for a %s rig", "SIMULATED" if config.camera.driver == "sim" else "REPLAYED"
        )
    _install(station.reactor_post, station.stop, station.reload_quietly)
    station.run()
    if threading.active_count() > 1:  # a driver or a compiler that does not end must not keep the process
        logging.shutdown()
        os._exit(EXIT_OK)
    return EXIT_OK


def load_numpy_with_one_thread() -> None:
    """Load NumPy so that its BLAS starts no threads here; workers, which inherit the environment, are not touched.

    The check of a set multiplies 4 by 90,000 numbers: 0.1 ms on one thread, but 5 to 12 ms where OpenBLAS shares it
    with another one that has to wait for a core, because a worker decodes. BLAS reads the environment as it is loaded.
    """
    names = [name for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS") if name not in os.environ]
    os.environ.update(dict.fromkeys(names, "1"))
    import numpy  # noqa: F401

    for name in names:
        del os.environ[name]


def _install(
    post: Callable[[Callable[[], Any]], None], stop: Callable[[str], None], reload: Callable[[], None]
) -> None:
    """Let signals do their work in the loop; a second SIGINT ends the process at once."""
    interrupts = 0

    def on_signal(number: int, _: FrameType | None) -> None:
        nonlocal interrupts
        if number == signal.SIGHUP:
            post(reload)
            return
        interrupts += number == signal.SIGINT
        if interrupts > 1:
            os._exit(EXIT_INTERRUPTED)
        post(lambda: stop(f"{signal.Signals(number).name} received"))

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, on_signal)
