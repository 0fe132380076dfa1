"""`fringed show`: the effective configuration, or the reference of all settings.

Owns the printing.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import click

from fringed.cli.configuration import configuration
from fringed.config import effective
from fringed.config import toml_text as toml


def show_configuration(path: Path | None, settings: Iterable[str], as_json: bool) -> None:
    """Print every setting with its value in force; raises ConfigurationError."""
    values = effective(configuration(path, settings))
    if as_json:
        click.echo(json.dumps(values, indent=2))
        return
    origin = f"{path}, over the defaults" if path else "none given: the simulated rig"
    click.echo(f"# effective configuration ({origin})\n{toml.dumps(values)}", nl=False)


def show_reference() -> None:
    """Print all sections, settings, limits and meanings as Markdown."""
    from fringed.config.reference import reference

    click.echo(reference(), nl=False)
