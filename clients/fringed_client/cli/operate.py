"""`fringe lease`, `quarantine`, `plugins` and `simulated`: what an operator does."""

from __future__ import annotations

import time
from typing import Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common, pairs, triple


@click.group("lease")
def lease_command() -> None:
    """Hold the rig, show or break a lease."""


@lease_command.command("show")
@common
def _lease_show(options: Options) -> None:
    """Tell who holds the rig."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        lease = station.status().lease
    if options.json:
        output.emit(lease)
    else:
        text = f"{lease.holder} holds the {lease.scope}, {lease.expires_in_s:.0f} s left" if lease else "free"
        output.facts({"lease": text})


@lease_command.command("hold")
@click.option("--holder", help="Who holds it; this user and process by default.")
@click.option("--for", "seconds", type=click.FloatRange(min=0, min_open=True), help="Seconds; until Ctrl-C by default.")
@common
def _lease_hold(holder: str | None, seconds: float | None, options: Options) -> None:
    """Hold the rig until Ctrl-C: nobody else scans meanwhile."""
    from fringed_client.station import Station

    with Station(options.station) as station, station.lease(holder) as lease:
        output.say(f"the rig is held by {lease.holder}; Ctrl-C gives it back")
        end = None if seconds is None else time.monotonic() + seconds
        while not lease.lost and (end is None or time.monotonic() < end):
            time.sleep(0.2)
        lost = lease.lost
    if options.json:
        output.emit({"holder": lease.holder, "lost": lost})


@lease_command.command("break")
@click.option("--reason", required=True, help="It goes into the station's log.")
@common
def _lease_break(reason: str, options: Options) -> None:
    """Take the rig from whoever holds it."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        answer = station.request("lease.break", reason=reason)
    if options.json:
        output.emit(answer)
    else:
        output.facts({"broken": answer["broken"] or "nobody held it"})


@click.group("quarantine")
def quarantine_command() -> None:
    """Show or clear what is not tried again."""


@quarantine_command.command("show")
@common
def _quarantine_show(options: Options) -> None:
    """List sets and pipelines that are not tried again, and why."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        entries = station.status().quarantine
    if options.json:
        output.emit(list(entries))
        return
    if not entries:
        output.facts({"quarantine": "empty"})
        return
    output.table(
        ("subject", "pipeline", "attempts", "reason"), [(e.subject, e.pipeline, e.attempts, e.reason) for e in entries]
    )


@quarantine_command.command("clear")
@click.argument("subject", required=False)
@common
def _quarantine_clear(subject: str | None, options: Options) -> None:
    """Allow SUBJECT, or everything, to be tried again."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        answer = station.request("quarantine.clear", subject=subject)
    output.emit(answer) if options.json else output.facts({"cleared": answer["cleared"]})


@click.command("plugins")
@common
def plugins_command(options: Options) -> None:
    """List the station's plug-ins: what each provides, and what is broken."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        answer = station.plugins()
    if options.json:
        output.emit(answer)
        return
    for info in answer["plugins"]:
        provided = "\n".join(f"{kind}: {', '.join(names)}" for kind, names in info.provides.items())
        state = f"BROKEN: {info.error}" if info.error else provided or "nothing"
        output.facts({f"{info.name} ({info.distribution} {info.version})": state})


@click.group("simulated")
def simulated_command() -> None:
    """Order scenes and faults of a simulated rig."""


@simulated_command.command("scene")
@click.argument("name")
@click.option("--option", "scene_options", multiple=True, callback=pairs, metavar="KEY=VALUE", help="Of the object.")
@click.option("--rotation", callback=triple, metavar="X,Y,Z", help="Degrees about x, then y, then z.")
@click.option("--translation", callback=triple, metavar="X,Y,Z", help="Millimetres.")
@common
def _scene(name: str, options: Options, **wish: Any) -> None:
    """Put another object before the rig: plane, sphere, steps, freeform, face, hand, mesh, or a plug-in's."""
    from fringed_client.station import Station

    scene: dict[str, Any] = {"object": name, "options": wish["scene_options"]}
    scene |= {"rotation_deg": list(wish["rotation"])} if wish["rotation"] else {}
    scene |= {"translation_mm": list(wish["translation"])} if wish["translation"] else {}
    with Station(options.station) as station:
        station.set_scene(scene)
    output.emit({"scene": scene, "simulated": True}) if options.json else output.facts({"scene": f"{name}  SIMULATED"})


@simulated_command.command("fault")
@click.argument("fault")
@click.option("--count", default=1, show_default=True, type=click.IntRange(0), help="How many frames it strikes.")
@common
def _fault(fault: str, count: int, options: Options) -> None:
    """Order a fault: late, repeated, blended, dropped, torn, vanish, stall or garbage."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        station.request("simulate.fault", fault=fault, count=count)
    output.emit({"fault": fault, "count": count}) if options.json else output.facts({"ordered": f"{count} x {fault}"})
