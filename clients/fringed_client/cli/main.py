"""The entry point `fringe`: the commands, exit codes, and what becomes of errors.

Owns the table of commands; each is imported when it is called, so that help and completion are quick.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import sys
from collections.abc import Sequence
from typing import Any

import click

from fringed import errors

COMMANDS = {
    "status": ("live", "How the station is: devices, workers, lease, quarantine."),
    "watch": ("live", "Follow the stream: rates, drops, latest values."),
    "scan": ("scanning", "Take sets, decode them, and get a range image."),
    "exposure": ("exposure", "Suggest exposures for what stands before the rig."),
    "latency": ("scanning", "Measure the display-to-camera delay."),
    "tone": ("tone", "Measure, verify and show the projector's tone curve."),
    "board": ("board", "Make a calibration board to print, at exact scale."),
    "calibrate": ("calibrate", "Calibrate the rig from poses of a board, or a folder of images."),
    "calibration": ("calibration", "List, show, compare and choose calibrations."),
    "verify": ("verify", "Measure a known artefact: does the calibration hold?"),
    "list": ("records", "List what is recorded, newest first."),
    "get": ("records", "Fetch one recording: its figures, or a file of it."),
    "export": ("records", "Write products as PLY, PCD, XYZ, STL, OBJ, TIFF or NPZ."),
    "view": ("records", "Draw pictures of recordings or capture folders."),
    "process": ("offline", "Run a pipeline on recordings or on a capture folder."),
    "simulate": ("offline", "Write a capture folder with its truth."),
    "register": ("offline", "Bring range images together in one model."),
    "patterns": ("patterns", "Show what would be projected; find the best frequencies."),
    "demo": ("demo", "Calibrate a simulated rig, scan a face and a mould, and report."),
    "lease": ("operate", "Hold the rig, show or break a lease."),
    "device": ("device", "Read, set and watch a device's own settings."),
    "quarantine": ("operate", "Show or clear what is not tried again."),
    "plugins": ("operate", "List the station's plug-ins, and what is broken."),
    "simulated": ("operate", "Order scenes and faults of a simulated rig."),
    "completion": ("completion", "Print a shell's completion script."),
}

EXIT_CODES = f"""\b
Exit codes:
  {errors.EXIT_OK}    done
  {errors.EXIT_FAILURE}    failed: storage, a plug-in, bad data
  {errors.EXIT_USAGE}    usage or configuration: nothing was tried
  {errors.EXIT_NO_STATION}    no station, or the connection broke
  {errors.EXIT_HARDWARE}    hardware: a device, or a lease that somebody else holds
  {errors.EXIT_QUALITY}    quality gate: measured, and not good enough
  {errors.EXIT_INTERRUPTED}  interrupted
"""


class LazyGroup(click.Group):
    """A group whose commands are imported when they are used; plug-ins' commands join it."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*COMMANDS, *(name for name in _plugin_commands() if name not in COMMANDS)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in COMMANDS:
            module = importlib.import_module(f"fringed_client.cli.{COMMANDS[cmd_name][0]}")
            command: click.Command = getattr(module, f"{cmd_name}_command")
            return command
        return _plugin_commands(cmd_name).get(cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows = [(name, text) for name, (_, text) in COMMANDS.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)
        found = {name: command for name, command in _plugin_commands().items() if name not in COMMANDS}
        if found:
            with formatter.section("Commands of plug-ins"):
                formatter.write_dl([(name, command.get_short_help_str()) for name, command in found.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            from difflib import get_close_matches

            close = get_close_matches(args[0], self.list_commands(ctx), 1)
            hint = f" Did you mean {close[0]!r}?" if close else ""
            raise click.UsageError(f"No such command {args[0]!r}.{hint}", ctx) from error


def _plugin_commands(wanted: str = "") -> dict[str, click.Command]:
    """Return the commands of plug-ins; they are loaded only where others than our own are installed."""
    own = "fringed"
    entries = importlib.metadata.entry_points(group="fringed.plugins")
    if all(entry.dist is not None and entry.dist.name == own for entry in entries):
        return {}
    from fringed.loading import load_plugins

    provided = load_plugins().provided.get("command", {})
    return {name: command for name, command in provided.items() if not wanted or name == wanted}


@click.group(cls=LazyGroup, epilog=EXIT_CODES, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="fringed", prog_name="fringe", message="%(prog)s %(version)s")
def cli() -> None:
    """Talk to a fringe projection station.

    The station is the one of this machine's runtime folder, $FRINGED_STATION, or --station. Offline work
    (process, simulate, register, export, view) starts a private one where none is running; scan never does.
    """


def main(args: Sequence[str] | None = None) -> None:
    """Run `fringe` and exit with its code; no traceback reaches the user without --debug."""
    given = list(sys.argv[1:] if args is None else args)
    code = run(given)
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _forget_stdout()
    sys.exit(code)


def run(given: Sequence[str]) -> int:
    """Run one command line and return its exit code."""
    stdout = sys.stdout
    try:
        code = cli.main(args=list(given), prog_name="fringe", standalone_mode=False)
        return code if isinstance(code, int) else errors.EXIT_OK
    except click.exceptions.Exit as stop:
        return int(stop.exit_code)
    except click.ClickException as error:
        if "--json" in given:
            _tell(given, "UsageError", error.format_message(), error.exit_code)
        else:
            error.show()
        return errors.EXIT_USAGE
    except (KeyboardInterrupt, click.Abort):
        _tell(given, "Cancelled", "interrupted", errors.EXIT_INTERRUPTED)
        return errors.EXIT_INTERRUPTED
    except BrokenPipeError:
        _forget_stdout()
        return errors.EXIT_OK
    except SystemExit as stop:  # click wraps stdout and ends so where whoever read it has gone: nothing is left to say
        if sys.stdout is stdout:
            return stop.code if isinstance(stop.code, int) else errors.EXIT_FAILURE
        _forget_stdout()
        return errors.EXIT_OK
    except Exception as error:
        if "--debug" in given:
            raise
        code = error.exit_code if isinstance(error, errors.FringedError) else errors.EXIT_FAILURE
        text = str(error).replace("(lease.break)", "(`fringe lease break --reason TEXT`)")
        _tell(given, type(error).__name__, text, code)
        return code


def _forget_stdout() -> None:
    """Send what is still to be written nowhere, so that nothing complains when the interpreter ends."""
    import os

    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)


def _tell(given: Sequence[str], name: str, text: str, code: int) -> None:
    click.echo(f"fringe: {text or name}", err=True)
    if "--json" in given:
        import json

        document: dict[str, Any] = {"error": {"code": name, "message": text, "exit_code": code}}
        click.echo(json.dumps(document, indent=2))


if __name__ == "__main__":
    main()
