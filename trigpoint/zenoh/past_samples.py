"""Fetches from a sender's cache what did not come: what it sent before the first of its samples to
arrive, and what is missing between two of them.

Zenoh's subscriber (zenoh-ext 1.10.2) asks for missing samples too, but only once: where a sample
overtakes the news of who has the earlier ones, nobody answers, and they are lost. And if the next
sample arrives while the answers to two queries overlap, it hands on only the tail and counts no
loss. Seen with several senders on one key expression (one start in five), and with one (one in 25,
on a busy machine). So here is asked again until the sender has answered, and here is counted.
"""

import logging
import threading
import time
from collections.abc import Callable

import zenoh
from msgspec import Struct, field
from zenoh import ConsolidationMode, QueryTarget, ReplyKeyExpr

from .session import called_at_once

_log = logging.getLogger(__name__)

_PATIENCE_S = 5.0
_AGAIN_S = 0.2
"""How long a sender is asked from its latest answer on, and how soon again where none came, or one
with holes."""
_MOST_FRUITLESS = 2
"""What so many whole answers in a row do not bring, their sender does not keep."""
_MOST_SENDERS = 4096
_MOST_HELD = 4096
"""How many senders are remembered, and how many samples of one may wait for earlier ones."""

Sender = tuple[str, int]
"""The session's identifier, and the number of the publisher within it."""


class _Question(Struct):
    """What of `key` is asked for: from number `begin` to the latest of the samples, by number, that
    wait in `held` meanwhile. `is_asked`: whether an answer may come; `is_answered`: whether it came
    to its end; `brought`: how many samples were in it that had not come; `fruitless`: how many
    answers in a row brought none."""

    key: str
    begin: int
    held: dict[int, zenoh.Sample]
    until_s: float = field(default_factory=lambda: time.monotonic() + _PATIENCE_S)
    is_asked: bool = False
    is_answered: bool = False
    brought: int = 0
    fruitless: int = 0
    timer: threading.Timer | None = None

    def is_done(self, depth: int) -> bool:
        """Whether nothing is missing, after an answer, of what a sender that keeps `depth` samples
        may still have."""
        if not self.is_answered:
            return False
        self.fruitless = 0 if self.brought else self.fruitless + 1
        last = max(self.held)
        is_whole = all(n in self.held for n in range(max(self.begin, last + 1 - depth), last))
        return is_whole or self.fruitless >= _MOST_FRUITLESS


class History:
    """Hands on each sender's samples in order, from the first that it still keeps (`depth` samples
    back), and tells `miss` how many never came; samples without a sequence number are handed on as
    they arrive. Called on Zenoh's threads."""

    def __init__(
        self,
        session: zenoh.Session,
        depth: int,
        hand_on: Callable[[zenoh.Sample], None],
        miss: Callable[[int], None],
    ) -> None:
        self._session, self._depth, self._hand_on, self._miss = session, depth, hand_on, miss
        self._lock = threading.Lock()
        self._next: dict[Sender, int] = {}
        self._questions: dict[Sender, _Question] = {}
        self._is_closed = False

    def receive(self, sample: zenoh.Sample) -> None:
        """Hand a sample on, at once or after the earlier ones."""
        info = sample.source_info
        if info is None:
            self._hand_on(sample)
            return
        sender, number = (str(info.source_id.zid), info.source_id.eid), info.source_sn
        with self._lock:
            if (question := self._questions.get(sender)) is not None:
                if len(question.held) < _MOST_HELD:
                    question.held[number] = sample
                return
            expected = self._next.get(sender, 0)
            if number <= expected:
                self._pass(sender, {number: sample}, expected)
                return
            if self._is_closed:
                return
            begin = max(expected, number - self._depth)
            question = _Question(str(sample.key_expr), begin, {number: sample})
            self._questions[sender] = question
            self._ask_later(sender, question, 0.0)

    def close(self) -> None:
        """Ask no more."""
        with self._lock:
            self._is_closed = True
            for question in self._questions.values():
                if question.timer is not None:
                    question.timer.cancel()

    def _ask_later(self, sender: Sender, question: _Question, delay_s: float) -> None:
        """Ask on a thread of its own; the caller holds the lock. Zenoh, too, holds one where it
        hands on samples while a link closes: a question there waits for it forever."""
        question.timer = threading.Timer(delay_s, self._ask, (sender, question))
        question.timer.daemon = True
        question.timer.start()

    def _ask(self, sender: Sender, question: _Question) -> None:
        """Ask for the latest that came, too: its sender has it, and answers with it last."""
        zid, entity = sender
        with self._lock:
            if self._is_closed:
                return
            latest = max(question.held)
            while question.begin in question.held:
                question.begin += 1
            question.is_asked, question.is_answered, question.brought = True, False, 0

        def take(reply: zenoh.Reply) -> None:
            if (sample := reply.ok) is not None and (info := sample.source_info) is not None:
                with self._lock:
                    question.is_answered |= info.source_sn == latest
                    question.until_s = time.monotonic() + _PATIENCE_S
                    question.brought += info.source_sn not in question.held
                    question.held.setdefault(info.source_sn, sample)

        try:
            self._session.get(
                f"{question.key}/@adv/*/{zid}/{entity}/**?_sn={question.begin}..{latest}",
                called_at_once(take, end=lambda: self._end(sender, question)),
                target=QueryTarget.ALL,
                consolidation=ConsolidationMode.NONE,
                accept_replies=ReplyKeyExpr.ANY,
                timeout=_PATIENCE_S,
            )
        except zenoh.ZError as reason:
            _log.warning("what was sent on %s cannot be asked for: %s", question.key, reason)
            self._end(sender, question)

    def _end(self, sender: Sender, question: _Question) -> None:
        """Hand on the waiting samples, which later ones follow; or ask again, if the answer never
        came, broke off or had holes. Of a closed session it is called twice."""
        with self._lock:
            if self._is_closed or not question.is_asked:
                return
            question.is_asked = False
            if not question.is_done(self._depth) and time.monotonic() < question.until_s:
                self._ask_later(sender, question, _AGAIN_S)
                return
            del self._questions[sender]
            self._pass(sender, question.held, self._expected(sender, question))

    def _expected(self, sender: Sender, question: _Question) -> int:
        """The number that comes next; of a new sender the first that it must still keep, or, where
        some may have made room, by the latest that came or by its answers, the first that came."""
        made_room = max(question.held) >= self._depth or question.fruitless >= _MOST_FRUITLESS
        return self._next.get(sender, min(question.held) if made_room else 0)

    def _pass(self, sender: Sender, samples: dict[int, zenoh.Sample], expected: int) -> None:
        """Hand samples on in order, without those that were; the caller holds the lock."""
        for number, sample in sorted(samples.items()):
            if number < expected:
                continue
            if number > expected:
                self._miss(number - expected)
            self._hand_on(sample)
            expected = number + 1
        self._next.pop(sender, None)  # so that who has been silent for longest is forgotten first
        self._next[sender] = expected
        if len(self._next) > _MOST_SENDERS:
            del self._next[next(iter(self._next))]
