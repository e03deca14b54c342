"""Fetches from a sender's cache what it sent before the first of its samples to arrive.

Zenoh's subscriber (zenoh-ext 1.10.2) asks for that too, but if the next sample arrives while the
answers to two queries overlap, it hands on only the tail and counts no loss. Seen with several
senders on one key expression (one start in five), and with one (one in 25, on a busy machine).
"""

import logging
import threading
from collections.abc import Callable

import zenoh
from zenoh import ConsolidationMode, QueryTarget, ReplyKeyExpr

from .session import called_at_once

_log = logging.getLogger(__name__)

_PATIENCE_S = 5.0
_MOST_SENDERS = 4096
_MOST_HELD = 4096
"""How many senders are remembered, and how many samples of one may wait for earlier ones."""

Sender = tuple[str, int]
"""The session's identifier, and the number of the publisher within it."""


class History:
    """Hands on each sender's samples from the first that it still keeps (`depth` samples back);
    samples without a sequence number are handed on as they arrive. Called on Zenoh's threads."""

    def __init__(
        self, session: zenoh.Session, depth: int, hand_on: Callable[[zenoh.Sample], None]
    ) -> None:
        self._session, self._depth, self._hand_on = session, depth, hand_on
        self._lock = threading.Lock()
        self._known: dict[Sender, None] = {}
        self._waiting: dict[Sender, dict[int, zenoh.Sample]] = {}

    def receive(self, sample: zenoh.Sample) -> None:
        """Hand a sample on, at once or after the earlier ones."""
        info = sample.source_info
        if info is None:
            self._hand_on(sample)
            return
        sender = (str(info.source_id.zid), info.source_id.eid)
        with self._lock:
            is_new = sender not in self._known
            if is_new:
                self._remember(sender)
            if is_new and info.source_sn > 0:
                self._waiting[sender] = {}
            waiting = self._waiting.get(sender)
            if waiting is None:
                self._hand_on(sample)
                return
            if len(waiting) < _MOST_HELD:
                waiting[info.source_sn] = sample
        if is_new:
            self._ask(sender, str(sample.key_expr), info.source_sn)

    def _remember(self, sender: Sender) -> None:
        self._known[sender] = None
        if len(self._known) > _MOST_SENDERS:
            del self._known[next(iter(self._known))]

    def _ask(self, sender: Sender, key: str, before: int) -> None:
        zid, number = sender
        numbers = f"_sn={max(0, before - self._depth)}..{before - 1}"

        def take(reply: zenoh.Reply) -> None:
            if (sample := reply.ok) is None or (info := sample.source_info) is None:
                return
            with self._lock:
                if sender in self._waiting:
                    self._waiting[sender].setdefault(info.source_sn, sample)

        try:
            self._session.get(
                f"{key}/@adv/*/{zid}/{number}/**?{numbers}",
                called_at_once(take, end=lambda: self._end(sender)),
                target=QueryTarget.ALL,
                consolidation=ConsolidationMode.NONE,
                accept_replies=ReplyKeyExpr.ANY,
                timeout=_PATIENCE_S,
            )
        except zenoh.ZError as reason:
            _log.warning(
                "what was sent on %s before %d cannot be asked for: %s", key, before, reason
            )
            self._end(sender)

    def _end(self, sender: Sender) -> None:
        """Hand on the waiting samples in order; later ones follow them."""
        with self._lock:
            for _, sample in sorted(self._waiting.pop(sender, {}).items()):
                self._hand_on(sample)
