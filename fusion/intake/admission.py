"""Which messages are accepted: from known senders, one per key, with stamps not in the future, and
not more than the rate allows.

Pure: no bus, no clock. A refused message is never stored, so that no sender can make another's
messages useless, now or after a restart.
"""

from collections import Counter
from collections.abc import Mapping

from msgspec import Struct, field

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.bus.bus import Sample
from trigpoint.contract import topics
from trigpoint.contract.topics import Topic
from trigpoint.site.config import Site

from .left_out import Problem

AHEAD_NS = to_ns(5.0)
"""The furthest a stamp may be ahead of its arrival: odometry from further ahead would make all that
follows come too late. A clock that is put right costs no more than this."""
# A camera sends `rate` pictures a second on average; what comes at twice that is no camera. No
# robot needs more odometry than this, and dropping some loses nothing, since each message is
# absolute.
_TIMES_ITS_RATE = 2.0
_ODOMETRY_HZ = 250.0
_ANNOUNCEMENTS_HZ = 2.0
_TAKEOVER_NS = to_ns(1.0)
"""After this silence a sender counts as gone; no program starts again faster."""
_REMEMBERED_NS = to_ns(5.0)
"""For how long a sender, or a conflict of two under one name, is remembered."""
_MOST_SENDERS = 8
_MOST_SHOWN = 100  # letters of a key


class Budget:
    """How many messages of one key are accepted: `rate_hz` on average, and `burst` at once, which
    is what arrives when a connection returns.

    Time is that of the clock or of the stamps, whichever advances faster: a session that is
    replayed at ten times its pace is not a flood.
    """

    def __init__(self, rate_hz: float, burst: int) -> None:
        self._period_ns, self._burst_ns = to_ns(1 / rate_hz), to_ns(burst / rate_hz)
        self._left_ns = self._burst_ns
        self._at_ns: int | None = None
        self._stamp_ns = 0

    def takes(self, stamp_ns: int, at_ns: int) -> bool:
        """Whether one more message is within the budget; `at_ns`: monotonic time."""
        if self._at_ns is not None:
            gone_ns = max(at_ns - self._at_ns, stamp_ns - self._stamp_ns, 0)
            self._left_ns = min(self._left_ns + gone_ns, self._burst_ns)
            stamp_ns = max(stamp_ns, self._stamp_ns)
        self._at_ns, self._stamp_ns = at_ns, stamp_ns
        if self._left_ns < self._period_ns:
            return False
        self._left_ns -= self._period_ns
        return True


class _Sender(Struct):
    """When a sender was last heard, monotonic, ns, and how often after another sender."""

    last_ns: int
    turns: int = 0


class _Speaker(Struct):
    """The senders of a key: `current`, the last one heard, and all recent ones."""

    current: str = ""
    last: str = ""
    senders: dict[str, _Sender] = field(default_factory=dict)
    twice_ns: int | None = None


class Admission:
    """The admission of one site's messages. Not thread-safe.

    `counts`: what was refused, by reason; `troubles`: name -> what is wrong now, as text.
    """

    def __init__(self, site: Site) -> None:
        self.counts = Counter(unknown_sender=0)
        self._unknown = ""
        self._ahead: dict[str, tuple[int, str]] = {}
        self._shed: dict[str, int] = {}
        self._speakers: dict[str, _Speaker] = {}
        self._budgets: dict[str, Budget] = {}
        for name, camera in site.cameras.items():
            self._allow(site, topics.SIGHTINGS, name, _TIMES_ITS_RATE * camera.rate)
            self._allow(site, topics.CAMERA_INFO, name, _ANNOUNCEMENTS_HZ)
        for name in site.robots:
            self._allow(site, topics.ODOMETRY, name, _ODOMETRY_HZ)

    def _allow(self, site: Site, topic: Topic, name: str, rate_hz: float) -> None:
        key = topic.key(site.name, name)
        self._budgets[key] = Budget(rate_hz, max(topic.cache, 16))
        self._speakers[key] = _Speaker()

    def knows(self, key: str) -> bool:
        """Whether the site file has the camera or robot of a key; unknown ones are counted. Any
        thread."""
        if key in self._budgets:
            return True
        self.counts["unknown_sender"] += 1
        self._unknown = key if len(key) <= _MOST_SHOWN else f"{key[:_MOST_SHOWN]}…"
        return False

    @property
    def problems(self) -> dict[str, Problem]:
        """Whom the site file does not have, and how often somebody such was heard."""
        count = self.counts["unknown_sender"]
        text = (
            f"the site file does not have who sends {self._unknown}; add it there and start fusion "
            "again, or correct its name"
        )
        return {"unknown_sender": Problem(text, count)} if count else {}

    def takes(self, sample: Sample, stamp_ns: int, at_ns: int, *, set_by_ns: int = 0) -> bool:
        """Whether a sound sample of a known key is to be used, by its stamp, its sender, and how
        much came. `at_ns`: monotonic time; `set_by_ns`: by how much this machine's clock was set,
        while not yet followed."""
        if not self._is_of_now(sample, stamp_ns, at_ns, set_by_ns):
            return False
        if not self._is_alone(self._speakers[sample.key], sample.sender, at_ns):
            self.counts["two_senders"] += 1
            return False
        if not self._budgets[sample.key].takes(stamp_ns, at_ns):
            self.counts["shed"] += 1
            self._shed[sample.key] = at_ns
            return False
        return True

    def _is_of_now(self, sample: Sample, stamp_ns: int, at_ns: int, set_by_ns: int) -> bool:
        ahead_ns = stamp_ns - (sample.received_ns - set_by_ns)
        if ahead_ns <= AHEAD_NS:
            return True
        self.counts["far_ahead"] += 1
        self._ahead[sample.key] = (
            at_ns,
            f"what comes on {sample.key} is stamped {to_seconds(ahead_ns):.0f} s ahead of this "
            "machine's clock and is not used; set the clock of its sender, or of this machine",
        )
        return False

    def _is_alone(self, speaker: _Speaker, sender: str, at_ns: int) -> bool:
        """Whether a key has one sender; another one takes over once the first is silent."""
        senders = speaker.senders
        for name, known in list(senders.items()):
            if at_ns - known.last_ns >= _REMEMBERED_NS:
                del senders[name]
        current = senders.get(speaker.current)
        if current is None or at_ns - current.last_ns >= _TAKEOVER_NS:
            speaker.current = sender
        is_turn = self._hear(speaker, sender, at_ns)
        # Both were heard again after the other: both are alive, and it was no stray message.
        if is_turn and sum(known.turns > 0 for known in senders.values()) > 1:
            speaker.twice_ns = at_ns
        if speaker.twice_ns is not None and at_ns - speaker.twice_ns < _REMEMBERED_NS:
            return False
        speaker.twice_ns = None
        return sender == speaker.current

    def _hear(self, speaker: _Speaker, sender: str, at_ns: int) -> bool:
        """Note the sender; whether another one was heard before it."""
        is_turn, speaker.last = speaker.last != sender, sender
        known = speaker.senders.get(sender)
        if known is not None:
            known.last_ns = at_ns
            known.turns += is_turn
        elif len(speaker.senders) < _MOST_SENDERS:
            speaker.senders[sender] = _Sender(at_ns)
        return is_turn

    def troubles(self, at_ns: int) -> Mapping[str, str]:
        """Name -> what is wrong now, as text."""
        found = {}
        for key, speaker in self._speakers.items():
            if speaker.twice_ns is not None and at_ns - speaker.twice_ns < _REMEMBERED_NS:
                names = " and ".join(name or "one without a name" for name in speaker.senders)
                found[f"two on {key}"] = (
                    f"two send on {key}: the sessions {names}; neither is used, stop one of them"
                )
        for key, (ahead_at_ns, text) in self._ahead.items():
            if at_ns - ahead_at_ns < _REMEMBERED_NS:
                found[f"ahead {key}"] = text
        for key, shed_at_ns in self._shed.items():
            if at_ns - shed_at_ns < _REMEMBERED_NS:
                found[f"shed {key}"] = (
                    f"{key} gets more than twice the messages that its `rate` allows; the excess "
                    "is left out; see who sends them"
                )
        return found
