"""`fringe status` and `fringe watch`: the station as it is, and as it goes."""

from __future__ import annotations

import sys
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import click

from fringed.errors import EXIT_INTERRUPTED, EXIT_OK
from fringed_client.cli import output
from fringed_client.cli.options import Options, common

if TYPE_CHECKING:
    from fringed.messages import StationState
    from fringed_client.protocol.messages import Message
    from fringed_client.subscription import Subscription

WINDOW_S = 5.0


@click.command("status")
@common
def status_command(options: Options) -> None:
    """Show how the station is: devices, workers, lease, quarantine."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        state = station.status()
    if options.json:
        output.emit(state)
        return
    output.facts(_rows(state))


def _rows(state: StationState) -> dict[str, Any]:
    marks = [text for mark, text in ((state.simulated, "SIMULATED"), (state.replayed, "REPLAYED")) if mark]
    lease = state.lease
    rows: dict[str, Any] = {
        "station": " ".join((f"{state.name}, fringed {state.version}, pid {state.pid}", *marks)),
        "up": f"{state.uptime_s:.0f} s, {state.memory_mb:.0f} MB",
        "rig": state.rig or "unnamed",
        "calibration": f"{state.calibration or 'none'} ({state.calibration_origin})",
        "camera": _device(state.camera), "projector": _device(state.projector),
        "lease": f"{lease.holder} holds the {lease.scope}, {lease.expires_in_s:.0f} s left" if lease else "free",
        "scan": state.scan or "none",
        "pipelines": ", ".join(state.pipelines),
        "workers": "\n".join(
            f"{w.worker} pid {w.pid}: {w.state} {w.job}, {w.memory_mb:.0f} MB, restarted {w.restarts} x"
            for w in state.workers
        ) or "none",
        "quarantine": "\n".join(
            f"{q.subject} with {q.pipeline}, {q.attempts} attempts: {q.reason}" for q in state.quarantine
        ) or "empty",
        "counters": ", ".join(f"{name} {count}" for name, count in state.counters.items()) or "none",
        "data": f"{state.data_dir}, {state.free_disk_mb:,.0f} MB free",
        "configuration": state.config_path or "none",
    }  # fmt: skip
    return rows


def _device(device: Any) -> str:
    detail = f": {device.detail}" if device.detail else ""
    return f"{device.state} ({device.driver}{', ' + device.identity if device.identity else ''}){detail}"


@dataclass
class _Row:
    """One topic while it is watched."""

    count: int = 0
    missed: int = 0
    seq: int = 0
    text: str = ""
    recent: deque[tuple[float, int]] = field(default_factory=deque)

    def add(self, message: Message, now: float) -> None:
        self.count, self.missed, self.seq = self.count + 1, self.missed + message.missed, message.seq
        self.text = one_line(message.content)
        self.recent.append((now, message.nbytes))

    def rates(self, now: float) -> tuple[float, float]:
        """Return messages and megabytes a second."""
        while self.recent and self.recent[0][0] < now - WINDOW_S:
            self.recent.popleft()
        return len(self.recent) / WINDOW_S, sum(n for _, n in self.recent) / WINDOW_S / 1e6


def one_line(content: Any) -> str:
    """Return the latest value of a topic in a few words."""
    from fringed.messages import Event, Preview, StationState
    from fringed_client.html import facts

    if isinstance(content, StationState):
        return f"camera {content.camera.state}, projector {content.projector.state}, scan {content.scan or 'none'}"
    if isinstance(content, Event):
        return f"{content.level} {content.name} {content.text}"
    if isinstance(content, Preview):
        return f"{content.role} {content.index + 1}/{content.count}"
    return ", ".join(facts(content).values())


@click.command("watch")
@click.argument("topics", nargs=-1, metavar="[TOPIC]...")
@click.option("--latest", is_flag=True, help="Skip to the newest message of each topic.")
@click.option("--count", type=click.IntRange(1), help="Stop after so many messages.")
@click.option("--for", "seconds", type=click.FloatRange(min=0, min_open=True), help="Stop after so many seconds.")
@common
def watch_command(
    topics: tuple[str, ...], latest: bool, count: int | None, seconds: float | None, options: Options
) -> int:
    """Follow the stream: rates, drops, latest values. With --json one line for each message.

    TOPIC is a prefix: state, event, preview, frameset, product, product/range-image ...
    """
    from fringed_client.station import Station

    with Station(options.station) as station, station.subscribe(*topics, latest=latest) as subscription:
        try:
            if options.json or not sys.stdout.isatty():
                _lines(subscription, options.json, count, seconds)
            else:
                _live(subscription, count, seconds, str(station))
        except KeyboardInterrupt:  # how watching ends: nothing has failed, no document of an error follows
            return EXIT_INTERRUPTED
    return EXIT_OK


def _lines(subscription: Subscription, as_json: bool, count: int | None, seconds: float | None) -> None:
    import json

    for message in _until(subscription, count, seconds):
        if message is None:
            continue
        row = {"topic": message.topic, "seq": message.seq, "missed": message.missed, "bytes": message.nbytes}
        text = one_line(message.content)
        if as_json:
            click.echo(json.dumps({**row, "kind": type(message.content).__name__, "text": text}, ensure_ascii=False))
        else:
            click.echo("\t".join(str(cell) for cell in (*row.values(), text)))


def _until(subscription: Subscription, count: int | None, seconds: float | None) -> Any:
    """Yield messages, and None where none came for a while, until enough have come or the time is over."""
    from fringed.errors import RequestTimeout

    end = time.monotonic() + seconds if seconds else None
    seen = 0
    while (count is None or seen < count) and (end is None or time.monotonic() < end):
        try:
            message = subscription.next(timeout_s=0.25)
        except RequestTimeout:
            yield None
        else:
            seen += 1
            yield message


def _live(subscription: Subscription, count: int | None, seconds: float | None, title: str) -> None:
    from rich.live import Live

    rows: dict[str, _Row] = {}
    with Live(_table(rows, title), console=output.console(), refresh_per_second=4) as live:
        for message in _until(subscription, count, seconds):
            if message is not None:
                rows.setdefault(message.topic, _Row()).add(message, time.monotonic())
            live.update(_table(rows, title))


def _table(rows: dict[str, _Row], title: str) -> Any:
    from rich import box
    from rich.table import Table

    drawn = Table(
        "topic", "n", "missed", "1/s", "MB/s", "latest", title=title, box=box.SIMPLE_HEAD, title_justify="left"
    )
    now = time.monotonic()
    for topic, row in sorted(rows.items()):
        rate, megabytes = row.rates(now)
        drawn.add_row(topic, str(row.count), str(row.missed), f"{rate:.1f}", f"{megabytes:.1f}", row.text)
    return drawn
