"""A small session with everything in it: a robot on a loop, cameras, drawn pictures, poses."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec import Struct

from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import (
    CameraInfo,
    Diagnostics,
    DiagnosticStatus,
    FaceSighting,
    Message,
    OccupancyGrid,
    Odometry,
    Picture,
    Polygon,
    PoseArray,
    PoseEstimate,
    PoseStamped,
    Sightings,
    Transform,
    Transforms,
)
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array, about_z
from trigpoint.geometry.uncertainty import planar_covariance
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.site.target import Target, parse_target
from trigpoint.testing.views import looking_at

START_NS = 1_760_000_000_000_000_000
CAMERAS = ("c1", "c2", "c3", "c4")
UNLOCATED = "c4"

SITE = """site = "lab"
target = "target.toml"

[cameras.c1]
source = "dir://c1"
[cameras.c2]
source = "dir://c2"
[cameras.c3]
source = "dir://c3"
[cameras.c4]
source = "dir://c4"

[robots.r1]
port = "loop://"
"""


def target_text() -> str:
    """Three upright boards around the robot, facing outwards at 0°, 120° and 240°."""
    faces = []
    for index in range(3):
        turn = about_z(2 * math.pi * index / 3)
        # Face axes in the base: x to the viewer's right, y down, z into the board.
        board = turn @ np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
        middle = turn @ np.array([0.15, -0.12, 0.62])
        pose = Pose(board, middle)
        faces.append(
            f'[[faces]]\nid = {index}\npattern = "charuco"\ncolumns = 5\nrows = 4\nsquare = 0.08\n'
            f'marker = 0.06\ndictionary = "DICT_4X4_50"\nfirst_marker = {10 * index}\n'
            f"translation = {pose.translation.tolist()}\nquaternion = {pose.quaternion.tolist()}\n"
        )
    return 'name = "three"\n' + "\n".join(faces)


TARGET = target_text()


class Sent(Struct, frozen=True):
    """One message of the session."""

    topic: topics.Topic
    key: str
    stamp_ns: int
    message: Message

    @property
    def payload(self) -> bytes:
        return cdr.encode(self.message)


class Story:
    """What happens in the lab, as a function of time."""

    def __init__(self, seconds: float = 20.0, rate: float = 20.0) -> None:
        self.times = np.arange(0, seconds, 1 / rate)
        self.seconds = seconds
        self.target: Target = parse_target(TARGET)
        self.lens = CameraModel.from_field_of_view(640, 480, math.radians(60))
        self.lens = self.lens.with_parameters([*self.lens.parameters[:4], -0.2, 0.03, 0, 0, 0])
        self.poses = {
            "c1": looking_at([0.2, 0.2, 2.4], [2.6, 2.0, 0.4]),
            "c2": looking_at([7.8, 0.2, 2.4], [5.4, 2.0, 0.4]),
            "c3": looking_at([4.0, 5.8, 2.4], [4.0, 3.4, 0.4]),
            "c4": looking_at([0.2, 5.8, 2.4], [2.6, 4.0, 0.4]),
        }

    def map_from_base(self, t: float) -> Pose:
        angle = 2 * math.pi * t / self.seconds
        x, y = 4 + 2.6 * math.cos(angle), 3 + 1.8 * math.sin(angle)
        heading = math.atan2(1.8 * math.cos(angle), -2.6 * math.sin(angle))
        return Pose.planar(x, y, heading)

    def odom_from_base(self, t: float) -> Pose:
        """Odometry that turns away slowly, in the map's frame at the start."""
        pose = self.map_from_base(t)
        start = self.map_from_base(0.0).translation
        off = Pose(about_z(0.012 * t), np.zeros(3))
        moved = off @ (pose.translation - start) + start
        return Pose(off.rotation @ pose.rotation, moved)

    def messages(self) -> Iterator[Sent]:
        for camera in CAMERAS[:3]:
            info = CameraInfo(START_NS, f"{camera}/optical", self.lens)
            yield self._sent(topics.CAMERA_INFO, camera, 0.0, info)
        for index, t in enumerate(self.times):
            yield from self._robot(float(t), index)
            if index % 4 == 0:
                yield from self._cameras(float(t), with_picture=index % 8 == 0)
            if index % 20 == 0:
                yield from self._services(float(t), index)

    def _robot(self, t: float, index: int) -> Iterator[Sent]:
        stamp_ns = START_NS + round(t * 1e9)
        odom = self.odom_from_base(t)
        message = Odometry(stamp_ns, "r1/odom", "r1/base", odom)
        yield self._sent(topics.ODOMETRY, "r1", t, message)
        covariance = planar_covariance(np.diag([0.03**2, 0.015**2, 0.01**2]))
        pose = PoseEstimate(stamp_ns, "map", self.map_from_base(t), covariance)
        yield self._sent(topics.ROBOT_POSE, "r1", t, pose)
        if index % 10 == 5:
            yield self._sent(topics.CORRECTION, "r1", t, pose)
        map_from_odom = self.map_from_base(t) @ odom.inverse()
        moves = (
            Transform(stamp_ns, "map", "r1/odom", map_from_odom),
            Transform(stamp_ns, "r1/odom", "r1/base", odom),
        )
        yield self._sent(topics.TF, "", t, Transforms(moves))

    def _cameras(self, t: float, *, with_picture: bool) -> Iterator[Sent]:
        stamp_ns = START_NS + round(t * 1e9)
        for camera in CAMERAS:
            faces = self.sighted(camera, t)
            frame = f"{camera}/optical"
            sightings = Sightings(stamp_ns, frame, self.lens.width, self.lens.height, faces)
            yield self._sent(topics.SIGHTINGS, camera, t, sightings)
            if with_picture:
                picture = Picture(stamp_ns, frame, "jpeg", self.picture(camera, t))
                yield self._sent(topics.IMAGE, camera, t, picture)

    def _services(self, t: float, index: int) -> Iterator[Sent]:
        stamp_ns = START_NS + round(t * 1e9)
        for number, camera in enumerate(CAMERAS[:3]):
            if t < 2 + 2 * number:
                continue
            sigma = 0.05 / math.sqrt(1 + t)
            turn = about_z(0.6)
            position = turn @ np.diag([sigma**2, (sigma / 2) ** 2, (sigma / 4) ** 2]) @ turn.T
            covariance = np.diag([0.0, 0, 0, 1e-5, 1e-5, 1e-5])
            covariance[:3, :3] = position
            pose = PoseEstimate(stamp_ns, "map", self.poses[camera], covariance)
            yield self._sent(topics.CAMERA_POSE, camera, t, pose)
            polygon = Polygon(stamp_ns, "map", self.floor_seen(camera))
            yield self._sent(topics.COVERAGE, camera, t, polygon)
        values = np.arange(-1, 101, dtype=np.int8).reshape(6, 17)
        grid = OccupancyGrid(stamp_ns, "map", 0.5, Pose.planar(-1.0, -1.0, 0.0), values)
        yield self._sent(topics.COVERAGE_GRID, "", t, grid)
        level, text = (1, "2 samples lost") if index == 200 else (0, "ok")
        status = DiagnosticStatus(level, "edge/c1", text, "machine", {"rate": "10.0"})
        yield self._sent(topics.DIAGNOSTICS, "", t, Diagnostics(stamp_ns, (status,)))
        suggestion = PoseStamped(stamp_ns, "map", Pose.planar(2.0, 5.0, 0.0))
        yield self._sent(topics.SUGGESTION, "r1", t, suggestion)
        cloud = Pose.planar(np.linspace(5, 6, 5), np.linspace(3, 4, 5), np.zeros(5))
        yield self._sent(topics.PARTICLES, "r1", t, PoseArray(stamp_ns, "map", cloud))

    def sighted(self, camera: str, t: float) -> tuple[FaceSighting, ...]:
        camera_from_base = self.poses[camera].inverse() @ self.map_from_base(t)
        found = []
        for face in self.target.faces:
            camera_from_face = camera_from_base @ face.base_from_face
            points = camera_from_face @ face.corners
            inward = camera_from_face.rotation[:, 2]
            if inward @ camera_from_face.translation < 0.3 * np.linalg.norm(points[0]):
                continue
            if np.all(self.lens.sees(points)):
                corners = np.arange(face.corner_count, dtype=np.uint16)
                pixels = self.lens.project(points).astype(np.float32)
                found.append(FaceSighting("three", face.id, corners, pixels, 0.2))
        return tuple(found)

    def picture(self, camera: str, t: float) -> bytes:
        """A drawn JPEG: the tiled floor, the walls and the target's boards."""
        image = np.full((self.lens.height, self.lens.width, 3), (150, 145, 140), np.uint8)
        camera_from_map = self.poses[camera].inverse()
        for x in range(16):
            for y in range(12):
                shade = 205 if (x + y) % 2 else 185
                tile = 0.5 * np.array([[x, y, 0], [x + 1, y, 0], [x + 1, y + 1, 0], [x, y + 1, 0]])
                self._fill(image, camera_from_map @ tile, (shade, shade, shade))
        camera_from_base = camera_from_map @ self.map_from_base(t)
        for face in self.target.faces:
            camera_from_face = camera_from_base @ face.base_from_face
            if camera_from_face.rotation[:, 2] @ camera_from_face.translation > 0:
                self._draw_board(image, camera_from_face, face.columns, face.rows, face.square)
        return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()

    def _draw_board(
        self, image: np.ndarray, camera_from_face: Pose, columns: int, rows: int, square: float
    ) -> None:
        for row in range(rows):
            for column in range(columns):
                shade = 30 if (row + column) % 2 == 0 else 245
                low = np.array([column - 1, row - 1, 0.0]) * square
                quad = low + square * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
                self._fill(image, camera_from_face @ quad, (shade, shade, shade))

    def _fill(self, image: np.ndarray, points: Array, colour: tuple[int, int, int]) -> None:
        if np.all(points[:, 2] > 0.3) and np.any(self.lens.sees(points)):
            pixels = np.round(self.lens.project(points) * 16).astype(np.int32)
            cv2.fillPoly(image, [pixels], colour, cv2.LINE_AA, 4)

    def floor_seen(self, camera: str) -> Array:
        position = self.poses[camera].translation
        ahead = self.poses[camera].rotation[:, 2]
        heading = math.atan2(ahead[1], ahead[0])
        angles = heading + np.linspace(-0.6, 0.6, 9)
        near = [
            [position[0] + 0.8 * math.cos(a), position[1] + 0.8 * math.sin(a), 0] for a in angles
        ]
        far = [[position[0] + 4 * math.cos(a), position[1] + 4 * math.sin(a), 0] for a in angles]
        return np.array([*near, *far[::-1]])

    def _sent(self, topic: topics.Topic, node: str, t: float, message: Message) -> Sent:
        return Sent(topic, topic.key("lab", node), START_NS + round(t * 1e9), message)


def write_session(path: Path, sent: list[Sent]) -> Path:
    """A session file with these messages and the lab's files attached."""
    writer = McapWriter(path)
    writer.attach("site.toml", SITE.encode(), "application/toml", time_ns=START_NS)
    writer.attach("target.toml", TARGET.encode(), "application/toml", time_ns=START_NS)
    for one in sent:
        writer.add(
            one.topic,
            one.key,
            one.payload,
            log_ns=one.stamp_ns + 1_000_000,
            published_ns=one.stamp_ns,
        )
    writer.finish()
    return path


@pytest.fixture(scope="session")
def lab() -> Story:
    """The lab itself, by time."""
    return Story()


@pytest.fixture(scope="session")
def story() -> list[Sent]:
    """Four seconds of everything."""
    return list(Story(seconds=4.0, rate=20.0).messages())


@pytest.fixture(scope="session")
def session_file(story: list[Sent], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The story as a session file."""
    return write_session(tmp_path_factory.mktemp("session") / "session.mcap", story)


@pytest.fixture
def make_session(tmp_path: Path) -> Callable[[list[Sent]], Path]:
    """Write messages of a test's own choice."""
    return lambda sent: write_session(tmp_path / "session.mcap", sent)


@pytest.fixture
def site_folder(tmp_path: Path) -> Path:
    """A folder with the story's site file and target file."""
    (tmp_path / "site.toml").write_text(SITE)
    (tmp_path / "target.toml").write_text(TARGET)
    return tmp_path
