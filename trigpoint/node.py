"""A node's life: liveliness token, diagnostics once a second, orderly stop.

A part's `node.py` reads:

    with open_bus(site) as bus, Node(bus, site=site.name, kind="edge", name=camera) as node:
        ...threads that watch node.stopping...
        node.wait()   # until SIGINT, SIGTERM or node.stop()
"""

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

from .bus import Bus
from .clock import Clock, SystemClock


class Health:
    """What a node knows of its own work; every method may be called from any thread.

    `count` adds to a counter that diagnostics show as total and rate; `lose` does the same for lost
    data, which makes the status a warning; `gauge` names a value that is read once a second (a
    queue's depth); `fail` keeps the last error's text, which makes the status an error for a while.
    """

    def count(self, name: str, amount: int = 1) -> None: ...

    def lose(self, name: str, amount: int = 1) -> None: ...

    def gauge(self, name: str, read: Callable[[], float]) -> None: ...

    def fail(self, text: str) -> None: ...

    def total(self, name: str) -> int:
        """A counter's value, 0 where it was never counted."""
        ...


class Node:
    """One node on the bus. Several may share a bus and a process (an agent with two cameras)."""

    health: Health
    stopping: threading.Event

    def __init__(
        self, bus: Bus, *, site: str, kind: str, name: str, clock: Clock | None = None
    ) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    def thread(self, name: str, run: Callable[[], None]) -> None:
        """Start a thread that is joined at the node's end; an error in it stops the node.

        `run` must return within a second of `stopping` being set.
        """
        ...

    def stop(self) -> None:
        """Ask the node to end."""
        ...

    def wait(self) -> None:
        """Return when the node is asked to end; raise what ended one of its threads."""
        ...


def stop_on_signals(nodes: list[Node]) -> None:
    """SIGINT and SIGTERM stop these nodes; call it on the main thread."""
    ...
