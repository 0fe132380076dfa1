"""The command line of `fringed`: options, help, errors as one message, exit codes.

Owns what people type; each command's work is in its own module, imported only when it is asked for.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from fringed import __version__
from fringed.errors import EXIT_FAILURE, EXIT_INTERRUPTED, FringedError

EXIT_CODES = """
\b
Exit codes: 0 done, 1 failure, 2 usage or configuration, 3 the station cannot be had (another one runs there),
4 hardware, 5 quality gate, 130 interrupted.
"""
_CONFIG = click.option(
    "--config", "config", type=click.Path(path_type=Path), metavar="FILE",
    help="The station's configuration. Without one: the simulated rig.",
)  # fmt: skip
_SET = click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE",
    help="Change one setting, such as workers.count=1; the value as TOML, or text. May be repeated.",
)  # fmt: skip
_JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
_LOOK = click.option(
    "--root", type=click.Path(path_type=Path), metavar="DIR", help="Look at a copy of a machine's sys, dev and proc."
)
_ROOT = click.option(
    "--root", type=click.Path(path_type=Path), metavar="DIR",
    help="Install below DIR instead of /; no command is run. For packages and images.",
)  # fmt: skip


@click.group(epilog=EXIT_CODES, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="fringed")
@click.option("--debug", is_flag=True, help="Show the trace of an error.")
def cli(debug: bool) -> None:
    """Run a fringe projection station, and look after it."""


@cli.command()
@_CONFIG
@_SET
def run(config: Path | None, settings: tuple[str, ...]) -> None:
    """Serve a station until SIGTERM or SIGINT; SIGHUP reads the configuration again."""
    from fringed.cli.run import serve

    sys.exit(serve(config, settings))


@cli.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--no-plugins", is_flag=True, help="Do not load plug-ins to check names and parameters of stages.")
@_JSON
def check(file: Path, no_plugins: bool, as_json: bool) -> None:
    """Check a configuration; list every problem with its path, the value and what is allowed."""
    from fringed.cli.check import check_file

    sys.exit(check_file(file, plugins=not no_plugins, as_json=as_json))


@cli.command()
@_CONFIG
@_SET
@_JSON
@click.option("--reference", is_flag=True, help="Print every setting with its limits and meaning instead.")
def show(config: Path | None, settings: tuple[str, ...], as_json: bool, reference: bool) -> None:
    """Print the effective configuration, every default written out."""
    from fringed.cli.show import show_configuration, show_reference

    if reference:
        show_reference()
    else:
        show_configuration(config, settings, as_json)


@cli.group(invoke_without_command=True)
@_CONFIG
@_JSON
@click.pass_context
def plugins(context: click.Context, config: Path | None, as_json: bool) -> None:
    """List plug-ins: distribution, version, what they register, errors."""
    if context.invoked_subcommand is None:
        from fringed.cli.plugins import list_plugins

        sys.exit(list_plugins(config, as_json))


@plugins.command("new")
@click.argument("name")
@click.option("--dir", "folder", type=click.Path(path_type=Path), default=Path(), help="Where to put its folder.")
def new_plugin(name: str, folder: Path) -> None:
    """Write a working plug-in package with its test."""
    from fringed.cli.plugins import new

    new(folder, name)


@cli.command()
@_CONFIG
@_JSON
def doctor(config: Path | None, as_json: bool) -> None:
    """Check this machine and say what to do."""
    from fringed.cli.doctor import examine

    sys.exit(examine(config, as_json))


@cli.command()
@_JSON
@_LOOK
def devices(as_json: bool, root: Path | None) -> None:
    """List serial ports, displays and cameras, with names and ids that stay."""
    from fringed.cli.devices import list_devices

    sys.exit(list_devices(root, as_json))


@cli.command("install-service")
@click.option("--yes", is_flag=True, help="Write and run; without it, only say what would be.")
@click.option("--force", is_flag=True, help="Overwrite files that somebody changed.")
@_ROOT
@click.option("--projector", metavar="ID", help="Id of the projector's adapter: /dev/fringed/projector; none: no name.")
@click.option("--camera", metavar="ID", help="Id of the camera or its adapter: /dev/fringed/camera; none: no name.")
@click.option(
    "--program", type=click.Path(path_type=Path), metavar="FILE", help="The fringed to start. Without it: this one."
)
@click.option(
    "--config", type=click.Path(path_type=Path), default=Path("/etc/fringed/station.toml"), show_default=True,
    metavar="FILE", help="The station's configuration; one without devices is written where there is none.",
)  # fmt: skip
def install_service(
    *, yes: bool, force: bool, root: Path | None, projector: str | None, camera: str | None, program: Path | None,
    config: Path,
) -> None:  # fmt: skip
    """Install the station as a service: unit, user, device rules. A dry run without --yes."""
    from fringed.cli.install_service import install

    ids = {role: name for role, name in (("projector", projector), ("camera", camera)) if name is not None}
    sys.exit(install(root, ids, program, config, yes=yes, force=force))


@cli.command("uninstall-service")
@click.option("--yes", is_flag=True, help="Remove and run; without it, only say what would be.")
@click.option("--force", is_flag=True, help="Remove files that somebody changed.")
@_ROOT
def uninstall_service(yes: bool, force: bool, root: Path | None) -> None:
    """Remove what install-service installed; recordings and configuration stay. A dry run without --yes."""
    from fringed.cli.install_service import uninstall

    sys.exit(uninstall(root, yes=yes, force=force))


@cli.group()
def keys() -> None:
    """Keys for serving other machines over TCP."""


@keys.command("new")
@click.argument("name")
@click.option(
    "--dir", "folder", type=click.Path(path_type=Path), default=Path("~/.config/fringed/keys"), show_default=True,
    help="The folder that tcp.keys_dir names.",
)  # fmt: skip
def new_keys(name: str, folder: Path) -> None:
    """Make keys: NAME is `server`, or that of a client."""
    from fringed.serving.keys import new_keys as make

    for path in make(folder.expanduser(), name):
        click.echo(path)


def main(arguments: list[str] | None = None) -> None:
    """Run a command; errors end as one message and an exit code."""
    given = sys.argv[1:] if arguments is None else arguments
    try:
        cli.main(given, prog_name="fringed", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        sys.exit(error.exit_code)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        sys.exit(EXIT_INTERRUPTED)
    except FringedError as error:
        _report(error, "--debug" in given)
        sys.exit(error.exit_code)
    except Exception as error:  # noqa: BLE001  the top of main: a mistake of ours is one message too
        _report(error, "--debug" in given)
        click.echo("This is a mistake in fringed; `fringed --debug` shows where.", err=True)
        sys.exit(EXIT_FAILURE)


def _report(error: BaseException, debug: bool) -> Any:
    if debug:
        import traceback

        traceback.print_exception(error)
    click.echo(f"fringed: {error}", err=True)
