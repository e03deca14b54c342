"""Sends urgent samples as datagrams too: they do not wait for packets that were lost earlier."""

import logging
import threading
from collections.abc import Callable

import zenoh
from zenoh import CongestionControl, Reliability

from trigpoint.base.ending import ENDING
from trigpoint.base.errors import BusError
from trigpoint.bus.keeper import LOST_S, Keeper, close_in_time
from trigpoint.bus.outbox import Outbox
from trigpoint.bus.urgent import AGAIN_S, WAITING
from trigpoint.contract.topics import Topic

from .session import CLOSE_S, FLUSH_S, has_link, plain, quality_of

_log = logging.getLogger(__name__)


class Lasting:
    """A publisher or subscriber that is declared again when its session is replaced."""

    def __init__(
        self,
        lock: threading.Lock,
        declare: Callable[[zenoh.Session], "zenoh.Publisher | zenoh.Subscriber[None]"],
        session: zenoh.Session,
    ) -> None:
        self._lock, self._declare, self._now = lock, declare, declare(session)
        self.is_closed = False

    def move(self, session: zenoh.Session) -> None:
        """Continue on another session; the caller holds the lock."""
        if not self.is_closed:
            self._now = self._declare(session)

    def put(
        self, payload: bytes, *, attachment: bytes | None, timestamp: zenoh.Timestamp | None
    ) -> None:
        with self._lock:
            assert isinstance(self._now, zenoh.Publisher)
            self._now.put(payload, attachment=attachment, timestamp=timestamp)

    def undeclare(self) -> None:
        with self._lock:
            self.is_closed = True
            self._now.undeclare()


class Datagrams:
    """Sends copies that may be lost, each twice.

    `session`: the bus's own session or a second one beside it; `connect`: where the second one
    connects to; `reopen`: opens it again, once it has been without datagrams for `lost_s` while
    `main`, the bus's own session, reaches somebody.
    """

    def __init__(
        self,
        session: zenoh.Session,
        *,
        is_beside: bool,
        connect: tuple[str, ...] = (),
        reopen: Callable[[], zenoh.Session] | None = None,
        main: zenoh.Session | None = None,
        lost_s: float = LOST_S,
    ) -> None:
        self._session, self.is_beside, self._connect = session, is_beside, connect
        self._again = Outbox("bus sends again", WAITING)
        self._lock = threading.Lock()
        self._declared: list[Lasting] = []
        self._is_closed = self._was_shared = False
        self._reopen, self._main, self._keeper = reopen, main, None
        if reopen is not None and main is not None:
            self._keeper = Keeper("bus keeps datagrams", self._is_well, self._renew, lost_s=lost_s)

    def publisher(self, topic: Topic, key: str) -> Lasting:
        quality = quality_of(topic)
        quality["congestion_control"] = CongestionControl.DROP
        quality["reliability"] = Reliability.BEST_EFFORT
        return self._lasting(lambda session: session.declare_publisher(key, **quality))

    def subscriber(
        self, expression: str, handler: "zenoh.handlers.Callback[zenoh.Sample]"
    ) -> Lasting:
        return self._lasting(lambda session: session.declare_subscriber(expression, handler))

    def _lasting(
        self, declare: Callable[[zenoh.Session], "zenoh.Publisher | zenoh.Subscriber[None]"]
    ) -> Lasting:
        with self._lock:
            self._declared = [item for item in self._declared if not item.is_closed]
            item = Lasting(self._lock, declare, self._session)
            self._declared.append(item)
        return item

    @property
    def unreached(self) -> tuple[str, ...]:
        """Endpoints where nobody answers now."""
        return self._connect if self._connect and not has_link(self._session) else ()

    def _is_well(self) -> bool:
        """Whether datagrams have a link: if they once shared a router with the bus's own session,
        a link to that router. Also true while that session reaches nobody, as nothing can be done
        then."""
        assert self._main is not None
        there = {str(link.zid) for link in self._main.info.links()}
        if not there:
            return True
        links = self._session.info.links()
        mine = {str(link.zid) for link in links if link.reliability != Reliability.RELIABLE}
        if mine & there:
            self._was_shared = True
        return bool(mine & there if self._was_shared else mine)

    def _renew(self) -> None:
        assert self._reopen is not None
        session = self._reopen()
        try:
            with self._lock:
                if not self._is_closed:
                    session, self._session = self._session, session
                    self._was_shared = False
                    for item in self._declared:
                        item.move(self._session)
                    _log.warning("the session for datagrams had lost them and was opened anew")
        except zenoh.ZError as reason:
            raise BusError(f"datagrams cannot be declared anew: {plain(reason)}") from None
        finally:
            close_in_time(session.close, "a session for datagrams")

    def put(self, send: Callable[[], None]) -> None:
        """Send now, and once more soon."""
        send()
        if not self._again.waiting:
            self._again.hold(AGAIN_S)
        self._again.put(send)

    def close(self) -> None:
        self._again.close(FLUSH_S)
        with self._lock:
            self._is_closed = True
        if self._keeper is not None and not self._keeper.close(CLOSE_S):
            ENDING.leave_behind("a session for datagrams")
        if self.is_beside:
            self._session.close()
