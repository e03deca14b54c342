"""`trigpoint router`: joins the machines of a site, and its segments with each other."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import InputError
from trigpoint.contract.access import Kind
from trigpoint.node.node import Node, stop_on_signals
from trigpoint.site.config import Site, check_name, load_site
from trigpoint.site.option import SITE_FILE, site_here
from trigpoint.zenoh import open_router
from trigpoint.zenoh.patience import means_of

_log = logging.getLogger(__name__)

_LOOK_S = 2.0


def main(
    site: Annotated[
        list[Path] | None,
        typer.Option(help="The site file; given again, further sites that this router joins."),
    ] = None,
    name: Annotated[str, typer.Option(help="The router's name.")] = "main",
) -> None:
    """A Zenoh router with the site's rules: others connect to bus.listen, it to bus.connect.

    When the file that says who may come in changes, it is opened anew, which ends every link.
    """
    check_name(Kind.ROUTER, name)
    first, *others = [load_site(path) for path in site or [site_here() or SITE_FILE]]
    for other in others:
        if (other.bus.tls is None) != (first.bus.tls is None):
            raise InputError(f"sites {first.name} and {other.name}: only one of them has [bus.tls]")
    stop = Router(first, others, name)
    stop_on_signals([stop])
    stop.run()


class Router:
    def __init__(self, site: Site, others: Sequence[Site], name: str) -> None:
        self._site, self._others, self._name = site, others, name
        self._node: Node | None = None
        self._is_stopped = False

    def stop(self) -> None:
        self._is_stopped = True
        if (node := self._node) is not None:
            node.stop()

    def run(self) -> None:
        """Run the router; restart it whenever the rules change."""
        while not self._is_stopped:
            rules = means_of(self._site, None, is_router=True, others=self._others).rules
            before = rules() if rules else None
            with open_router(self._site, *self._others) as bus:
                self._node = Node(
                    bus,
                    site=self._site.name,
                    kind=Kind.ROUTER,
                    name=self._name,
                )
                with self._node as node:
                    while not self._is_stopped and not node.stopping.wait(_LOOK_S):
                        if rules and rules() != before:
                            _log.info("who may come in has changed; the router is opened anew")
                            node.stop()
                    node.wait()
