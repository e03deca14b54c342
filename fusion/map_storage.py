"""The messages that a map is made of, on their way to its checkpoint and back."""

import logging
from collections.abc import Callable, Iterator
from pathlib import Path

from trigpoint.base.clock import Clock
from trigpoint.base.errors import MessageError, OperationError
from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import CameraInfo, Diagnostics, Message, Odometry, Sightings
from trigpoint.site.config import Site

from .checkpoint import Checkpoint
from .intake.admission import AHEAD_NS
from .standing_odometry import StandingOdometry

_log = logging.getLogger(__name__)


class MapStorage:
    """The checkpoint of one map. Not thread-safe.

    `knows`: whether the site file still has the camera or robot of a key.
    """

    def __init__(
        self, path: Path, site: Site, clock: Clock, *, knows: Callable[[str], bool]
    ) -> None:
        self._path, self._site, self._knows = path, site, knows
        self._checkpoint = Checkpoint(path, clock)
        self._begin()

    def _begin(self) -> None:
        self._odometry = {
            name: StandingOdometry(planar=robot.planar) for name, robot in self._site.robots.items()
        }

    @property
    def trouble(self) -> str:
        """Why what comes now is not stored; "" while all is well."""
        return self._checkpoint.trouble

    def records(self) -> Iterator[tuple[str, bytes]]:
        """(key, payload) of what was stored before this process began."""
        return self._checkpoint.records()

    def message(self, key: str, payload: bytes) -> Message | None:
        """The message of a record; None where it is not to be used. Raises OperationError where the
        checkpoint is another site's."""
        topic = topics.topic_of(key)
        if topic is None or not key.startswith(f"{self._site.name}/"):
            raise OperationError(
                f"{self._path}: a checkpoint of another site ({key}); give another --out"
            )
        if topic is not topics.DIAGNOSTICS and not self._knows(key):
            return None
        try:
            message = cdr.decode(topic.type_name, payload)
        except MessageError as reason:
            _log.error("%s: a message on %s is left out: %s", self._path, key, reason)
            return None
        assert isinstance(message, CameraInfo | Diagnostics | Odometry | Sightings)
        # All of the file came before it was written last.
        if message.stamp_ns > self._checkpoint.written_ns + AHEAD_NS:
            _log.error(
                "%s: a message on %s is stamped ahead of its time; left out", self._path, key
            )
            return None
        return message

    def store(self, key: str, payload: bytes, message: Message) -> int:
        """Store a message, but of a standing robot's odometry only what is needed; returns how many
        messages the disk did not take."""
        payloads = [payload]
        if isinstance(message, Odometry):
            payloads = self._odometry[topics.node_of(key)].take(message, payload)
        if isinstance(message, Sightings):
            for odometry in self._odometry.values():
                odometry.want(message.stamp_ns)
        return sum(not self._checkpoint.write(key, item) for item in payloads)

    def flush(self) -> None:
        """Hand what was stored to the disk, at most twice a second."""
        self._checkpoint.flush()

    def restart(self) -> None:
        """Begin a new map; the old one's file is kept under another name."""
        self._checkpoint.restart()
        self._begin()

    def close(self) -> None:
        """Store what was held back, and close the file."""
        for robot, odometry in self._odometry.items():
            key = topics.ODOMETRY.key(self._site.name, robot)
            for payload in odometry.rest():
                self._checkpoint.write(key, payload)
        self._checkpoint.close()
