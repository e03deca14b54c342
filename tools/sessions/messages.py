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
from trigpoint.fusion.model.readings import Readings
from trigpoint.recorder.session.recording import RecordedSample, Recording

_MOST_TIMES = 3
# Odometry of a robot that is read at once, in messages; their bytes are held until then.
_BLOCK = 4096
_TOPICS = (topics.CAMERA_INFO, topics.ODOMETRY, topics.SIGHTINGS, topics.DIAGNOSTICS)


class SessionMessages:
    """What of a session can be used, and what cannot. `misdescribed`: camera -> what its pictures
    show in place of the target file's boards; `robots`: those of which there is odometry."""

    def __init__(self) -> None:
        self.misdescribed: dict[str, str] = {}
        self.robots: set[str] = set()
        self._found: list[tuple[int, bool, int, str, Message | int]] = []
        self._odometry: dict[str, list[Readings]] = {}
        self._refused: dict[tuple[str, str, str], tuple[str, list[int]]] = {}

    def add(self, node: str, message: Message, log_ns: int, *, order: int) -> None:
        """Take a message of a camera or robot that was recorded at `log_ns`, as the `order`-th."""
        stamp_ns = 0
        if isinstance(message, Odometry | Sightings):
            message = stamped(message, log_ns)
            stamp_ns = message.stamp_ns
        if isinstance(message, Diagnostics):
            stamp_ns = message.stamp_ns
        if isinstance(message, Odometry):
            self.robots.add(node)
        self._found.append((stamp_ns, isinstance(message, Sightings), order, node, message))

    def add_run(self, robot: str, readings: Readings, *, orders: Sequence[int]) -> None:
        """Take odometry of a robot, each message as which one it was recorded."""
        self.robots.add(robot)
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
        return len(self._found)

    @property
    def in_order(self) -> Iterator[tuple[str, Message | Readings]]:
        """(camera or robot, message, or odometry without others between) in stamp order, lenses
        first."""
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
        found.add_run(robot, Readings(*read), orders=[order for order, _ in block])
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
