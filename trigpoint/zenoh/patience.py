"""The steps around opening a session: certificates, retries, and discovering who is there."""

import logging
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from msgspec import Struct

from trigpoint.base.errors import BusError
from trigpoint.bus.bus import Bus
from trigpoint.bus.settings import Door, Settings, TlsFiles
from trigpoint.contract.access import Kind
from trigpoint.site.config import Site, is_secured

_log = logging.getLogger(__name__)

_RETRY_S = 1.0
_SETTLE_S = 0.2
_SETTLE_LIMIT_S = 1.0

Session = TypeVar("Session")


class Means(Struct, frozen=True):
    """What a process shows to others, and how it admits them.

    `door` and `rules` read the files each time, as they change while the process runs.
    `keeps_gate`: whether it opens the machine's gate if nobody else does.
    """

    files: TlsFiles | None = None
    door: Callable[[], Door | None] = lambda: None
    rules: Callable[[], object] | None = None
    warning: Callable[[], str] = str
    days_left: Callable[[], float | None] = lambda: None
    keeps_gate: bool = True


def means_of(
    site: Site,
    me: tuple[Kind, str] | None,
    *,
    is_router: bool = False,
    others: Sequence[Site] = (),
) -> Means:
    """The means of one of the site's processes; raise ConfigError if one of its files is wrong.

    `me`: whose certificate it shows; None: that of the person at this machine. `others`: further
    sites that a router joins.
    """
    for name in site.bus.open_doors:
        _log.warning(
            "%s is open without certificates (insecure = true): whoever reaches it can move the "
            "robots of site %s",
            name,
            site.name,
        )
    if site.bus.tls is None:
        return Means()
    from trigpoint.security import (
        credentials,
    )

    leaves = any(map(is_secured, site.bus.connect))
    listens = any(map(is_secured, site.bus.listen))
    shown = []
    if leaves and not is_router:
        shown.append(
            credentials.node_credentials(site, *me) if me else credentials.person_credentials(site)
        )
    files = shown[0].files if shown else None
    # Short-lived commands may not be able to read the machine's key; services keep the gate.
    keeps_gate = listens and (me is not None or is_router)
    if not keeps_gate:
        return Means(
            files,
            warning=lambda: credentials.first_complaint(shown),
            days_left=lambda: credentials.least_days(shown),
            keeps_gate=not listens,
        )
    shown.append(credentials.router_credentials(site))
    return Means(
        files,
        door=lambda: credentials.door(site, *others),
        rules=lambda: credentials.fingerprint(site, *others),
        warning=lambda: credentials.first_complaint(shown),
        days_left=lambda: credentials.least_days(shown),
    )


def open_patiently(
    open_session: Callable[[], Session], settings: Settings, patience_s: float
) -> Session:
    """Open a session; a client that reaches nobody retries for `patience_s`.

    Peers need no retries: they open at once and connect when they can.
    """
    deadline = time.monotonic() + patience_s
    is_said = False
    while True:
        try:
            return open_session()
        except BusError as reason:
            if settings.mode != "client" or time.monotonic() > deadline:
                raise
            if not is_said:
                _log.warning("%s; check that it runs%s; trying again", reason, _hint(settings))
            is_said = True
        time.sleep(_RETRY_S)


def _hint(settings: Settings) -> str:
    """What else may be wrong with a site that is secured: the handshake tells neither side."""
    if settings.files is None:
        return ""
    return (
        ", that its trust.pem knows this node's certificate, and that its own certificate names "
        "this address (`trigpoint secure list`)"
    )


def settle(bus: Bus) -> None:
    """Wait until the present peers have announced each other, so that a first look at who is alive
    is complete. Without this wait, four of ten new nodes missed one with the same name."""
    deadline = time.monotonic() + _SETTLE_LIMIT_S
    peers, since = bus.peers, time.monotonic()
    while (now := time.monotonic()) < deadline and now - since < _SETTLE_S:
        time.sleep(0.02)
        if bus.peers != peers:
            peers, since = bus.peers, time.monotonic()
