"""A site whose truth is a function of time, put on a bus as fusion and the agents put it."""

import math
from collections.abc import Callable

import numpy as np
from msgspec import Struct

from trigpoint.bus.bus import Bus, Publisher
from trigpoint.contract import topics
from trigpoint.contract.cdr import encode
from trigpoint.contract.messages import (
    Diagnostics,
    DiagnosticStatus,
    FaceSighting,
    Message,
    Polygon,
    PoseEstimate,
    PoseStamped,
    Sightings,
)
from trigpoint.contract.topics import Topic, alive_key
from trigpoint.geometry import Pose
from trigpoint.site.config import Site
from trigpoint.testing.views import looking_at

_SPACING_M = 4.0
_ROUND_S = 40.0


class Truth(Struct, frozen=True):
    """Where everything is: cameras on a grid 3 m high, looking down towards the middle; robots on
    circles around it, or still where `is_still`."""

    cameras: int
    robots: int
    is_still: bool = False

    @property
    def size_m(self) -> float:
        """Of the square that the cameras stand in."""
        return _SPACING_M * (self._side - 1)

    @property
    def _side(self) -> int:
        return max(2, math.ceil(math.sqrt(self.cameras)))

    def camera(self, index: int) -> Pose:
        """map_from_camera."""
        row, column = divmod(index, self._side)
        eye = np.array([_SPACING_M * column, _SPACING_M * row, 3.0])
        middle = np.array([self.size_m / 2 + 0.1, self.size_m / 2 + 0.2, 0.0])
        return looking_at(eye, middle)

    def robot(self, index: int, time_s: float) -> tuple[float, float, float]:
        """x, y, heading."""
        turned = 2 * math.pi * ((0.0 if self.is_still else time_s / _ROUND_S) + index / self.robots)
        radius = 0.15 * self.size_m + 0.3 * self.size_m * (index % 3) / 3 + 0.5
        x = self.size_m / 2 + radius * math.cos(turned)
        y = self.size_m / 2 + radius * math.sin(turned)
        return x, y, math.remainder(turned + math.pi / 2, 2 * math.pi)


class BoardSite:
    """Publishes it. `unlocated`: cameras, by index, that see the target and are not located;
    `unseen`: those that see nothing."""

    def __init__(
        self,
        bus: Bus,
        site: Site,
        truth: Truth,
        *,
        unlocated: frozenset[int] = frozenset(),
        unseen: frozenset[int] = frozenset(),
    ) -> None:
        self._bus, self._site, self.truth = bus, site, truth
        self._unlocated, self._unseen = unlocated, unseen
        self._cameras, self._robots = list(site.cameras), list(site.robots)
        self._publishers: dict[str, Publisher] = {}
        self._tokens = {
            name: bus.declare_alive(alive_key(site.name, *name.split("/"))) for name in self.nodes
        }
        self.troubles: dict[str, str] = {}

    @property
    def nodes(self) -> list[str]:
        """kind/name of all of them."""
        agents = [f"edge/{name}" for name in self._cameras]
        return [*agents, *(f"robot/{name}" for name in self._robots), "fusion/fusion"]

    def put(self, topic: Topic, name: str, message: Message) -> None:
        """Send one message."""
        key = topic.key(self._site.name, name)
        if key not in self._publishers:
            self._publishers[key] = self._bus.publisher(topic, key)
        self._publishers[key].put(encode(message))

    def announce(self, time_s: float) -> None:
        """Say what is said once a second: located cameras, what they see, everybody's state."""
        stamp_ns = round(1e9 * time_s)
        for index, name in enumerate(self._cameras):
            if index not in self._unlocated | self._unseen:
                pose = self.truth.camera(index)
                covariance = np.diag([1e-4, 4e-4, 1e-4, 1e-5, 1e-5, 1e-5])
                self.put(topics.CAMERA_POSE, name, PoseEstimate(stamp_ns, "map", pose, covariance))
        for index, name in enumerate(self._robots):
            x, y, heading = self.truth.robot(index, time_s + 5.0)
            goal = PoseStamped(stamp_ns, "map", Pose.planar(x, y, heading))
            self.put(topics.SUGGESTION, name, goal)
        self._report(stamp_ns, time_s)

    def cover(self) -> None:
        """Say which floor each located camera sees: as long a polygon as fusion's."""
        for index, name in enumerate(self._cameras):
            if index in self._unlocated | self._unseen:
                continue
            pose = self.truth.camera(index)
            ahead = math.atan2(pose.rotation[1, 2], pose.rotation[0, 2])
            angles = ahead + np.radians(np.linspace(-35, 35, 38))
            rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(38)], axis=-1)
            foot = pose.translation * [1, 1, 0]
            far = np.round(5.0 + 0.6 * np.sin(9 * angles), 1)[:, None]
            points = foot + np.concatenate([rays * far, rays[::-1] * 1.5])
            self.put(topics.COVERAGE, name, Polygon(0, "map", points))

    def move(self, time_s: float) -> None:
        """Say what is said ten times a second: sightings, the robots' poses and corrections."""
        stamp_ns = round(1e9 * time_s)
        for index, name in enumerate(self._cameras):
            faces = () if index in self._unseen else (_face(index),)
            sightings = Sightings(stamp_ns, f"{name}/optical", 640, 480, faces)
            self.put(topics.SIGHTINGS, name, sightings)
        for index, name in enumerate(self._robots):
            wobble = 1 + 0.3 * math.sin(time_s + index)
            covariance = wobble * np.diag([4e-4, 1e-4, 0.0, 0.0, 0.0, 1e-4])
            pose = Pose.planar(*self.truth.robot(index, time_s))
            estimate = PoseEstimate(stamp_ns, "map", pose, covariance)
            self.put(topics.ROBOT_POSE, name, estimate)
            self.put(topics.CORRECTION, name, estimate)

    def end(self, node: str) -> None:
        """Let one node disappear."""
        self._tokens.pop(node).close()

    def _report(self, stamp_ns: int, time_s: float) -> None:
        for index, node in enumerate(list(self._tokens)):
            trouble = self.troubles.get(node, "")
            status = DiagnosticStatus(
                2 if trouble else 0,
                node,
                trouble or "running",
                "lab-pc",
                self._values(node, time_s, index) | {"last_error": trouble},
            )
            self.put(topics.DIAGNOSTICS, "", Diagnostics(stamp_ns, (status,)))

    def _values(self, node: str, time_s: float, index: int) -> dict[str, str]:
        unsteady = round(10 + 0.2 * math.sin(time_s + index), 1)
        values = {"node": node, "version": "0.1.0", "contract": "1", "uptime": f"{time_s:.1f}"}
        if node.startswith("edge/"):
            values |= {"pictures.rate": f"{unsteady}", "pictures.total": "1000"}
            faces = 0.0 if index in self._unseen else 9.9
            values |= {"faces.rate": f"{faces}", "faces.total": f"{100 * faces:.0f}"}
            values |= {"picture_age_s": "0.1", "source": "running"}
        elif node.startswith("robot/"):
            values |= {"odom.rate": f"{5 * unsteady:.1f}", "odom.total": "5000"}
        else:
            values |= {f"sent {key}.rate": f"{unsteady}" for key in self._publishers}
            values |= {f"sent {key}.total": f"{10 * time_s:.0f}" for key in self._publishers}
        return values


def _face(index: int) -> FaceSighting:
    ids = np.arange(24, dtype=np.uint16)
    pixels = np.stack([200 + 20.0 * (ids % 6), 150 + 20.0 * (ids // 6)], axis=-1)
    return FaceSighting("two-plane", index % 3, ids, pixels.astype(np.float32), 0.1)


def run(site: BoardSite, clock: Callable[[], float], is_over: Callable[[], bool]) -> None:
    """Publish in real time until it is over."""
    import time

    site.cover()
    turn = 0
    begin = clock()
    while not is_over():
        now = clock()
        if turn % 10 == 0:
            site.announce(now)
        site.move(now)
        turn += 1
        time.sleep(max(0.0, begin + 0.1 * turn - clock()))
