"""Writes a simulated drive as a recorded session, by the contract."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from operator import itemgetter
from pathlib import Path

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import writing
from trigpoint.base.terminal import Progress
from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import CameraInfo, Message, Odometry, Sightings
from trigpoint.contract.topics import Topic
from trigpoint.recorder.mcap.writer import McapWriter

from .site_files import stamps_ns, write_site, write_truth
from .world import World

EPOCH_NS = 1_700_000_000_000_000_000  # a fixed moment, so that a seed always gives the same bytes
_DETECTION_NS = to_ns(0.02)  # from exposure to the recorder
_SERIAL_NS = to_ns(0.002)  # from encoder reading to the recorder


Item = tuple[int, Topic, str, Message]
"""When the recorder gets it, ns, its topic, and whose message it is."""


def write_session(world: World, directory: Path) -> dict[str, int]:
    """Write session.mcap, the site's files and the truth; return how many messages a key has.

    Raises OperationError where there is a session already, or the disk does not take it.
    """

    def write_files() -> list[Path]:
        site = write_site(world, directory)
        write_truth(world, directory, epoch_ns=EPOCH_NS)
        return [site, *sorted(directory.glob("*target.toml"))]

    items = sorted(_told(world), key=itemgetter(0))
    return write_recording(directory, world.site_name, write_files, items)


def write_recording(
    directory: Path, site: str, write_files: Callable[[], Iterable[Path]], items: Iterable[Item]
) -> dict[str, int]:
    """Write the messages of a site, with the files that `write_files` writes beside them and that
    are attached; as `write_session`."""
    with writing(directory):
        directory.mkdir(parents=True, exist_ok=True)
    with McapWriter(directory / "session.mcap") as writer:
        with writing(directory):
            files = write_files()
        for path in files:
            writer.attach(path.name, path.read_bytes(), "application/toml", time_ns=EPOCH_NS)
        for received_ns, topic, node, message in items:
            key, payload = topic.key(site, node), cdr.encode(message)
            writer.add(topic, key, payload, log_ns=received_ns, published_ns=received_ns)
    return writer.counts


def _told(world: World) -> Iterator[Item]:
    """The items, with a word on how far their drawing is: sightings take nearly all of it."""
    pictures = sum(len(eye.picture_times(world.duration_s)) for eye in world.cameras.values())
    with closing(Progress("simulate", pictures)) as progress:
        for item in _items(world):
            progress.step(item[1] is topics.SIGHTINGS)
            yield item


def _items(world: World) -> Iterator[Item]:
    for name, eye in world.cameras.items():
        frame, size = f"{name}/optical", (eye.model.width, eye.model.height)
        yield EPOCH_NS, topics.CAMERA_INFO, name, CameraInfo(EPOCH_NS, frame, eye.model)
        times_s = eye.picture_times(world.duration_s)
        for t_s, stamp_ns in zip(times_s.tolist(), _stamps(times_s), strict=True):
            message = Sightings(stamp_ns, frame, *size, world.sightings(name, t_s))
            yield stamp_ns + _DETECTION_NS, topics.SIGHTINGS, name, message
    for name in world.robots:
        log = world.odometry(name)
        for i, stamp_ns in enumerate(_stamps(log.stamps_s)):
            message = Odometry(stamp_ns, f"{name}/odom", f"{name}/base", log.poses[i])
            yield stamp_ns + _SERIAL_NS, topics.ODOMETRY, name, message


def _stamps(times_s: np.ndarray) -> list[int]:
    return stamps_ns(times_s, EPOCH_NS).tolist()
