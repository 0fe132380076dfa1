"""`fringed plugins`: what is installed, what it registers, what is broken; and a new one.

Owns the printing; plug-ins are loaded in this process, never in the daemon.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from fringed.cli.configuration import configuration
from fringed.errors import EXIT_FAILURE, EXIT_OK, UsageError
from fringed.loading import load_plugins


def list_plugins(config: Path | None, as_json: bool) -> int:
    """Print all plug-ins; return failure where one is broken."""
    folders = configuration(config).workers.plugin_folders
    found = load_plugins([Path(folder).expanduser() for folder in folders]).plugins
    if as_json:
        click.echo(json.dumps([asdict(info) for info in found], indent=2))
    else:
        for info in found:
            click.echo(f"{info.name}  ({info.distribution} {info.version}, API {info.api_version})")
            for kind, names in sorted(info.provides.items()):
                click.echo(f"  {kind}: {', '.join(names)}")
            if info.error:
                click.echo("  BROKEN:\n" + "\n".join(f"    {line}" for line in info.error.splitlines()))
    return EXIT_FAILURE if any(info.error for info in found) else EXIT_OK


def new(folder: Path, name: str) -> None:
    """Write a plug-in package; raises UsageError where its folder is taken."""
    from fringed.scaffold import write_plugin

    target = folder / name
    if target.exists() and any(target.iterdir()):
        raise UsageError(f"{target} exists already and is not empty; choose another name or --dir")
    for path in write_plugin(target, name):
        click.echo(path)
