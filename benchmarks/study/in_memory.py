"""A simulated session in memory: the messages that an estimator gets, and what an oracle knows."""

from collections.abc import Iterator
from operator import itemgetter

import numpy as np
from msgspec import Struct, field

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Message, Odometry, Sightings
from trigpoint.geometry import CameraModel, Pose
from trigpoint.tools.simulation.session import EPOCH_NS
from trigpoint.tools.simulation.sight.seen_corners import SeenFace, may_be_seen
from trigpoint.tools.simulation.world import Shown, World

from .disturbance import Disturbance, disturbed, disturbed_sighting, with_ways

Views = dict[str, list[tuple[float, dict[str, list[SeenFace]]]]]
"""Of each camera: the times of its pictures and the faces of each robot in them, without noise."""


class Simulated(Struct, frozen=True, eq=False):
    """`messages`: (camera or robot, message) in the order in which they arrive. What an oracle
    knows of them: `world`, as it truly was; `sighted`: (camera, stamp) to what each sighting of
    that picture shows, in the message's order."""

    world: World
    messages: list[tuple[str, Message]] = field(default_factory=list)
    sighted: dict[tuple[str, int], tuple[Shown, ...]] = field(default_factory=dict)

    @property
    def cameras(self) -> dict[str, Pose]:
        """map_from_camera at the end."""
        end_s = self.world.duration_s
        return {n: c.map_from_camera_at(end_s) for n, c in self.world.cameras.items()}

    @property
    def lenses(self) -> dict[str, CameraModel]:
        return {name: camera.model for name, camera in self.world.cameras.items()}

    def moved_ns(self, camera: str) -> list[int]:
        """When a camera was moved while the session lasted."""
        moves = self.world.cameras[camera].moves
        return [EPOCH_NS + to_ns(move.at_s) for move in moves if move.at_s > 0]

    def lifted_ns(self, robot: str) -> list[int]:
        return [EPOCH_NS + to_ns(lift.at_s) for lift in self.world.robots[robot].lifts]

    def map_from_base(self, robot: str, stamps_ns: np.ndarray) -> Pose:
        """A robot's true poses at true times (n,)."""
        return self.world.map_from_base(robot, (np.asarray(stamps_ns) - EPOCH_NS) / 1e9)


def simulated(world: World, disturbance: Disturbance) -> Simulated:
    """A session of a world under a disturbance, its true ways by the letter of the contract."""
    actual = with_ways(disturbed(world, disturbance))
    views = views_of(actual)
    session = Simulated(actual)
    arrivals: list[tuple[int, str, Message]] = []
    for robot in actual.robots:
        arrivals += [(m.stamp_ns, robot, m) for m in _odometry(actual, robot, disturbance)]
    for camera in actual.cameras:
        # A picture comes after the odometry that is no younger.
        arrivals += [
            (message.stamp_ns + late_ns + 1, camera, message)
            for message, late_ns in _sightings(session, camera, views[camera], disturbance)
        ]
    arrivals.sort(key=itemgetter(0))
    session.messages.extend((node, message) for _, node, message in arrivals)
    return session


def views_of(world: World) -> Views:
    """What the cameras see of the robots, without noise."""
    views: Views = {}
    for name, camera in world.cameras.items():
        times_s = camera.picture_times(world.duration_s)
        maybe = np.zeros(len(times_s), dtype=bool)
        for robot in world.robots.values():
            poses = robot.map_from_base(times_s)
            for moment_s in (0.0, *(move.at_s for move in camera.moves)):
                hung = camera.map_from_camera_at(moment_s)
                maybe |= may_be_seen(robot.carried, poses, hung, camera.model)
        times_s = times_s[maybe]
        seen = {robot: world.seen_each(name, robot, times_s) for robot in world.robots}
        each = [dict(zip(seen, faces, strict=True)) for faces in zip(*seen.values(), strict=True)]
        views[name] = [
            (t_s, faces)
            for t_s, faces in zip(times_s.tolist(), each, strict=True)
            if any(faces.values())
        ]
    return views


def _odometry(world: World, robot: str, disturbance: Disturbance) -> Iterator[Odometry]:
    log = world.odometry(robot)
    for index, t_s in enumerate(log.stamps_s.tolist()):
        if any(start_s < t_s < end_s for start_s, end_s in disturbance.gaps_s):
            continue
        stamp_ns = EPOCH_NS + to_ns(t_s)
        yield Odometry(stamp_ns, f"{robot}/odom", f"{robot}/base", log.poses[index])


def _sightings(
    session: Simulated,
    camera: str,
    views: list[tuple[float, dict[str, list[SeenFace]]]],
    disturbance: Disturbance,
) -> Iterator[tuple[Sightings, int]]:
    """The messages of a camera that have a sighting, and how late each one is."""
    world, eye = session.world, session.world.cameras[camera]
    taken: list[tuple[float, tuple[Shown, ...]]] = []
    for t_s, seen in views:
        random = world.random("wrong sightings", camera, round(t_s * 1e6))
        faces = tuple(
            disturbed_sighting(shown, world.target(shown.robot), disturbance, random)
            for shown in world.shown(camera, t_s, seen)
        )
        if faces:
            taken.append((t_s, faces))
    if camera in disturbance.pictures:
        taken = _best(taken, disturbance.pictures[camera])
    for t_s, faces in taken:
        stamp_ns = EPOCH_NS + to_ns(t_s + eye.time_offset_s)
        session.sighted[camera, stamp_ns] = faces
        size = (eye.model.width, eye.model.height)
        sent = tuple(face.sighting for face in faces)
        message = Sightings(stamp_ns, f"{camera}/optical", *size, sent)
        random = world.random("delivery", camera, round(t_s * 1e6))
        late, twice = random.random(2)
        late_ns = to_ns(disturbance.late_s) if late < disturbance.late_share else 0
        yield message, late_ns
        if twice < disturbance.twice_share:
            yield message, late_ns + to_ns(0.05)


def _best(
    taken: list[tuple[float, tuple[Shown, ...]]], most: int
) -> list[tuple[float, tuple[Shown, ...]]]:
    """The pictures with the most corners, at most so many, in order of time."""
    counts = [-sum(len(face.sighting.corners) for face in faces) for _, faces in taken]
    chosen = sorted(np.argsort(counts, kind="stable")[:most].tolist())
    return [taken[index] for index in chosen]
