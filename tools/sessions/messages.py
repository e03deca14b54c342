"""The messages of a session, or of anybody's bag, on their way to the estimator."""

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from trigpoint.base.clock import to_seconds
from trigpoint.base.errors import MessageError
from trigpoint.base.words import counted, numberless
from trigpoint.contract import cdr, cdr_layout, topics
from trigpoint.contract.clock_doubt import DoubtFilter
from trigpoint.contract.messages import Diagnostics, Message, Odometry, Sightings, stamped
from trigpoint.fusion.intake.arrivals import Span
from trigpoint.fusion.model.readings import Readings
from trigpoint.recorder.session.recording import RecordedSample, Recording

from .recorded_clocks import RecordedClocks

_MOST_TIMES = 3
_TOO_EARLY = (
    "header.stamp is 0, and the others' clock counts from 0 (`use_sim_time`): it had not begun"
)
# Odometry of a robot that is read at once, in messages; their bytes are held until then.
_BLOCK = 4096
_TOPICS = (topics.CAMERA_INFO, topics.ODOMETRY, topics.SIGHTINGS, topics.DIAGNOSTICS)


class SessionMessages:
    """What of a session can be used, and what cannot. `misdescribed`: camera -> what its pictures
    show in place of the target file's boards; `robots`: those of which there is odometry."""

    def __init__(self) -> None:
        self.misdescribed: dict[str, str] = {}
        self.robots: set[str] = set()
        self.clocks = RecordedClocks()
        self._unstamped: list[tuple[str, Odometry | Sightings, int, int]] = []
        self._found: list[tuple[int, bool, int, str, Message | int]] = []
        self._odometry: dict[str, list[Readings]] = {}
        self._refused: dict[tuple[str, str, str], tuple[str, list[int]]] = {}

    def add(self, node: str, message: Message, log_ns: int, *, order: int) -> None:
        """Take a message of a camera or robot that was recorded at `log_ns`, as the `order`-th."""
        if isinstance(message, Odometry):
            self.robots.add(node)
        if isinstance(message, Odometry | Sightings) and message.stamp_ns:
            self.clocks.add(node, [message.stamp_ns], [log_ns])
        elif isinstance(message, Odometry | Sightings):
            self._unstamped.append((node, message, log_ns, order))
            return
        self._add(node, message, order)

    def _add(self, node: str, message: Message, order: int) -> None:
        is_stamped = isinstance(message, Odometry | Sightings | Diagnostics)
        stamp_ns = message.stamp_ns if is_stamped else 0
        self._found.append((stamp_ns, isinstance(message, Sightings), order, node, message))

    def _settle(self) -> None:
        """Take what has no stamp at the time of its recording, unless a clock that counts from 0
        stamps the others: it was sent before that began."""
        waiting, self._unstamped = self._unstamped, []
        for node in dict.fromkeys(node for node, *_ in waiting):
            stamps_ns = [stamp for stamp, *_, name, _ in self._found if name == node and stamp]
            span = Span(min(stamps_ns), max(stamps_ns)) if stamps_ns else None
            for _, message, log_ns, order in (one for one in waiting if one[0] == node):
                if span and span.counts_from_start:
                    self.refuse(node, node, log_ns, MessageError(_TOO_EARLY))
                else:
                    self._add(node, stamped(message, log_ns), order)

    def add_run(
        self, robot: str, readings: Readings, *, orders: Sequence[int], logs_ns: Sequence[int]
    ) -> None:
        """Take odometry of a robot, each message as which one, and when, it was recorded."""
        self.robots.add(robot)
        self.clocks.add(robot, readings.stamps_ns.tolist(), logs_ns)
        before = self._odometry.setdefault(robot, [])
        each = zip(readings.stamps_ns.tolist(), orders, strict=True)
        rows = enumerate(each, start=sum(map(len, before)))
        self._found += [(stamp, False, order, robot, row) for row, (stamp, order) in rows]
        before.append(readings)

    def refuse(self, node: str, topic: str, log_ns: int, reason: MessageError) -> None:
        """Count a message that is not sound, and was recorded at `log_ns`."""
        alike = node, topic, numberless(str(reason))
        self._refused.setdefault(alike, (str(reason), []))[1].append(log_ns)

    @property
    def count(self) -> int:
        """How many were taken."""
        self._settle()
        return len(self._found)

    @property
    def in_order(self) -> Iterator[tuple[str, Message | Readings]]:
        """(camera or robot, message, or odometry without others between) in stamp order, lenses
        first."""
        self._settle()
        found = sorted(self._found, key=lambda each: each[:3])
        odometry = {robot: Readings.joined(some) for robot, some in self._odometry.items()}
        for robot, some in groupby(found, lambda each: each[3] if isinstance(each[4], int) else ""):
            if robot:
                rows = np.array([row for *_, row in some])
                yield robot, odometry[robot][rows]
            else:
                yield from ((node, m) for *_, node, m in some if not isinstance(m, int))

    @property
    def unreadable(self) -> dict[str, str]:
        """Camera or robot -> what was left out of it, for those of which nothing else came."""
        sound = {node for *_, node, message in self._found if isinstance(message, Sightings)}
        refused = {node: "; ".join(self.unsound(node)) for node, *_ in self._refused}
        return {node: words for node, words in refused.items() if node not in sound | self.robots}

    def unsound(self, *nodes: str) -> list[str]:
        """What was left out, of some cameras and robots or all, by topic and what is wrong."""
        self._settle()
        return [
            f"{counted(len(times), 'message')} of {topic}: {reason} ({_words(times)})"
            for (node, topic, _), (reason, times) in self._refused.items()
            if not nodes or node in nodes
        ]


def _words(times: Sequence[int]) -> str:
    """When messages were recorded: the first of them."""
    first = ", ".join(f"{to_seconds(time):.3f}" for time in times[:_MOST_TIMES])
    return f"at {first} s{' …' if len(times) > _MOST_TIMES else ''}"


def messages_of(recording: Recording) -> SessionMessages:
    found, doubts = SessionMessages(), DoubtFilter()
    waiting = dict[str, list[tuple[int, RecordedSample]]]()
    for order, sample in enumerate(recording.samples(_TOPICS)):
        if sample.topic is topics.ODOMETRY:
            robot = topics.node_of(sample.key)
            block = waiting.setdefault(robot, [])
            block.append((order, sample))
            if len(block) == _BLOCK:
                _take_odometry(found, robot, waiting.pop(robot))
        elif sample.topic is not topics.DIAGNOSTICS or doubts.wants(sample.payload):
            _take(found, order, sample)
    for robot, block in waiting.items():
        _take_odometry(found, robot, block)
    return found


def _take_odometry(
    found: SessionMessages, robot: str, block: list[tuple[int, RecordedSample]]
) -> None:
    """Take messages of a robot as a run, or one by one if not all are sound, stamped and alike."""
    read = cdr_layout.odometry_run([sample.payload for _, sample in block])
    if read is not None and read[0].all():
        orders, logs_ns = zip(*((order, sample.log_ns) for order, sample in block), strict=True)
        found.add_run(robot, Readings(*read), orders=orders, logs_ns=logs_ns)
        return
    for order, sample in block:
        _take(found, order, sample)


def _take(found: SessionMessages, order: int, sample: RecordedSample) -> None:
    node = topics.node_of(sample.key)
    try:
        message = cdr.decode(sample.topic.type_name, sample.payload)
    except MessageError as reason:
        found.refuse(node, sample.key, sample.log_ns, reason)
    else:
        found.add(node, message, sample.log_ns, order=order)
