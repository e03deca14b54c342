"""From the bus's messages to what rerun shows: one mapping for `view` and `review`."""

from collections import deque

import numpy as np
import rerun as rr

from trigpoint.base.errors import MessageError
from trigpoint.contract.messages import (
    CameraInfo,
    Diagnostics,
    DiagnosticStatus,
    Message,
    OccupancyGrid,
    Odometry,
    Picture,
    Polygon,
    PoseArray,
    PoseEstimate,
    PoseStamped,
    Sightings,
    Transforms,
)
from trigpoint.contract.topics import CAMERA_POSE, CORRECTION, ROBOT_POSE, Topic
from trigpoint.geometry.rotation import Array
from trigpoint.map.floor_plan import FloorPlan
from trigpoint.site.config import Site
from trigpoint.site.target import Target

from . import style
from .building import BuildingScene
from .camera import CameraScene
from .columns import Columns
from .log import LogLine
from .pixel_residuals import Eye, RobotTrack, residual_of
from .robot import RobotScene

_ROOMY = 8
"""Cameras whose labels in the map, with their sigmas, still stand beside each other."""
_UNJUDGED = 256
_LEVELS = ("INFO", "WARN", "ERROR", "WARN")


class Scene:
    """A site in rerun; used by one thread. Messages of cameras and robots that the site does not
    have are left out and counted."""

    def __init__(
        self,
        site: Site,
        targets: dict[str, Target],
        columns: Columns,
        *,
        plan: FloorPlan | None = None,
    ) -> None:
        """`targets`: by robot, as far as they are known; `plan`: the site's floor plan."""
        self._site, self._columns, self._log = site, columns, LogLine(columns)
        is_crowded = len(site.cameras) > _ROOMY
        self.cameras = {
            name: CameraScene(
                name, index, camera.nominal(), columns, self._log, is_crowded=is_crowded
            )
            for index, (name, camera) in enumerate(site.cameras.items())
        }
        self.robots = {
            name: RobotScene(name, i, targets.get(name), columns, is_first=name == site.first_robot)
            for i, name in enumerate(site.robots)
        }
        self._building = BuildingScene(site, plan, columns, self._log)
        self._targets = targets
        self._tracks = {robot: RobotTrack() for robot in targets}
        self._unjudged: deque[tuple[str, Sightings]] = deque(maxlen=_UNJUDGED)
        self._said: dict[str, tuple[int, str]] = {}
        self._held: dict[str, tuple[int, DiagnosticStatus]] = {}
        self._first_ns = self._last_ns = 0
        self.strangers = 0

    def announce(self) -> None:
        """Send what holds at every time."""
        self._columns.fixed("/map", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._columns.fixed(
            style.LEGEND, rr.TextDocument(_legend(self._site), media_type=_MARKDOWN)
        )
        for part in (self._building, *self.cameras.values(), *self.robots.values()):
            part.announce()

    def add(self, topic: Topic, node: str, message: Message, received_ns: int = 0) -> None:
        """Show one message; `node`: the camera or robot that its key names; `received_ns`: when it
        came, 0 where that is not known."""
        if received_ns and node in self.cameras and isinstance(message, Sightings):
            self.cameras[node].add_latency(message.stamp_ns, received_ns)
        if isinstance(message, Diagnostics):
            self._add_diagnostics(message)
        elif isinstance(message, Transforms):
            self._add_transforms(message)
        elif isinstance(message, OccupancyGrid):
            self._building.add_grid(message)
        elif node in self.cameras and isinstance(message, Polygon):
            self._add_coverage(node, message)
        elif node in self.cameras and topic.path.startswith("camera/"):
            self._add_to_camera(self.cameras[node], topic, message)
        elif node in self.robots and topic.path.startswith("robot/"):
            self._add_to_robot(self.robots[node], topic, message)
        else:
            self.strangers += 1

    def finish(self) -> None:
        """Send what still waits for more; then flush the columns."""
        self._release(None)
        for camera in self.cameras.values():
            camera.finish(self._last_ns)
        for robot in self.robots.values():
            robot.finish()
        self._building.finish(self._last_ns)

    @property
    def extent(self) -> tuple[Array, Array] | None:
        """The box around what stands in the map, as two corners (3,); None where nothing does."""
        points = [camera.position for camera in self.cameras.values()]
        corners = [point for point in points if point is not None]
        for robot in self.robots.values():
            corners.extend(robot.extent)
        if not corners:
            return None
        return np.min(corners, axis=0), np.max(corners, axis=0)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """The first and the last stamp of what was measured; None where nothing was."""
        return (self._first_ns, self._last_ns) if self._last_ns > self._first_ns else None

    @property
    def size_m(self) -> float:
        """The longest side of the extent, 0 where nothing stands in the map."""
        extent = self.extent
        return float(np.max(extent[1] - extent[0])) if extent else 0.0

    def _add_to_camera(self, camera: CameraScene, topic: Topic, message: Message) -> None:
        match message:
            case CameraInfo():
                camera.add_info(message)
            case PoseEstimate() if topic is CAMERA_POSE:
                camera.add_pose(message)
                self._building.add_camera(camera.name, message)
            case Picture():
                camera.add_picture(message)
            case Sightings():
                self._measured(message.stamp_ns)
                camera.add_sightings(message)
                if message.faces and camera.estimate is not None:
                    self._unjudged.append((camera.name, message))
                    self._judge()
            case _:
                raise MessageError(f"{topic.name}: nothing is shown of a {type(message).__name__}")

    def _judge(self) -> None:
        """Hold sightings against where the robots were, once that is known for their moment."""
        while self._unjudged and self._is_covered(self._unjudged[0][1].stamp_ns):
            name, message = self._unjudged.popleft()
            camera = self.cameras[name]
            assert camera.estimate is not None  # else it does not wait here
            eye = Eye(camera.estimate, camera.lens, self._site.cameras[name].time_offset_sigma)
            found = [
                residual_of(face, message.stamp_ns, eye, self._tracks, self._targets)
                for face in message.faces
            ]
            camera.add_residuals(message, found)

    def _is_covered(self, stamp_ns: int) -> bool:
        return any(track.covers(stamp_ns) for track in self._tracks.values())

    def _add_to_robot(self, robot: RobotScene, topic: Topic, message: Message) -> None:
        match message:
            case Odometry():
                self._measured(message.stamp_ns)
                robot.add_odometry(message)
            case PoseEstimate() if topic is ROBOT_POSE:
                robot.add_pose(message)
                self._building.add_robot(robot.name, message)
                if robot.name in self._tracks:
                    self._tracks[robot.name].add(message)
                    self._judge()
            case PoseEstimate() if topic is CORRECTION:
                robot.add_correction(message)
            case PoseStamped():
                robot.add_suggestion(message)
            case PoseArray():
                robot.add_particles(message)
            case _:
                raise MessageError(f"{topic.name}: nothing is shown of a {type(message).__name__}")

    def _add_transforms(self, message: Transforms) -> None:
        for transform in message.transforms:
            robot, separator, frame = transform.child.partition("/")
            if transform.parent == "map" and separator and frame == "odom" and robot in self.robots:
                self.robots[robot].place_odometry(transform.pose)

    def _add_coverage(self, camera: str, message: Polygon) -> None:
        colour = style.camera_colour(list(self.cameras).index(camera))
        closed = (
            [np.concatenate([message.points, message.points[:1]])] if len(message.points) else []
        )
        self._columns.row(
            f"/map/coverage/{camera}",
            message.stamp_ns,
            rr.LineStrips3D,
            strips=closed,
            colors=[(*colour, 150)] * len(closed),
            radii=[style.ui_points(1.2)] * len(closed),
        )

    def _measured(self, stamp_ns: int) -> None:
        """Follow the time of the measurements, and say what waited for it."""
        self._first_ns = self._first_ns or stamp_ns
        self._last_ns = max(self._last_ns, stamp_ns)
        if self._held:
            self._release(self._last_ns)

    def _add_diagnostics(self, message: Diagnostics) -> None:
        """Diagnostics stand at the newest measurement's time: in a replay their own is far away."""
        for status in message.statuses:
            if self._last_ns:
                self._say(self._last_ns, status)
            else:
                self._held[status.name] = message.stamp_ns, status

    def _release(self, stamp_ns: int | None) -> None:
        held, self._held = self._held, {}
        for own_ns, status in held.values():
            self._say(own_ns if stamp_ns is None else stamp_ns, status)

    def _say(self, stamp_ns: int, status: DiagnosticStatus) -> None:
        """A line where a node's state changes; what it repeats every second is left out."""
        state = (status.level, status.message if status.level else "")
        if self._said.get(status.name) == state:
            return
        self._said[status.name] = state
        level = _LEVELS[status.level]
        self._log(stamp_ns, level, f"{status.name}: {status.message}")


_MARKDOWN = "text/markdown"


def _legend(site: Site) -> str:
    return (
        f"## {site.name}\n"
        "**Blue line**: the robot's path as corrected by the cameras (further robots: other "
        "colours)  \n"
        "**Orange line**: the same drive by odometry alone  \n"
        "**White dots**: corrections that the robot was sent  \n"
        "**Pyramids**: the located cameras with their newest picture  \n"
        f"**Ellipsoids**: a position's {style.SIGMAS_DRAWN:.0f} sigma, drawn "
        f"{style.MAGNIFIED:.0f} times larger; the label says one sigma  \n"
        "**Green, white**: the truth, another network, where they lie beside the session  \n"
        "**Plots**: sigmas as decimal logarithms: 0 is 1 cm (1 mrad), -1 a tenth  \n"
        "**Outlines on the floor**: where a camera sees the target  \n"
        "**Dots in the pictures**: where the target has been seen so far  \n"
        "**Yellow lines in the pictures**: from each corner to where it should be, by the poses of "
        f"robot and camera, {style.RESIDUALS_DRAWN:.0f} times larger  \n"
        "**Red in the pictures**: a sighting that is off by more than these explain, and where it "
        "should be  \n"
        "**Floor, green to brown**: how well a robot is corrected there, to 0 … 99 mm and more; "
        "red: not at all  \n"
        "**Under the map**: the floor plan, where the site file has one; it hides the coloured "
        "floor\n"
    )
