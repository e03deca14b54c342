"""The messages of a session, or of anybody's bag, on their way to the estimator."""

from collections.abc import Sequence

from trigpoint.base.clock import to_seconds
from trigpoint.base.errors import MessageError
from trigpoint.base.words import counted, numberless
from trigpoint.contract import cdr, topics
from trigpoint.contract.clock_doubt import DoubtFilter
from trigpoint.contract.messages import Diagnostics, Message, Odometry, Sightings, stamped
from trigpoint.recorder.session.recording import Recording

_MOST_TIMES = 3
_TOPICS = (topics.CAMERA_INFO, topics.ODOMETRY, topics.SIGHTINGS, topics.DIAGNOSTICS)


class SessionMessages:
    """What of a session can be used, and what cannot. `misdescribed`: camera -> what its pictures
    show in place of the target file's boards."""

    def __init__(self) -> None:
        self.misdescribed: dict[str, str] = {}
        self._found: list[tuple[int, int, int, str, Message]] = []
        self._refused: dict[tuple[str, str, str], tuple[str, list[int]]] = {}

    def add(self, node: str, message: Message, log_ns: int) -> None:
        """Take a message of a camera or robot that was recorded at `log_ns`."""
        stamp_ns = 0
        if isinstance(message, Odometry | Sightings):
            message = stamped(message, log_ns)
            stamp_ns = message.stamp_ns
        if isinstance(message, Diagnostics):
            stamp_ns = message.stamp_ns
        is_sightings = isinstance(message, Sightings)
        self._found.append((stamp_ns, is_sightings, len(self._found), node, message))

    def refuse(self, node: str, topic: str, log_ns: int, reason: MessageError) -> None:
        """Count a message that is not sound, and was recorded at `log_ns`."""
        alike = node, topic, numberless(str(reason))
        self._refused.setdefault(alike, (str(reason), []))[1].append(log_ns)

    @property
    def count(self) -> int:
        """How many were taken."""
        return len(self._found)

    @property
    def in_order(self) -> list[tuple[str, Message]]:
        """(camera or robot, message) in stamp order, lenses first."""
        return [(node, message) for *_, node, message in sorted(self._found, key=lambda f: f[:3])]

    @property
    def robots(self) -> set[str]:
        """Those of which there is odometry."""
        return {node for *_, node, message in self._found if isinstance(message, Odometry)}

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
    for sample in recording.samples(_TOPICS):
        node = topics.node_of(sample.key)
        if sample.topic is topics.DIAGNOSTICS and not doubts.wants(sample.payload):
            continue
        try:
            message = cdr.decode(sample.topic.type_name, sample.payload)
        except MessageError as reason:
            found.refuse(node, sample.key, sample.log_ns, reason)
            continue
        found.add(node, message, sample.log_ns)
    return found
