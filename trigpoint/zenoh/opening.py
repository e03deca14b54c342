"""Opens a site's bus, or its router, as the site file says."""

import logging
import math

import zenoh

from trigpoint.base.errors import BusError
from trigpoint.bus.gate import Gate
from trigpoint.bus.settings import (
    Settings,
    datagram_settings,
    has_datagrams,
    router_settings,
    session_settings,
)
from trigpoint.contract.access import Kind
from trigpoint.site.config import Site

from .bus import ZenohBus
from .datagrams import Datagrams
from .patience import means_of, open_patiently, settle
from .session import open_session

_log = logging.getLogger(__name__)
_DATAGRAM_PATIENCE_S = 5.0
"""How long opening tries to get datagrams; a firewall may block them."""


def open_bus(
    site: Site, me: tuple[Kind, str] | None = None, *, patience_s: float = math.inf
) -> "ZenohBus":
    """Open the bus as the site's `[bus]` says; raise BusError if that fails.

    `me`: whose certificate to show on a secured site; None: that of the operator or viewer at this
    machine. A client that cannot reach its endpoint logs this and retries for `patience_s`.
    """
    means = means_of(site, me)
    settings = session_settings(site.name, site.bus, means.files)
    session = open_patiently(lambda: open_session(settings), settings, patience_s)
    try:
        gate = None
        if settings.gate and means.keeps_gate:
            gate = Gate(
                settings.gate,
                lambda: open_session(settings.gate_settings(means.door())),
                rules=means.rules,
            )
        bus = ZenohBus(
            session,
            locators=settings.locators,
            connect=settings.connect,
            gate=gate,
            warning=means.warning,
            days_left=means.days_left,
            datagrams=_datagrams(site, settings, session),
        )
    except BaseException:
        session.close()
        raise
    if settings.meets_others:
        settle(bus)
    return bus


def open_router(site: Site, *others: Site) -> "ZenohBus":
    """Open the bus as the site's router: everyone connected to it reaches everyone else. `others`:
    further sites whose nodes it admits, each to its own keys."""
    means = means_of(site, None, is_router=True, others=others)
    rate = site.router.picture_rate
    settings = router_settings(site.name, site.bus, means.door(), picture_rate=rate)
    session = open_session(settings)
    return ZenohBus(
        session, locators=site.bus.listen, warning=means.warning, days_left=means.days_left
    )


def _datagrams(site: Site, settings: Settings, session: zenoh.Session) -> "Datagrams | None":
    """Sends datagrams on the given session or on a second one; None if the site has none."""
    if not has_datagrams(site.bus):
        return None
    beside = datagram_settings(site.bus, settings)
    if beside is None:
        return Datagrams(session, is_beside=False)
    try:
        opened = open_patiently(lambda: open_session(beside), beside, _DATAGRAM_PATIENCE_S)
        return Datagrams(
            opened,
            is_beside=True,
            connect=beside.connect,
            reopen=lambda: open_session(beside),
            main=session,
        )
    except BusError as reason:
        _log.warning("%s; until the next start corrections go without datagrams", reason)
        return None
