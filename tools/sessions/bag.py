"""Reads any bag as a session for `calibrate`: which topic is which camera or robot."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from msgspec import Struct

from trigpoint.base.errors import InputError, MessageError
from trigpoint.contract.messages import (
    CAMERA_INFO,
    ODOMETRY,
    SIGHTINGS,
    Message,
    Picture,
    Sightings,
)
from trigpoint.edge.detector import TargetDetector, detector_for
from trigpoint.edge.image.picture import as_grey
from trigpoint.fusion.model.inputs import Inputs
from trigpoint.recorder.session.bag import PICTURES, Bag, BagMessage, RawImage
from trigpoint.tools.pictures.bag import grey_of

from .messages import SessionMessages


class Role(Struct, frozen=True):
    """What a topic is: of the camera or robot `name`."""

    name: str
    topic: str


def parse_roles(texts: Sequence[str]) -> list[Role]:
    """«c1=/front/image_raw» …; raise InputError for anything else."""
    roles = []
    for text in texts:
        name, separator, topic = text.partition("=")
        if not separator or not name or not topic:
            raise InputError(
                f"--topic {text}: say whose it is, like c1=/front/image_raw or r1=/odom"
            )
        roles.append(Role(name.strip(), topic.strip()))
    for role in roles:
        names = [other.name for other in roles if other.topic == role.topic]
        if len(names) > 1:
            raise InputError(f"--topic: {role.topic} is given {_times(names)}")
    return roles


def _times(names: Sequence[str]) -> str:
    """How often a topic is given, and what to do; `names`: whose it is, each time."""
    count = "twice" if len(names) == 2 else f"{len(names)} times"
    if len(set(names)) == 1:
        return f"{count} for {names[0]}; once is enough"
    return f"{count}, as {' and '.join(names)}; each topic is one camera's or robot's"


def bag_messages(path: Path, roles: Sequence[Role], inputs: Inputs) -> SessionMessages:
    """The messages of cameras and robots; pictures are searched for the site's targets.

    The camera_info beside a camera's pictures is taken by itself. Raises InputError where a role
    or a topic does not fit.
    """
    bag, found = Bag(path), SessionMessages()
    names = _names(path, bag, roles, inputs)
    targets = list({t.name: t for t in inputs.targets.values()}.values())
    detectors = {name: detector_for(targets) for name in inputs.site.cameras}

    def refuse(topic: str, log_ns: int, reason: MessageError) -> None:
        found.refuse(names[topic], topic, log_ns, reason)

    for order, one in enumerate(bag.messages(list(names), refuse)):
        name = names[one.topic]
        try:
            message = _as_message(one, name, detectors)
        except MessageError as reason:
            refuse(one.topic, one.log_ns, reason)
            continue
        found.add(name, message, one.log_ns, order=order)
    found.misdescribed = {
        name: "; ".join(detector.misdescribed)
        for name, detector in detectors.items()
        if detector.misdescribed
    }
    return found


def _names(path: Path, bag: Bag, roles: Sequence[Role], inputs: Inputs) -> Mapping[str, str]:
    """Topic -> camera or robot, each fitting its type."""
    names: dict[str, str] = {}
    site = inputs.site

    def is_info(topic: str) -> bool:
        return bag.topics.get(topic) == CAMERA_INFO

    for role in roles:
        kind = bag.topics.get(role.topic)
        of_camera = kind in (*PICTURES, CAMERA_INFO, SIGHTINGS)
        if kind is not None and (of_camera or kind == ODOMETRY):
            (site.camera if of_camera else site.robot)(role.name)
        before = [t for t, name in names.items() if name == role.name and not is_info(t)]
        if before and not is_info(role.topic):
            raise InputError(
                f"--topic gives {role.name} both {before[0]} and {role.topic}: give one of them; "
                "two cameras or robots need two names"
            )
        names[role.topic] = role.name
        if kind in PICTURES:
            for beside in _infos_beside(role.topic):
                if is_info(beside):
                    names.setdefault(beside, role.name)
    robot, camera = next(iter(site.robots), "r1"), next(iter(site.cameras), "c1")
    for kinds, whose, name in (
        ((ODOMETRY,), "the odometry of a robot", robot),
        ((*PICTURES, SIGHTINGS), "what a camera saw", camera),
    ):
        there = sorted(topic for topic, kind in bag.topics.items() if kind in kinds)
        if there and not any(topic in there for topic in names):
            raise InputError(
                f"{path}: no --topic names {whose}; there is {', '.join(there)}: "
                f"add --topic {name}={there[0]}"
            )
    return names


def _infos_beside(topic: str) -> Iterator[str]:
    """The camera_info topic beside a picture topic, as ROS names it, without the transport."""
    parent = topic
    for _ in range(2):
        parent = parent.rpartition("/")[0]
        yield f"{parent}/camera_info"


def _as_message(one: BagMessage, name: str, detectors: Mapping[str, TargetDetector]) -> Message:
    message = one.message
    if not isinstance(message, (Picture, RawImage)):
        return message
    grey = as_grey(grey_of(message))
    height, width = grey.shape
    return Sightings(
        message.stamp_ns, f"{name}/optical", width, height, detectors[name].detect(grey)
    )
