"""Whether the session for datagrams still has them, by what Zenoh tells of its links."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest
from zenoh import Reliability

from trigpoint.zenoh import Datagrams

STREAM, DATAGRAM = Reliability.RELIABLE, Reliability.BEST_EFFORT


@dataclass
class Session:
    """Stands for Zenoh's: `to` is where its links end, and whether they carry datagrams."""

    to: list[tuple[str, Reliability]] = field(default_factory=list)
    is_open: bool = True

    @property
    def info(self) -> SimpleNamespace:
        links = [SimpleNamespace(zid=zid, reliability=how) for zid, how in self.to]
        return SimpleNamespace(links=lambda: links)

    def close(self) -> None:
        self.is_open = False


@pytest.fixture(name="main")
def _main() -> Session:
    return Session([("hall", STREAM)])


@pytest.fixture(name="beside")
def _beside() -> Session:
    return Session([("hall", STREAM), ("hall", DATAGRAM)])


@pytest.fixture(name="fresh")
def _fresh() -> Session:
    return Session([("hall", STREAM), ("hall", DATAGRAM)])


@pytest.fixture(name="datagrams")
def _datagrams(main: Session, beside: Session, fresh: Session):
    datagrams = Datagrams(
        beside,  # pyright: ignore[reportArgumentType]
        is_beside=True,
        reopen=lambda: fresh,  # pyright: ignore[reportArgumentType]
        main=main,  # pyright: ignore[reportArgumentType]
        lost_s=3600.0,  # its thread does nothing here
    )
    yield datagrams
    datagrams.close()


def test_one_that_only_has_its_stream_is_not(datagrams: Datagrams, beside: Session) -> None:
    beside.to = [("hall", STREAM)]
    assert not datagrams._is_well()


def test_one_that_reaches_nobody_is_not(datagrams: Datagrams, beside: Session) -> None:
    beside.to = []
    assert not datagrams._is_well()


def test_while_the_main_one_reaches_nobody_nothing_can_be_done(
    datagrams: Datagrams, main: Session, beside: Session
) -> None:
    main.to = beside.to = []
    assert datagrams._is_well()


def test_one_that_holds_on_to_a_router_that_is_gone_is_not(
    datagrams: Datagrams, main: Session
) -> None:
    assert datagrams._is_well()
    main.to = [("hall again", STREAM)]
    assert not datagrams._is_well()


def test_two_routers_from_the_beginning_are_well(datagrams: Datagrams, main: Session) -> None:
    main.to = [("another", STREAM)]
    assert datagrams._is_well()


def test_a_new_one_takes_its_place_and_the_old_one_is_closed(
    datagrams: Datagrams, beside: Session, fresh: Session
) -> None:
    beside.to = []
    datagrams._renew()
    assert datagrams._is_well()
    assert not beside.is_open
    datagrams.close()
    assert not fresh.is_open


def test_one_that_is_opened_while_the_bus_closes_is_closed_again(
    datagrams: Datagrams, fresh: Session
) -> None:
    datagrams.close()
    datagrams._renew()
    assert not fresh.is_open
