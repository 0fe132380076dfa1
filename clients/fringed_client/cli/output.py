"""What a person reads on the terminal, what a program reads on stdout, and progress on stderr.

Owns rich; knows no station.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from fringed.messages import ScanState


def plain(value: Any) -> Any:
    """Return dataclasses, structs and mappings as what JSON can hold."""
    import msgspec

    return msgspec.to_builtins(value, enc_hook=str)


def emit(value: Any) -> None:
    """Print one JSON document."""
    click.echo(json.dumps(plain(value), indent=2, ensure_ascii=False))


def say(text: str) -> None:
    """Tell a person something on stderr."""
    click.echo(f"fringe: {text}", err=True)


def console(error: bool = False) -> Console:
    """Return rich's console for stdout or stderr."""
    from rich.console import Console

    return Console(stderr=error, highlight=False)


def table(columns: Iterable[str], rows: Iterable[Iterable[Any]], title: str = "") -> None:
    """Print a table on stdout; tabs between the cells where nobody looks."""
    if not sys.stdout.isatty():
        for row in (columns, *rows):
            click.echo("\t".join(str(cell) for cell in row))
        return
    from rich import box
    from rich.table import Table

    cells = [[str(cell) for cell in row] for row in rows]
    drawn = Table(title=title or None, box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False)
    for number, name in enumerate(columns):
        widest = max((len(row[0]) for row in cells), default=0)
        drawn.add_column(name, no_wrap=number == 0, min_width=widest if number == 0 else None)  # ids stay whole
    for row in cells:
        drawn.add_row(*row)
    console().print(drawn)


def facts(rows: Mapping[str, Any]) -> None:
    """Print names and values."""
    width = max((len(name) for name in rows), default=0)
    for name, value in rows.items():
        lines = str(value).splitlines() or [""]
        click.echo(f"{click.style(name.ljust(width), dim=True)}  {lines[0]}")
        for line in lines[1:]:
            click.echo(f"{'':{width}}  {line}")


class Steps:
    """Progress of several things: bars on a terminal, a line for each change elsewhere."""

    def __init__(self, bars: Progress | None) -> None:
        self._bars = bars
        self._tasks: dict[str, Any] = {}
        self._last: dict[str, str] = {}

    def show(self, name: str, fraction: float, text: str = "", phase: str = "") -> None:
        """Tell how far `name` is, 0 to 1."""
        if self._bars is None:
            line = phase or text
            if line and self._last.get(name) != line:
                self._last[name] = line
                click.echo(f"{name}: {line}", err=True)
            return
        if name not in self._tasks:
            self._tasks[name] = self._bars.add_task(name, total=1.0, text="")
        self._bars.update(self._tasks[name], completed=fraction, text=text)

    def scan(self, name: str) -> Any:
        """Return a callback that shows ScanStates under `name`."""

        def on_progress(state: ScanState) -> None:
            fraction = 1.0 if state.state == "done" else state.progress
            again = f", {state.retakes} retaken" if state.retakes else ""
            self.show(name, fraction, f"{state.text or state.state}{again}", state.state)

        return on_progress


@contextmanager
def steps() -> Iterator[Steps]:
    """Yield a progress display on stderr."""
    if not sys.stderr.isatty():
        yield Steps(None)
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=32), TimeElapsedColumn(),
        TextColumn("[dim]{task.fields[text]}"),
    )  # fmt: skip
    with Progress(*columns, console=console(error=True), transient=False) as bars:
        yield Steps(bars)
