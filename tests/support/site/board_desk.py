"""A board served in this process, on a bus in memory, and whoever asks it."""

import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from support.builders import eventually
from support.site.visitor import Visitor

from trigpoint.site.config import Site
from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.tools.board import command
from trigpoint.tools.board.command import BoardService
from trigpoint.tools.web.access import Access


class Desk(Visitor, frozen=True, kw_only=True):
    """A served board; `broker`: its bus."""

    broker: MemoryBroker
    service: BoardService


@contextmanager
def served_board(
    site: Site,
    monkeypatch: pytest.MonkeyPatch,
    *,
    access: Access | None = None,
    port: int = 0,
    is_operator: bool = False,
    opens_bus: bool = False,
) -> Iterator[Desk]:
    """A board on a bus in memory, until the end of the `with` block; `opens_bus`: on the site's
    own."""
    said: list[str] = []
    monkeypatch.setattr(command.typer, "echo", said.append)
    broker, errors = MemoryBroker(), []
    service = BoardService(site, access or Access(), is_operator=is_operator)

    def run() -> None:
        try:
            service.run(port, None if opens_bus else broker.session())
        except BaseException as reason:  # noqa: BLE001 - raised in the test's own thread
            errors.append(reason)

    thread = threading.Thread(target=run, name="board")
    thread.start()
    try:
        assert eventually(lambda: bool(said or errors))
        if errors:
            raise errors[0]
        trusted = access.certificate if access else None
        context = ssl.create_default_context(cafile=trusted) if trusted else None
        address = said[0].rpartition(" ")[2]
        yield Desk(address, context, broker=broker, service=service)
    finally:
        service.stop()
        thread.join()
    if errors:
        raise errors[0]
