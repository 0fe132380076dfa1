"""`fringed install-service` and `fringed uninstall-service`: unit, rules, user and folders of a station.

Owns which files go where and which commands make them known; `install_files` does it as a whole or not at all.
"""

from __future__ import annotations

import difflib
import importlib.metadata
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

import click

from fringed.cli.install_files import (
    Back,
    Command,
    Run,
    Step,
    Transaction,
    Wanted,
    manifest_of,
    place,
    plan_install,
    plan_removal,
)  # fmt: skip
from fringed.errors import EXIT_OK, NotFound, StorageError, UsageError
from fringed.finding.naming import name_rules, named_ids
from fringed.finding.reading import text

UNIT, CONFIG = "/etc/systemd/system/fringed.service", "/etc/fringed/station.toml"
SYSUSERS, TMPFILES = "/etc/sysusers.d/fringed.conf", "/etc/tmpfiles.d/fringed.conf"
RULES, NAMES = "/etc/udev/rules.d/60-fringed.rules", "/etc/udev/rules.d/61-fringed-names.rules"
_SOURCES = {UNIT: "fringed.service", RULES: "60-fringed.rules", SYSUSERS: "sysusers.d/fringed.conf",
            TMPFILES: "tmpfiles.d/fringed.conf"}  # fmt: skip
_EXEC = re.compile(r"^ExecStart=.*$", re.M)
_PLAIN_PATH = re.compile(r"/[A-Za-z0-9/._+@-]+")
_HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")
_COMMAND_TIMEOUT_S, NO_NAME = 120, "none"
STARTER = b"""\
# The station's configuration. `fringed show --reference` lists every setting, `fringed check FILE` finds mistakes,
# `fringed devices` lists what is plugged in. After a change: systemctl reload fringed
name = "station"

[camera]
driver = "none"     # none: there is no camera yet; sim: the simulated rig

[projector]
driver = "none"
"""
DAEMON_RELOAD, UDEV_RELOAD = ("systemctl", "daemon-reload"), ("udevadm", "control", "--reload")
UDEV_TRIGGER = ("udevadm", "trigger", *(f"--subsystem-match={name}" for name in ("usb", "usb-serial", "tty",
                                                                                 "video4linux")))  # fmt: skip
ENABLE = ("systemctl", "enable", "--now", "fringed.service")
DISABLE = ("systemctl", "disable", "--now", "fringed.service")
INSTALL_COMMANDS: tuple[Command, ...] = (
    ("systemd-sysusers", SYSUSERS), ("systemd-tmpfiles", "--create", TMPFILES), UDEV_RELOAD, UDEV_TRIGGER,
    DAEMON_RELOAD, ENABLE,
)  # fmt: skip
_RELOAD_AGAIN: dict[Command, Command] = {DAEMON_RELOAD: DAEMON_RELOAD, UDEV_RELOAD: UDEV_RELOAD}


def install(
    root: Path | None, ids: Mapping[str, str], program: Path | None, config: Path, *, yes: bool, force: bool
) -> int:
    """Print what would be written and run, or do it.

    Raises
    ------
    UsageError
        ids, paths or a root folder that cannot be meant, files that somebody changed, a machine without systemd.
    StorageError
        something failed half way; everything is as it was.
    """
    base = _base(root)
    ids = _with_earlier(base, ids)
    files = wanted_files(ids, _program(program, root is not None), config)
    steps = plan_install(base, [*files, manifest_of(base, files)])
    if yes:
        _refuse_changed(steps, force)
        run = _ready_to_run(root)
        if all(step.action in ("same", "keep") for step in steps[:-1]) and root is not None:
            click.echo("everything is in place already")
            return EXIT_OK
        was_there = any(step.path == UNIT and step.action != "write" for step in steps)
        back = Back({} if was_there else {ENABLE: DISABLE}, _RELOAD_AGAIN)
        Transaction(base, run).carry_out(steps, (), INSTALL_COMMANDS if root is None else (), back)
    _tell(base, steps, yes)
    _tell_commands(INSTALL_COMMANDS, yes, root)
    if not yes:
        click.echo("\nThis was a dry run: nothing was written or run. --yes does it.")
    return EXIT_OK


def uninstall(root: Path | None, *, yes: bool, force: bool) -> int:
    """Print what would be removed, or remove it; recordings, configuration and the user stay. Raises as `install`."""
    base = _base(root)
    steps = plan_removal(base)
    if not steps:
        click.echo(f"nothing was installed by `fringed install-service` below {base}")
        return EXIT_OK
    manifest = manifest_of(base, ())
    steps.append(Step(manifest.path, "remove"))
    after = (DAEMON_RELOAD, UDEV_RELOAD)
    if yes:
        _refuse_changed(steps, force)
        run = _ready_to_run(root)
        before, later = ((DISABLE,), after) if root is None else ((), ())
        Transaction(base, run).carry_out(steps, before, later, Back(last=_RELOAD_AGAIN | {DISABLE: ENABLE}))
    _tell_commands((DISABLE,), yes, root)
    _tell(base, steps, yes)
    _tell_commands(after, yes, root)
    click.echo(f"kept: {CONFIG}, the recordings in /var/lib/fringed, the user fringed (sudo userdel fringed)")
    if not yes:
        click.echo("\nThis was a dry run: nothing was removed or run. --yes does it.")
    return EXIT_OK


def wanted_files(ids: Mapping[str, str], program: Path, config: Path) -> list[Wanted]:
    """Return every file of an installation but the list of them."""
    for path in (program, config):
        if not _PLAIN_PATH.fullmatch(str(path)):
            raise UsageError(f"{path} cannot stand in a unit; expected an absolute path of letters, digits and /._+@-")
    if any(config.is_relative_to(folder) for folder in _HIDDEN):
        raise UsageError(
            f"the service cannot see {config}: expected one outside {', '.join(_HIDDEN)}, such as {CONFIG}"
        )
    folder = service_files()
    files = {path: (folder / source).read_bytes() for path, source in _SOURCES.items()}
    unit = files[UNIT].decode()
    files[UNIT] = _EXEC.sub(f"ExecStart={program} run --config {config}", unit).encode()
    if ids:
        files[NAMES] = name_rules(ids).encode()
    return [*(Wanted(path, content) for path, content in files.items()),
            Wanted(str(config), STARTER, 0o640, keep=True)]  # fmt: skip


def service_files() -> Path:
    """Return the folder of unit and rules: beside a checkout's sources, or where the distribution put it.

    Raises
    ------
    NotFound
        it is in neither place.
    """
    here, shared = Path(__file__).resolve(), Path("share", "fringed", "udev")
    places = [here.parents[3] / "udev", here.parents[1] / "udev", Path(sys.prefix) / shared, here.parents[2] / shared]
    try:
        listed = importlib.metadata.files("fringed") or []
    except importlib.metadata.PackageNotFoundError:
        listed = []
    places += [Path(str(file.locate())).resolve().parent for file in listed if file.name == "fringed.service"]
    for folder in places:
        if (folder / "fringed.service").is_file() and (folder / "60-fringed.rules").is_file():
            return folder
    tried = ", ".join(dict.fromkeys(map(str, places)))
    raise NotFound(f"the files of the service are in none of {tried}; install fringed again: pip install fringed")


def _with_earlier(root: Path, ids: Mapping[str, str]) -> dict[str, str]:
    """Return the ids asked for, and those of an earlier installation for roles that are not; "none" takes one away."""
    if not ids:
        return {}  # the names that are there stay as they are
    earlier = named_ids(text(place(root, NAMES)))
    return {role: name for role, name in (earlier | dict(ids)).items() if name != NO_NAME}


def _base(root: Path | None) -> Path:
    if root is None:
        return Path("/")
    if not root.is_dir():
        raise UsageError(f"--root {root}: no such folder; make it, it stands for / of the machine to be")
    return root.resolve()


def _program(given: Path | None, elsewhere: bool) -> Path:
    """Return the program that the unit starts; refuse one that the service could not see."""
    program = given if given is not None else Path(sys.prefix) / "bin" / "fringed"
    if given is not None and elsewhere:
        return program
    if not program.exists():
        raise UsageError(f"there is no program {program}; give --program the path of fringed")
    for path in (program, program.resolve(), _interpreter(program)):
        for folder in _HIDDEN:
            if path.is_relative_to(folder):
                raise UsageError(
                    f"the service cannot see {path}, since its unit hides {folder}; install fringed where all may read "
                    "it, with a Python that is there too (python3 -m venv /opt/fringed, /opt/fringed/bin/pip install "
                    "fringed, sudo /opt/fringed/bin/fringed install-service), or name it by --program"
                )
    return program


def _interpreter(program: Path) -> Path:
    try:
        first = program.read_bytes()[:256].partition(b"\n")[0]
    except OSError:
        return program
    return Path(first[2:].decode("utf-8", "replace").split()[0]).resolve() if first.startswith(b"#!/") else program


def _ready_to_run(root: Path | None) -> Run:
    """Return what runs commands; with a root folder none is run. Raises UsageError where it cannot work."""
    if root is not None:
        return lambda command: None
    if os.geteuid() != 0:
        raise UsageError(f"this needs root; run: sudo {shlex.join([sys.argv[0], *sys.argv[1:]])}")
    if not Path("/run/systemd/system").is_dir():
        raise UsageError("systemd does not run on this machine; start `fringed run` by other means, or use --root DIR")
    return run_command


def run_command(command: Command) -> None:
    """Run a command of the system; raises StorageError with what it said."""
    words = shlex.join(command)
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_COMMAND_TIMEOUT_S)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise StorageError(f"`{words}` could not be run: {error}") from error
    if done.returncode:
        said = " ".join((done.stderr or done.stdout).split())
        raise StorageError(f"`{words}` failed with code {done.returncode}: {said or 'it said nothing'}")


def _refuse_changed(steps: Iterable[Step], force: bool) -> None:
    changed = [step.path for step in steps if step.action == "changed"]
    if changed and not force:
        raise UsageError(
            f"{', '.join(changed)}: not as fringed installed it; a run without --yes shows the difference; "
            "keep what you need in a drop-in (systemctl edit fringed) or in rules of your own, then add --force"
        )


def _tell(root: Path, steps: Iterable[Step], done: bool) -> None:
    words = {"same": "as it is", "keep": "yours", "gone": "is gone", "changed": "forced" if done else "CHANGED"}
    for step in steps:
        size = f"  ({step.wanted.mode:04o}, {len(step.wanted.content)} bytes)" if step.wanted else ""
        click.echo(f"{words.get(step.action, step.action):8} {step.path}{size}")
        if not done and step.wanted is not None and step.action in ("write", "replace", "changed"):
            for line in _content(place(root, step.path), step.wanted):
                click.echo(f"       | {line}")


def _content(target: Path, wanted: Wanted) -> list[str]:
    """Return a new file's lines, or how they differ from those that are there."""
    new = wanted.content.decode().splitlines()
    try:
        old = target.read_bytes().decode("utf-8", "replace").splitlines()
    except OSError:
        return new
    return list(difflib.unified_diff(old, new, "there", "new", lineterm="", n=1))


def _tell_commands(commands: Iterable[Command], done: bool, root: Path | None) -> None:
    word = "run" if root is None else "not run"
    for command in commands:
        click.echo(f"{word:8} {shlex.join(command)}" + ("" if root is None else "  (on the machine itself)"))
