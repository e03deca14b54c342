"""Writes a simulated drive as a recorded session, by the contract."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class _Item:
    received_ns: int
    topic: Topic
    key: str
    message: Message


def write_session(world: World, directory: Path) -> dict[str, int]:
    """Write session.mcap, the site's files and the truth; return how many messages a key has.

    Raises OperationError where there is a session already, or the disk does not take it.
    """
    with writing(directory):
        directory.mkdir(parents=True, exist_ok=True)
    with McapWriter(directory / "session.mcap") as writer:
        with writing(directory):
            site = write_site(world, directory)
            write_truth(world, directory, epoch_ns=EPOCH_NS)
        for path in [site, *sorted(directory.glob("*target.toml"))]:
            writer.attach(path.name, path.read_bytes(), "application/toml", time_ns=EPOCH_NS)
        for item in sorted(_told(world), key=lambda item: item.received_ns):
            payload, received_ns = cdr.encode(item.message), item.received_ns
            writer.add(item.topic, item.key, payload, log_ns=received_ns, published_ns=received_ns)
    return writer.counts


def _told(world: World) -> Iterator[_Item]:
    """The items, with a word on how far their drawing is: sightings take nearly all of it."""
    pictures = sum(_count(world, camera) for camera in world.cameras)
    with closing(Progress("simulate", pictures)) as progress:
        for item in _items(world):
            progress.step(item.topic is topics.SIGHTINGS)
            yield item


def _items(world: World) -> Iterator[_Item]:
    for camera in world.cameras:
        yield _camera_info(world, camera)
        yield from _sightings(world, camera)
    for robot in world.robots:
        yield from _odometry(world, robot)


def _camera_info(world: World, camera: str) -> _Item:
    message = CameraInfo(EPOCH_NS, f"{camera}/optical", world.cameras[camera].model)
    key = topics.CAMERA_INFO.key(world.site_name, camera)
    return _Item(EPOCH_NS, topics.CAMERA_INFO, key, message)


def _sightings(world: World, camera: str) -> Iterator[_Item]:
    eye, topic = world.cameras[camera], topics.SIGHTINGS
    size = (eye.model.width, eye.model.height)
    times_s = eye.time_of(np.arange(_count(world, camera)))
    for t_s, stamp_ns in zip(times_s, stamps_ns(times_s, EPOCH_NS), strict=True):
        faces = world.sightings(camera, float(t_s))
        message = Sightings(int(stamp_ns), f"{camera}/optical", *size, faces)
        key = topic.key(world.site_name, camera)
        yield _Item(int(stamp_ns) + _DETECTION_NS, topic, key, message)


def _count(world: World, camera: str) -> int:
    """How many pictures a camera takes."""
    eye = world.cameras[camera]
    return int(np.floor((world.duration_s - eye.phase) * eye.rate)) + 1


def _odometry(world: World, robot: str) -> Iterator[_Item]:
    log, topic = world.odometry(robot), topics.ODOMETRY
    for i, stamp_ns in enumerate(stamps_ns(log.stamps_s, EPOCH_NS)):
        message = Odometry(int(stamp_ns), f"{robot}/odom", f"{robot}/base", log.poses[i])
        key = topic.key(world.site_name, robot)
        yield _Item(int(stamp_ns) + _SERIAL_NS, topic, key, message)
