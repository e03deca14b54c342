"""Sessions and anybody's bags from Python: read by topic or name, and written."""

import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.api import load
from trigpoint.base.errors import InputError, MessageError
from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import (
    CAMERA_INFO,
    ODOMETRY,
    SIGHTINGS,
    CameraInfo,
    Message,
    Odometry,
    Sightings,
    stamped,
)
from trigpoint.contract.topics import Topic
from trigpoint.geometry import CameraModel, Pose
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.recorder.session.bag import PICTURES, Bag
from trigpoint.recorder.session.recording import open_recording
from trigpoint.recorder.writing.attachments import site_files
from trigpoint.site.config import load_site

from .networks import PathLike, Trajectory

_LOG = logging.getLogger(__name__)
_Kind = TypeVar("_Kind")


class Session(Struct, frozen=True, eq=False):
    """A recorded session, or anybody's bag (MCAP, rosbag2, ROS 1); messages are read when they are
    asked for.

    `topics`: each topic's type. Whatever takes a `source` takes a topic, or in a session of
    Trigpoint the name of a camera or robot. Messages that are not sound are left out, and counted
    in a warning that is logged. Raises InputError for a source that is not there.
    """

    path: Path
    topics: dict[str, str]
    _bag: Bag

    @property
    def cameras(self) -> list[str]:
        """Those of which a session has sightings or pictures; none of a bag."""
        return self._named((SIGHTINGS, *PICTURES))

    @property
    def robots(self) -> list[str]:
        """Those of which a session has odometry; none of a bag."""
        return self._named((ODOMETRY,))

    def files(self) -> dict[str, bytes]:
        """What is attached to a session: site.toml, target files, network.json; by name."""
        return open_recording(self.path).attachments

    def odometry(self, source: str) -> Trajectory:
        """A robot's odometry as it was reported, base in its odometry frame, in stamp order."""
        found = [stamped(m, log_ns) for log_ns, m in self._messages(source, ODOMETRY, Odometry)]
        found.sort(key=lambda message: message.stamp_ns)
        stamps_ns = np.array([message.stamp_ns for message in found], dtype=np.int64)
        return Trajectory(stamps_ns, Pose.stack([message.pose for message in found]))

    def sightings(self, source: str) -> list[Sightings]:
        """What a camera saw, a picture each, in stamp order."""
        found = [stamped(m, log_ns) for log_ns, m in self._messages(source, SIGHTINGS, Sightings)]
        return sorted(found, key=lambda message: message.stamp_ns)

    def lens(self, source: str) -> CameraModel | None:
        """The intrinsics that a camera announced last; None where it announced none."""
        lens = None
        for _, message in self._messages(source, CAMERA_INFO, CameraInfo):
            lens = message.camera
        return lens

    def pictures(self, source: str) -> Iterator[tuple[int, np.ndarray]]:
        """A camera's pictures as (stamp_ns, (height, width) grey), in the order of recording."""
        bag_pictures = load("trigpoint.tools.pictures.bag", "bag_pictures")  # needs OpenCV
        topic, left_out = self._topic(source, PICTURES), list[InputError]()
        for name, _, picture in bag_pictures(self.path, [topic], left_out.append):
            yield int(name.rpartition("#")[2]), picture
        if left_out:
            _LOG.warning("%d pictures left out: %s", len(left_out), left_out[0])

    def _named(self, kinds: tuple[str, ...]) -> list[str]:
        names = (topics.node_of(t.removeprefix("/")) for t, k in self.topics.items() if k in kinds)
        return sorted(set(filter(None, names)))

    def _topic(self, source: str, kinds: tuple[str, ...]) -> str:
        if source in self.topics:
            return source
        for topic, kind in self.topics.items():
            if kind in kinds and topics.node_of(topic.removeprefix("/")) == source:
                return topic
        known = ", ".join(topic for topic, kind in self.topics.items() if kind in kinds) or "none"
        raise InputError(f"{self.path}: «{source}» has no {' or '.join(kinds)}; it has {known}")

    def _messages(
        self, source: str, type_name: str, kind: type[_Kind]
    ) -> Iterator[tuple[int, _Kind]]:
        topic, left_out = self._topic(source, (type_name,)), Counter[str]()

        def refuse(_topic: str, _log_ns: int, reason: MessageError) -> None:
            left_out[str(reason)] += 1

        for one in self._bag.messages([topic], refuse):
            if not isinstance(one.message, kind):
                raise InputError(f"{self.path}: {topic} is a {self.topics[topic]}, no {type_name}")
            yield one.log_ns, one.message
        for reason, count in left_out.items():
            _LOG.warning("%s: %d messages of %s left out: %s", self.path, count, topic, reason)


def open_session(path: PathLike) -> Session:
    """Open a session (an .mcap file or a folder with one) or anybody's bag; raises RecordingError,
    an InputError, where it is neither or empty."""
    bag = Bag(Path(path))
    return Session(Path(path), dict(bag.topics), bag)


def write_session(
    path: PathLike,
    *,
    site: PathLike,
    odometry: Mapping[str, Trajectory],
    sightings: Mapping[str, Iterable[Sightings]],
    lenses: Mapping[str, CameraModel] | None = None,
) -> Path:
    """Write a session (.mcap) of one's own data, as the recorder would have, and return its path.

    `site`: the site file, attached with the files that it names. `odometry`: robot -> its base in
    its odometry frame. `sightings`: camera -> its pictures' faces, stamped. `lenses`: camera -> its
    intrinsics, of those whose site file names none. Raises InputError where a name is not in the
    site file, OperationError where the file is there already or cannot be written.
    """
    known, file = load_site(Path(site)), Path(path)
    rows: list[tuple[int, Topic, str, Message]] = []
    for robot, way in odometry.items():
        known.robot(robot)
        for index, stamp_ns in enumerate(way.stamps_ns.tolist()):
            message = Odometry(stamp_ns, f"{robot}/odom", f"{robot}/base", way.pose[index])
            rows.append((stamp_ns, topics.ODOMETRY, robot, message))
    for camera, pictures in sightings.items():
        known.camera(camera)
        for seen in pictures:
            message = replace(seen, frame_id=f"{camera}/optical")
            rows.append((seen.stamp_ns, topics.SIGHTINGS, camera, message))
    first_ns = min((stamp_ns for stamp_ns, *_ in rows), default=0)
    for camera, lens in (lenses or {}).items():
        known.camera(camera)
        message = CameraInfo(first_ns, f"{camera}/optical", lens)
        rows.append((first_ns, topics.CAMERA_INFO, camera, message))
    with McapWriter(file) as writer:
        for name, data, media_type in site_files(known):
            writer.attach(name, data, media_type, time_ns=first_ns)
        for stamp_ns, topic, node, message in sorted(rows, key=lambda row: row[0]):
            payload, key = cdr.encode(message), topic.key(known.name, node)
            writer.add(topic, key, payload, log_ns=stamp_ns, published_ns=stamp_ns)
    return file
