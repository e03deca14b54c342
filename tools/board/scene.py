"""Cameras and robots as the page shows them, from the messages of the bus. Pure: no bus, no clock.

Lengths are rounded to millimetres, angles to milliradians, times to whole seconds, so that what
cannot be seen is not sent.
"""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.base.errors import MessageError
from trigpoint.contract import topics
from trigpoint.contract.messages import Message, Polygon, PoseStamped
from trigpoint.contract.topics import Topic
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.tools.site.state import number_said

from .entities import Entities, Fields

LOCATED, UNDETERMINED, UNSEEN = "located", "undetermined", "unseen"
STALE_NS = {"camera": to_ns(5.0), "robot": to_ns(2.0)}
"""After so long without a pose an entity is stale: cameras are announced every second, robots with
each of their odometry's messages."""
_GIVEN_UP_NS = to_ns(10.0)
"""A camera that is not announced for so long, while others are, is not located any more."""
_GOAL_NS = to_ns(30.0)
_SEEN_STEP_S = 2
_ELLIPSE_95 = math.sqrt(-2 * math.log(0.05))
"""Half-axes of the ellipse that holds a point of a plane with 95 %, in sigmas."""
_OUTLINE_M = 0.05
_FURTHEST_M = 1e6
"""No site is so large, and no uncertainty within it."""


class Scene:
    """What is known of each camera and robot. Times are when a message was received, ns."""

    def __init__(self, site: str, cameras: Iterable[str], robots: Iterable[str]) -> None:
        robots = tuple(robots)
        self._fields: Entities = {f"camera/{name}": {"state": UNSEEN} for name in cameras}
        self._fields |= {
            f"robot/{name}": {"stale": True, "index": i} for i, name in enumerate(robots)
        }
        self._corrections = {
            f"robot/{name}": f"sent {topics.CORRECTION.key(site, name)}" for name in robots
        }
        self._corrected: dict[str, float] = {}
        self._posed_ns: dict[str, int] = {}
        self._goal_ns: dict[str, int] = {}
        self._dirty = set(self._fields)

    def take(self, topic: Topic, name: str, message: Message, received_ns: int) -> None:
        """Raise MessageError where a message is of a place that is on no site."""
        kind = topic.path.partition("/")[0]
        entity = f"{'robot' if kind == 'robot' else 'camera'}/{name}"
        if isinstance(message, PoseStamped):
            check_places(message.pose.translation)
            self._goal_ns[entity] = received_ns
            self._set(entity, {"goal": _plane(Pose.stack([message.pose]))[0]})
        elif isinstance(message, Polygon):
            check_places(message.points)
            self._set(entity, {"floor": _outline(message.points[:, :2])})

    def take_poses(
        self, entities: Sequence[str], poses: Pose, covariances: Array, received_ns: Sequence[int]
    ) -> None:
        """Take where some cameras are, or some robots; `poses`: (n), `covariances`: (n, 6, 6), all
        of them sound."""
        is_robots = entities[0].startswith("robot/")
        shown = (_robots if is_robots else _cameras)(poses, _uncertainty(covariances))
        for entity, fields, at_ns in zip(entities, shown, received_ns, strict=True):
            self._posed_ns[entity] = at_ns
            self._set(entity, fields)

    def report(self, node: str, values: Mapping[str, str], received_ns: int) -> None:
        """Take what a node reports once a second. A camera's agent says how many faces it found and
        fusion whom it corrected, so sightings and corrections, thousands a second, need not come
        here."""
        kind, _, name = node.partition("/")
        if kind == "edge":
            self._report_faces(f"camera/{name}", values, received_ns)
        elif kind == "fusion":
            for robot, counter in self._corrections.items():
                if f"{counter}.total" in values:
                    self._report_corrections(robot, counter, values, received_ns)

    def _report_corrections(
        self, robot: str, counter: str, values: Mapping[str, str], received_ns: int
    ) -> None:
        """Compare with the last total heard, as the report between may be lost; a smaller one is
        that of a fusion which has started anew. Of the first one heard, the rate says how old."""
        total, before = number_said(values[f"{counter}.total"]), self._corrected.get(robot)
        self._corrected[robot] = total
        is_first_new = before is None and number_said(values.get(f"{counter}.rate", "")) > 0
        if is_first_new or (before is not None and 0 < total != before):
            self._set(robot, {"fixed": round(to_seconds(received_ns))})

    def _report_faces(self, entity: str, values: Mapping[str, str], received_ns: int) -> None:
        if entity not in self._fields or number_said(values.get("faces.total", "")) <= 0:
            return
        if self._fields[entity]["state"] == UNSEEN:
            self._set(entity, {"state": UNDETERMINED})
        if number_said(values.get("faces.rate", "")) > 0:
            seen_s = round(to_seconds(received_ns))
            self._set(entity, {"seen": seen_s // _SEEN_STEP_S * _SEEN_STEP_S})

    def changed(self) -> Entities:
        """The entities that may have changed since the last call."""
        found = {name: self._fields[name] for name in self._dirty}
        self._dirty.clear()
        return found

    def age(self, now_ns: int) -> None:
        """Take what time alone changes."""
        camera_ns = max((ns for n, ns in self._posed_ns.items() if n[0] == "c"), default=0)
        for entity, posed_ns in self._posed_ns.items():
            kind = entity.partition("/")[0]
            is_stale = now_ns - posed_ns > STALE_NS[kind]
            if is_stale != self._fields[entity].get("stale", False):
                self._set(entity, {"stale": is_stale})
            is_given_up = kind == "camera" and camera_ns - posed_ns > _GIVEN_UP_NS
            if is_given_up and self._fields[entity]["state"] == LOCATED:
                self._set(entity, {"state": UNDETERMINED})
        for entity in [e for e, ns in self._goal_ns.items() if now_ns - ns > _GOAL_NS]:
            del self._goal_ns[entity]
            self._set(entity, {"goal": None})

    def _set(self, entity: str, fields: Fields) -> None:
        self._fields[entity] = self._fields[entity] | fields
        self._dirty.add(entity)


def check_places(points: Array) -> None:
    """Raise MessageError where one of the points (…, 3) is on no site."""
    if np.abs(points).max(initial=0.0) > _FURTHEST_M:
        raise MessageError(f"a position lies more than {_FURTHEST_M:g} m from the origin")


def are_sound(poses: Pose, covariances: Array) -> NDArray[np.bool_]:
    """Whether each of the poses (n) with covariances (n, 6, 6) can be of something on a site."""
    is_near = np.abs(poses.translation).max(axis=1) <= _FURTHEST_M
    is_known = np.abs(covariances).max(axis=(1, 2)) <= _FURTHEST_M**2
    return is_near & is_known & (covariances.diagonal(axis1=1, axis2=2) >= 0).all(axis=1)


def _robots(poses: Pose, uncertainty: list[Fields]) -> list[Fields]:
    places = zip(_plane(poses), uncertainty, strict=True)
    return [{"at": at, "stale": False, **known} for at, known in places]


def _cameras(poses: Pose, uncertainty: list[Fields]) -> list[Fields]:
    """`look`: azimuth and elevation of the optical axis."""
    ahead = poses.rotation[:, :, 2]
    azimuth, elevation = np.arctan2(ahead[:, 1], ahead[:, 0]), np.arcsin(ahead[:, 2].clip(-1, 1))
    looks = _rounded(np.stack([azimuth, elevation], axis=1))
    places = zip(_rounded(poses.translation), looks, uncertainty, strict=True)
    return [
        {"state": LOCATED, "stale": False, "at": at, "look": look, **known}
        for at, look, known in places
    ]


def _plane(poses: Pose) -> list[list[float]]:
    """x, y, heading of each."""
    return _rounded(np.column_stack([poses.translation[:, :2], poses.heading]))


def _rounded(values: Array) -> list[list[float]]:
    return np.round(values, 3).tolist()


def _uncertainty(covariances: Array) -> list[Fields]:
    """Of each pose. `sigma`: root of the position's trace, m, as the viewer says it; `turn`: of the
    heading, rad; `ellipse`: half-axes on the floor that hold 95 %, m, and the longer one's
    direction."""
    a, b, c, height, turn = covariances[:, [0, 0, 1, 2, 5], [0, 1, 1, 2, 5]].T
    middle, apart = (a + c) / 2, np.hypot((a - c) / 2, b)  # the eigenvalues, ± apart
    variances = np.stack([a + c + height, turn, middle + apart, middle - apart])
    sigmas = np.sqrt(np.maximum(0.0, variances)).T.tolist()
    directions = np.round(np.arctan2(2 * b, a - c) / 2 % math.pi, 1).tolist()
    return [
        {
            "sigma": _two_digits(sigma),
            "turn": _two_digits(turned),
            "ellipse": [_two_digits(_ELLIPSE_95 * axis) for axis in axes] + [direction],
        }
        for (sigma, turned, *axes), direction in zip(sigmas, directions, strict=True)
    ]


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def _outline(points: Array) -> list[float]:
    """x and y in turn, without the points that lie within 5 cm of a line between others."""
    kept = _simplified(points) if len(points) > 2 else points
    return [round(value, 2) for value in kept.reshape(-1).tolist()]


def _simplified(points: Array) -> Array:
    """The open line (n, 2) after Douglas and Peucker, without recursion: a bus's polygon may be
    long."""
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    spans = [(0, len(points) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        along = points[last] - points[first]
        off = points[first + 1 : last] - points[first]
        length = float(np.hypot(*along))
        if length > 0:
            away = np.abs(off[:, 0] * along[1] - off[:, 1] * along[0]) / length
        else:
            away = np.hypot(off[:, 0], off[:, 1])
        furthest = int(np.argmax(away))
        if away[furthest] > _OUTLINE_M:
            middle = first + 1 + furthest
            keep[middle] = True
            spans += [(first, middle), (middle, last)]
    return points[keep]
