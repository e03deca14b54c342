"""`trigpoint status`: who is alive on a site, how fast, and what was lost."""

import shutil
import threading
import time
from collections.abc import Sequence
from datetime import datetime
from typing import Annotated

import msgspec
import typer

from trigpoint.base.errors import MessageError
from trigpoint.bus.bus import Bus, Sample
from trigpoint.contract.cdr import decode
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.contract.topics import DIAGNOSTICS, alive_key
from trigpoint.node.node import stop_on_signals
from trigpoint.site.config import Site, load_site
from trigpoint.site.option import SITE_FILE, SiteFile
from trigpoint.zenoh import open_bus

from .state import SiteStatus, summarise, table

LISTEN_S = 2.2
"""Each node sends diagnostics once a second."""

_PATIENCE_S = 5.0
_CLEAR = "\x1b[2J\x1b[H"


def main(
    site: SiteFile = SITE_FILE,
    json: Annotated[bool, typer.Option("--json", help="One JSON object a look.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Look until interrupted.")] = False,
) -> None:
    """Show the live site: who is alive, rates, losses and last errors; exit 1 where anything is in
    error or missing: what the site file names or expects (`expect`), or what was seen alive."""
    configuration = load_site(site)
    watcher = Watcher()
    width = shutil.get_terminal_size().columns
    with open_bus(configuration, patience_s=_PATIENCE_S) as bus:
        if watch:
            stop_on_signals([watcher])
        while not watcher.stopping.is_set():
            status = look(
                bus,
                configuration.name,
                watcher.stopping,
                wanted=wanted_of(configuration),
                known=known_of(configuration),
                expect=configuration.expect,
            )
            if json:
                typer.echo(msgspec.json.encode(status).decode())
            else:
                typer.echo((_CLEAR if watch else "") + table(status, width=width))
            if not watch:
                raise typer.Exit(0 if status.is_well else 1)


class Watcher:
    def __init__(self) -> None:
        self.stopping = threading.Event()

    def stop(self) -> None:
        self.stopping.set()


def known_of(site: Site) -> list[str]:
    """All agents and bridges that a site may have by its file."""
    return [f"edge/{name}" for name in site.cameras] + [f"robot/{name}" for name in site.robots]


def wanted_of(site: Site) -> list[str]:
    """The nodes named in a site file: an agent per camera, a bridge per robot with a port."""
    robots = [name for name, robot in site.robots.items() if robot.port is not None]
    return [f"edge/{name}" for name in site.cameras] + [f"robot/{name}" for name in robots]


def look(
    bus: Bus,
    site: str,
    stopping: threading.Event,
    *,
    wanted: Sequence[str] = (),
    known: Sequence[str] | None = None,
    expect: Sequence[str] | None = None,
    listen_s: float = LISTEN_S,
) -> SiteStatus:
    """Listen for a while and report who is there."""
    subscription = bus.subscribe(DIAGNOSTICS, DIAGNOSTICS.expression(site))
    statuses: list[DiagnosticStatus] = []
    deadline = time.monotonic() + listen_s
    while not stopping.is_set() and (left_s := deadline - time.monotonic()) > 0:
        if (sample := subscription.take(min(left_s, 0.2))) is not None:
            statuses += statuses_in(sample)
    subscription.close()
    tokens = bus.alive(alive_key(site, "*", "*"))
    return summarise(
        site,
        peers=len(bus.peers),
        tokens=tokens,
        statuses=statuses,
        wanted=wanted,
        known=known,
        expect=expect,
        unreached=bus.unreached,
        time=datetime.now().astimezone().isoformat(timespec="milliseconds"),
    )


def statuses_in(sample: Sample) -> tuple[DiagnosticStatus, ...]:
    """The statuses in diagnostics; none if they are invalid, which every node reports."""
    try:
        message = decode(DIAGNOSTICS.type_name, sample.payload)
    except MessageError:
        return ()
    assert isinstance(message, Diagnostics)
    return message.statuses
