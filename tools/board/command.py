"""`trigpoint board`: a web page of the live site."""

import threading
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.bus.bus import Bus
from trigpoint.metrics.families import families
from trigpoint.metrics.server import exposition
from trigpoint.node.node import stop_on_signals
from trigpoint.site.config import Site, load_site
from trigpoint.site.option import SITE_FILE, SiteFile
from trigpoint.tools.web.access import LOOPBACK, Access, Guard, checked_access
from trigpoint.tools.web.answers import version_of
from trigpoint.tools.web.serving import served
from trigpoint.zenoh import open_bus

from .app import OPEN_PATHS, Board, assets
from .feed import Feed
from .history import History
from .operator import Commands, check_operator
from .pictures import Pictures
from .reader import PERIOD_S, Reader

PORT = 8420


def main(
    site: SiteFile = SITE_FILE,
    port: Annotated[
        int, typer.Option(help="Of the page; 0: one that is free.", min=0, max=65535)
    ] = PORT,
    host: Annotated[
        str,
        typer.Option(
            help="The address of this machine that the page is open to; else itself alone. Needs "
            "--certificate, --key and --token."
        ),
    ] = LOOPBACK,
    certificate: Annotated[
        Path | None, typer.Option(help="The page's certificate, PEM, with those that sign it.")
    ] = None,
    key: Annotated[Path | None, typer.Option(help="The certificate's key, PEM.")] = None,
    token: Annotated[
        Path | None, typer.Option(help="A file with the word to log in with, for its owner alone.")
    ] = None,
    name: Annotated[
        list[str],
        typer.Option(help="A further name by which browsers ask for the page (again for more)."),
    ] = [],  # noqa: B006 - typer makes a list of it anew
    operator: Annotated[
        bool,
        typer.Option(
            "--operator",
            help="Offer snapshots and a new map on the page; needs an operator's certificate.",
        ),
    ] = False,
) -> None:
    """Serve a web page of the live site, and /metrics of all its nodes, until stopped (Ctrl-C).

    It only reads: without --operator nothing that is done on the page reaches the bus.
    """
    loaded = load_site(site)
    access = checked_access(host, names=name, token=token, certificate=certificate, key=key)
    if operator:
        check_operator(loaded)
    service = BoardService(loaded, access, is_operator=operator)
    stop_on_signals([service])
    service.run(port)


class BoardService:
    def __init__(self, site: Site, access: Access, *, is_operator: bool = False) -> None:
        self._site, self._access = site, access
        self._bus: Bus | None = None
        self._stopping = threading.Event()
        self._feed, self._history = Feed(), History()
        self._pictures = Pictures(lambda: self._bus, site.name, frozenset(site.cameras))
        files = assets()
        about: dict[str, object] = {"page": version_of(files), "operator": is_operator}
        self._reader = Reader(site, self._feed, self._history, self._pictures, about=about)
        self._board = Board(
            files=files,
            guard=Guard(access, OPEN_PATHS),
            feed=self._feed,
            history=self._history,
            pictures=self._pictures,
            picture=self._reader.picture,
            metrics=lambda: exposition(families(site.name, self._reader.heard())),
            commands=Commands(lambda: self._bus, site) if is_operator else None,
        )

    def stop(self) -> None:
        """Ask it to end. Any thread."""
        self._stopping.set()

    def run(self, port: int, bus: Bus | None = None) -> None:
        """Serve until stopped; `bus`: the open one, else the site's is opened."""
        self._reader.begin()  # from the first answer on there is a state, and a past
        with served(self._board.app, self._access, port) as address:
            typer.echo(f"open in a browser: {address}")
            try:
                if bus is not None:
                    self._read(bus)
                    return
                if (opened := self._opened()) is not None:
                    with opened:
                        self._read(opened)
            finally:
                self._feed.close()

    def _opened(self) -> Bus | None:
        """The site's bus, however long a router takes; None where it is stopped before. Opening
        cannot be cut short, so a stop leaves it behind."""
        opening: Future[Bus] = Future()

        def open_it() -> None:
            try:
                opening.set_result(open_bus(self._site))
            except BaseException as reason:  # noqa: BLE001 - raised again by `result`
                opening.set_exception(reason)

        threading.Thread(target=open_it, name="board opens", daemon=True).start()
        while not opening.done() and not self._stopping.is_set():
            self._reader.begin()
            wait([opening], PERIOD_S)
        return opening.result() if opening.done() else None

    def _read(self, bus: Bus) -> None:
        self._bus = bus
        try:
            self._reader.run(bus, self._stopping)
        finally:
            self._pictures.close()
            self._bus = None
