"""A network from above: cameras with their ellipses, ways, where to go next, what lies beneath."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec import Struct, field

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.building import Building
from trigpoint.map.network import AlternativeRecord, CameraRecord

from .floor_plan import floor_plan_image
from .frame import legend, wide_and_upright
from .plan import MARGIN, Plan, suggestion_marks
from .svg import (
    camera_colour,
    circle,
    drawing,
    element,
    ellipse_points,
    group,
    largest_factor,
    line,
    polygon,
    polyline,
    text,
    thinned,
)

WIDE, UPRIGHT = 1000.0, 420.0
"""The drawings' widths on large screens and on small ones."""
_VIEW_M = 1.15
_LARGEST_ELLIPSE = 30.0
_MOST_POINTS = 600
_ROOM_M = 0.35
_WALLS_M = 1.5
"""More room where a floor plan lies under the map, so that the walls around are on it."""


class Way(Struct, frozen=True, eq=False):
    """Where a robot went: metres (n, 2), heading (n,), and in words what this way of it is; its
    ends are marked where it is the best that is known."""

    places: Array
    headings: Array
    words: str
    kind: str = "corrected"
    is_best: bool = True


class NetworkMap(Struct, frozen=True, eq=False):
    """What is drawn: the cameras and, where it is known, where they truly are; ways; next poses,
    numbered where they are several; walls (n, 2, 2), or the building's floor plan."""

    cameras: Mapping[str, CameraRecord]
    ways: Sequence[Way]
    suggestions: Sequence[Pose] = ()
    suggestion_words: str = ""
    truth: Mapping[str, Pose] = field(default_factory=dict)
    walls: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))
    building: Building | None = None

    def figure(self) -> str:
        """The map for large screens and for small ones, with its legend; "" where it is empty."""
        if not (self.ways or any(camera.poses for camera in self._marked)):
            return ""
        factor = self.magnification(self.plan(WIDE, upright=False))
        drawings = self.drawing(WIDE, upright=False), self.drawing(UPRIGHT, upright=True)
        return wide_and_upright(*drawings, legend(self._meanings(factor)))

    def plan(self, width: float, *, upright: bool) -> Plan:
        """The drawing that holds all of it."""
        points = [way.places for way in self.ways if way.is_best]
        points += [_wedge(pose) for camera in self._marked for pose in camera.poses]
        points += [pose.translation[None, :2] for pose in self.suggestions]
        every = np.concatenate([*points, self.walls.reshape(-1, 2)])
        room = 0.0 if len(self.walls) else _ROOM_M
        if self.building is not None and self.building.plan is not None:
            room = _WALLS_M
        rim = np.stack([every.min(axis=0) - room, every.max(axis=0) + room])
        return Plan(rim, width, upright=upright)

    def magnification(self, plan: Plan) -> int:
        """How many times larger than the map errors and ellipses are drawn, so that they show."""
        largest = max((camera.size_m for camera in self._marked), default=0.0) * plan.scale
        return largest_factor(largest, _LARGEST_ELLIPSE)

    def drawing(self, width: float, *, upright: bool) -> str:
        """The whole map; errors and ellipses are larger by its `magnification`."""
        plan = self.plan(width, upright=upright)
        factor = self.magnification(plan)
        parts = [floor_plan_image(self.building, plan)] if self.building else []
        walls = (line(*start, *end) for start, end in plan(self.walls).tolist())
        parts.append(group(*walls, class_="walls"))
        parts += [camera.drawn_view(plan) for camera in self._marked]
        parts += [_way(way, plan) for way in self.ways if len(way.places)]
        parts += [camera.drawn(plan, factor) for camera in self._marked]
        parts += suggestion_marks(self.suggestions, plan)
        parts.append(_scale_bar(plan))
        label = "Map from above with the cameras, their uncertainty and the robots' ways"
        return drawing(plan.width, plan.height + 22, *parts, label=label, class_="map")

    @property
    def _marked(self) -> list["_Camera"]:
        return [
            _Camera(name, record, self.truth.get(name), camera_colour(index))
            for index, (name, record) in enumerate(self.cameras.items())
        ]

    def _meanings(self, factor: int) -> Iterator[tuple[str, str]]:
        kinds = {way.kind: way.words for way in self.ways}
        for kind, words in kinds.items():
            yield polyline(np.array([[2.0, 7.0], [32.0, 7.0]]), class_=f"way {kind}"), words
        found = element("ellipse", cx=17, cy=7, rx=14, ry=6, class_="ellipse")
        found += circle(17, 7, 2.6, class_="found")
        larger = f", drawn {factor} times larger" if factor > 1 else ""
        if self.truth:
            ring = circle(17, 7, 5, class_="true-place")
            yield ring, "where a camera truly is; the wedge shows where it looks"
            larger = f" (errors and ellipses are{larger[1:]})" if larger else ""
            yield found, f"where it was found, with its standard deviation{larger}"
        else:
            words = f"a camera with its standard deviation{larger}; the wedge: where it looks"
            yield found, words
        if any(record.alternatives for record in self.cameras.values()):
            hollow = circle(17, 7, 5, class_="outline")
            yield hollow, "where an undetermined camera may be, one of several places"
        if self.suggestions:
            yield circle(17, 7, 6, class_="next"), self.suggestion_words


class _Camera(Struct, frozen=True):
    """One camera's marks, in its colour."""

    name: str
    record: CameraRecord
    truth: Pose | None
    colour: str

    @property
    def found(self) -> Pose | None:
        located = self.record.map_from_camera
        return None if located is None else located.pose

    @property
    def view(self) -> Pose | None:
        """Which way it looks: truly, or else as it was found."""
        return self.found if self.truth is None else self.truth

    @property
    def poses(self) -> list[Pose]:
        """Everywhere that it is or may be."""
        left_open = [each.map_from_camera.pose for each in self.record.alternatives]
        return [pose for pose in (self.view, *left_open) if pose is not None]

    @property
    def size_m(self) -> float:
        """Of its ellipse or its error, whichever is larger; 0 where it is not located."""
        if self.found is None or self.view is None:
            return 0.0
        spread = np.linalg.eigvalsh(self.record.covariance_matrix[:2, :2])[-1]
        error = self.found.translation[:2] - self.view.translation[:2]
        return max(float(np.sqrt(spread)), float(np.linalg.norm(error)))

    def drawn_view(self, plan: Plan) -> str:
        if self.view is None:
            return ""
        return group(polygon(plan(_wedge(self.view)), class_="view"), class_=self.colour)

    def drawn(self, plan: Plan, factor: int) -> str:
        """The true place as a ring, what was found as a point with its ellipse, the name beside;
        places that are left open hollow, with a question mark."""
        marks = [element("title", self.name)]
        if self.truth is not None:
            marks.append(_circle(plan(self.truth.translation[:2]), 5, "true-place"))
        if self.found is not None and self.view is not None:
            seen_from = self.view.translation[:2]
            place = seen_from + factor * (self.found.translation[:2] - seen_from)
            spread = factor**2 * self.record.covariance_matrix[:2, :2]
            marks.append(polygon(plan(ellipse_points(place, spread, 1.0)), class_="ellipse"))
            marks.append(_circle(plan(place), 2.6, "found"))
        if self.view is not None:
            marks.append(_name(self.name, self.view, plan))
        left_open = [_alternative(self.name, each, plan) for each in self.record.alternatives]
        return group(*marks, *left_open, class_=self.colour)


def _alternative(name: str, place: AlternativeRecord, plan: Plan) -> str:
    pose = place.map_from_camera.pose
    return group(
        element("title", f"{name}, {100 * place.probability:.1f} %"),
        polygon(plan(_wedge(pose)), class_="outline"),
        _circle(plan(pose.translation[:2]), 4.5, "outline"),
        _name(f"{name}?", pose, plan),
    )


def _wedge(map_from_camera: Pose) -> Array:
    """Which way a camera looks, (n, 2) metres: from its eye to a rim."""
    eye, forward = map_from_camera.translation[:2], map_from_camera.rotation[:2, 2]
    angles = np.arctan2(forward[1], forward[0]) + np.radians(np.linspace(-30, 30, 13))
    rim = eye + _VIEW_M * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.vstack([eye, rim])


def _name(words: str, map_from_camera: Pose, plan: Plan) -> str:
    """In the wedge, where the camera looks."""
    wedge = _wedge(map_from_camera)
    x, y = plan(wedge[0] + 0.62 * (wedge[1:].mean(axis=0) - wedge[0]))
    return text(x, y + 5, words, class_="name")


def _way(way: Way, plan: Plan) -> str:
    """A line; a ring at the start and an arrow at the end of the best known one."""
    drawn = polyline(plan(thinned(way.places, _MOST_POINTS)), class_=f"way {way.kind}")
    if not way.is_best:
        return drawn
    unit = 7.0 / plan.scale
    outline = np.array([[1.6, 0.0], [-1.0, 1.1], [-0.4, 0.0], [-1.0, -1.1]]) * unit
    end = Pose.planar(0.0, 0.0, way.headings[-1])
    arrow = plan(way.places[-1] + outline @ end.rotation[:2, :2].T)
    return drawn + _circle(plan(way.places[0]), 4.5, "start") + polygon(arrow, class_="end")


def _circle(middle: Array, radius: float, kind: str) -> str:
    return circle(float(middle[0]), float(middle[1]), radius, class_=kind)


def _scale_bar(plan: Plan) -> str:
    """One metre."""
    y, end = plan.height + 6, MARGIN + plan.scale
    bar = (
        line(MARGIN, y, end, y) + line(MARGIN, y - 4, MARGIN, y + 4) + line(end, y - 4, end, y + 4)
    )
    return group(bar, text(end + 8, y + 4.5, "1 m"), class_="scale")
