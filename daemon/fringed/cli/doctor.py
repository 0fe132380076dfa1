"""`fringed doctor`: what this machine lacks, and what to do about it.

Owns the list of checks; each yields findings and changes nothing. Devices, displays and the service have their own.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import click

from fringed.cli.configuration import configuration
from fringed.cli.doctor_configured import configured_findings, panel_px
from fringed.cli.doctor_devices import device_findings
from fringed.cli.doctor_displays import display_findings
from fringed.cli.doctor_findings import Finding, Findings
from fringed.cli.doctor_service import service_findings
from fringed.config import StationConfig
from fringed.config.paths import data_dir, runtime_dir
from fringed.errors import EXIT_FAILURE, EXIT_OK, FringedError
from fringed.finding import this_machine

MODULES = (
    "numpy",
    "scipy",
    "cv2",
    "numba",
    "zmq",
    "h5py",
    "msgspec",
    "pluggy",
    "click",
    "rich",
    "xxhash",
    "matplotlib",
)
DEVICE_MODULES = {"pygame": "the projector's window", "serial": "serial ports", "usb": "USB cameras"}
SET_MB = 17.4
_ROOM_MB, _SHM_MB = 2000.0, 64.0
_COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}


def examine(path: Path | None, as_json: bool) -> int:
    """Print every finding; return failure where one failed."""
    config = configuration(path)
    machine = this_machine()
    checks: tuple[Callable[[], Findings], ...] = (
        _python, _packages, lambda: _data(config), lambda: _runtime(config), _shared_memory, _cores, _numba_cache,
        lambda: device_findings(machine), lambda: display_findings(machine, panel_px(config.projector.options)),
        lambda: configured_findings(config, machine), lambda: service_findings(machine), _folders,
    )  # fmt: skip
    found = [finding for check in checks for finding in check()]
    if as_json:
        click.echo(json.dumps([asdict(finding) for finding in found], indent=2))
    else:
        for finding in found:
            level = click.style(f"{finding.level:4}", fg=_COLOURS[finding.level])
            todo = f"\n      -> {finding.do}" if finding.do else ""
            click.echo(f"{level}  {finding.what}: {finding.found}{todo}")
    return EXIT_FAILURE if any(finding.level == "fail" for finding in found) else EXIT_OK


def _python() -> Findings:
    yield Finding("ok", "python", f"{'.'.join(map(str, sys.version_info[:3]))}, {sys.executable}")


def _packages() -> Findings:
    missing = [name for name in MODULES if importlib.util.find_spec(name) is None]
    if missing:
        yield Finding(
            "fail", "packages", f"missing: {', '.join(missing)}", "install fringed again: pip install fringed"
        )
    else:
        yield Finding("ok", "packages", f"all {len(MODULES)} are there")
    for name, purpose in DEVICE_MODULES.items():
        if importlib.util.find_spec(name) is None:
            yield Finding("warn", f"package {name}", "missing", f"needed for {purpose}: pip install fringed again")
    try:
        yield Finding("ok", "fringed", importlib.metadata.version("fringed"))
    except importlib.metadata.PackageNotFoundError:
        do = "install it (pip install -e .), or the built-in plug-ins are not found"
        yield Finding("fail", "fringed", "not installed as a distribution", do)


def _data(config: StationConfig) -> Findings:
    folder = data_dir(config.data_dir).absolute()
    existing = next((path for path in (folder, *folder.parents) if path.exists()), Path("/"))
    try:
        with tempfile.TemporaryFile(dir=existing) as probe:
            probe.write(b"writable?")
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as error:
        yield Finding("fail", "data folder", f"{folder}: {error.strerror}", "set data_dir, or FRINGED_DATA_DIR")
        return
    free_mb = shutil.disk_usage(existing).free / 1e6
    text = f"{folder}: writable, {free_mb:.0f} MB free, about {free_mb / SET_MB:.0f} frame sets"
    if free_mb < _ROOM_MB:
        yield Finding("warn", "data folder", text, f"make room: {_ROOM_MB:.0f} MB or more, or set data_dir elsewhere")
    else:
        yield Finding("ok", "data folder", text)


def _runtime(config: StationConfig) -> Findings:
    from fringed.serving.runtime import RuntimeLock, lock_holder

    folder = runtime_dir(config.runtime_dir).absolute()
    holder = lock_holder(folder)
    if holder is not None:
        yield Finding("ok", "runtime folder", f"{folder}: a station serves there, process {holder}")
        return
    try:
        lock = RuntimeLock(folder)
        lock.acquire()
        lock.release()
    except FringedError as error:
        yield Finding("fail", "runtime folder", str(error), "see the message")
    else:
        yield Finding("ok", "runtime folder", f"{folder}: usable, no station serves there")


def _shared_memory() -> Findings:
    try:
        free_mb = shutil.disk_usage("/dev/shm").free / 1e6
    except OSError as error:
        yield Finding("warn", "/dev/shm", str(error), "mount a tmpfs there")
        return
    low = free_mb < _SHM_MB
    yield Finding("warn" if low else "ok", "/dev/shm", f"{free_mb:.0f} MB free", "give it 64 MB or more" if low else "")


def _cores() -> Findings:
    cores = len(os.sched_getaffinity(0))
    do = "processing then slows acquisition down; 2 or more are better" if cores < 2 else ""
    yield Finding("ok" if cores >= 2 else "warn", "cores", str(cores), do)


def _numba_cache() -> Findings:
    spec = importlib.util.find_spec("fringed_plugins")
    chosen = os.environ.get("NUMBA_CACHE_DIR", "")
    folder = Path(chosen) if chosen else Path(str(spec.origin)).parent if spec and spec.origin else Path()
    existing = next((path for path in (folder, *folder.parents) if path.exists()), Path("/"))
    if os.access(existing, os.W_OK):
        yield Finding("ok", "numba cache", f"{folder}: writable")
    else:
        do = "set NUMBA_CACHE_DIR to a folder of yours, or every start compiles again"
        yield Finding("warn", "numba cache", f"{folder}: not writable", do)


def _folders() -> Findings:
    for name in ("XDG_RUNTIME_DIR", "XDG_DATA_HOME"):
        value = os.environ.get(name)
        if value and not os.access(value, os.W_OK):
            yield Finding("warn", name, f"{value}: not writable", f"unset {name}, or have it made")
        else:
            yield Finding("ok", name, value or "not set; the default is used")
