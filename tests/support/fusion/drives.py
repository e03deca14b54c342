"""Simulated drives for the tests of fusion: what robots report, what cameras see, and the truth.

The noise comes as the contract states it: the report first, and the truth is the report with scale
errors and a random walk. The truth has a step of its own, half an odometry period, so that pictures
fall on odometry messages and between them.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.contract import cdr
from trigpoint.contract.messages import CameraInfo, FaceSighting, Message, Odometry, Sightings
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.inbox import INPUT_TOPICS, Input
from trigpoint.fusion.intake.message_intake import Intake
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.pipeline import Inputs, Output, Pipeline
from trigpoint.fusion.replaying import replayed
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import PoseRecord, encode_tum
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.site.config import OdometryNoise, parse_site
from trigpoint.site.target import Target
from trigpoint.testing.views import looking_at
from trigpoint.tools.networks.truth import NetworkError, TruthFile, network_error
from trigpoint.tools.shapes.text import target_text
from trigpoint.tools.simulation.motion.odometry import chained_in_space, scattered_in_space
from trigpoint.tools.simulation.sight.seen_corners import SeenFace, seen_faces_each
from trigpoint.tools.simulation.sight.targets import target_of

EPOCH_NS = 1_700_000_000_000_000_000
STEP_S = 0.025
_SMALLEST_SQUARE_PX = 6.0

Sent = Input

Way = Callable[[Array], Pose]


def lens(horizontal_deg: float = 62.0, distortion: tuple[float, ...] = (-0.2, 0.05)) -> CameraModel:
    """A camera of 640 × 480."""
    plain = CameraModel.from_field_of_view(640, 480, np.radians(horizontal_deg))
    return replace(plain, distortion=(*distortion, *[0.0] * (5 - len(distortion))))


def circle(*, radius: float = 1.2, speed: float = 0.4, hold_s: float = 0.5) -> Way:
    """Anticlockwise from the origin, after standing for a moment."""

    def at(seconds: Array) -> Pose:
        turn = np.maximum(seconds - hold_s, 0.0) * speed / radius
        return Pose.planar(radius * np.sin(turn), radius * (1 - np.cos(turn)), turn)

    return at


def straight(*, speed: float = 0.4, hold_s: float = 0.5) -> Way:
    """Along x."""
    return lambda seconds: Pose.planar(
        np.maximum(seconds - hold_s, 0.0) * speed, 0.0, 0.0 * seconds
    )


def turning(*, rate: float = 0.6) -> Way:
    """On the spot."""
    return lambda seconds: Pose.planar(0.0, 0.0, rate * seconds)


def standing() -> Way:
    return turning(rate=0.0)


class CameraPlan(Struct, frozen=True):
    """A camera as it truly is; `told`: the lens that fusion is told, None: the true one."""

    map_from_camera: Pose
    lens: CameraModel = field(default_factory=lens)
    told: CameraModel | None = None
    time_offset_s: float = 0.0
    more: str = ""


class RobotPlan(Struct, frozen=True):
    """A robot: `way`: odom_from_base as it is reported, by seconds (n,); `scales`: true errors."""

    way: Way
    target: Target
    noise: OdometryNoise = field(default_factory=OdometryNoise)
    planar: bool = True
    scales: tuple[float, float] = (0.0, 0.0)
    map_from_odom: Pose = field(default_factory=Pose.identity)


class Plan(Struct, frozen=True):
    """A whole drive. `sigma`: of a corner's coordinate as it is drawn; `stated`: as it is said."""

    cameras: dict[str, CameraPlan]
    robots: dict[str, RobotPlan]
    seconds: float = 22.0
    picture_rate: float = 2.0
    sigma: float = 0.15
    stated: float = 0.15
    seed: int = 1
    more: str = ""


class Session(Struct, frozen=True):
    """What came in, in order of the stamps, and the truth: map_from_base every STEP_S."""

    plan: Plan
    inputs: Inputs
    messages: tuple[tuple[str, Sent], ...]
    truth: dict[str, Pose]

    def map_from_base(self, robot: str, true_ns: int) -> Pose:
        """The true pose at a moment that is a multiple of STEP_S."""
        return self.truth[robot][round((true_ns - EPOCH_NS) / to_ns(STEP_S))]

    @property
    def truth_file(self) -> TruthFile:
        """The truth as it lies beside a session."""
        cameras = {n: PoseRecord.of(c.map_from_camera) for n, c in self.plan.cameras.items()}
        return TruthFile(cameras, {name: f"{name}_truth.tum" for name in self.plan.robots})

    def error(self, results: Results) -> NetworkError:
        """The located cameras against the truth."""
        return network_error(results.network, results.covariance, self.truth_file)


def lab_cameras(count: int = 3, *, radius: float = 1.2, more: str = "") -> dict[str, CameraPlan]:
    """Cameras around the circle of `circle`, each looking at its own part of it."""
    cameras = {}
    for index in range(count):
        angle = -np.pi / 2 + 2 * np.pi * index / count
        out = np.array([np.cos(angle), np.sin(angle)])
        eye = np.array([0, radius]) + (radius + 1.0) * out
        goal = np.array([0, radius]) + radius * out
        pose = looking_at((*eye, 1.6), (*goal, 0.65))
        model = lens(52.0 + index, (-0.2 + 0.01 * index, 0.05))
        cameras[f"c{index + 1}"] = CameraPlan(pose, model, more=more)
    return cameras


def lab_plan(target: str = "charuco", **changes: object) -> Plan:
    """Three cameras around one robot on a circle."""
    robot = RobotPlan(circle(), target_of(target))
    return replace(Plan(lab_cameras(), {"r1": robot}), **changes)  # pyright: ignore[reportArgumentType]


def two_robots() -> dict[str, RobotPlan]:
    """With targets that may be taken for each other's; their odometry has the same stamps."""
    return {
        "r1": RobotPlan(circle(), target_of("charuco")),
        "r2": RobotPlan(circle(radius=0.9), target_of("checkerboard")),
    }


STANDS_S = 60.0


def standing_plan() -> Plan:
    """The lab's robot stands before its first camera for STANDS_S before it drives."""
    plan = lab_plan()
    robot = RobotPlan(circle(hold_s=STANDS_S), target_of("charuco"))
    return replace(plan, robots={"r1": robot}, seconds=STANDS_S + plan.seconds)


def make_session(plan: Plan) -> Session:
    """Simulate a drive."""
    truth, found = {}, []
    for name, robot in plan.robots.items():
        random = np.random.default_rng([plan.seed, len(truth)])
        count = round(plan.seconds / STEP_S) + 1
        reported = robot.way(np.arange(count) * STEP_S)
        truth[name] = _truth(robot, reported, random)
        for index in range(0, count, 2):
            stamp_ns = EPOCH_NS + index * to_ns(STEP_S)
            message = Odometry(stamp_ns, f"{name}/odom", f"{name}/base", reported[index])
            found.append((stamp_ns, 0, name, message))
    found += [(m.stamp_ns, 1, name, m) for name, m in pictures_of(plan, truth)]
    found.sort(key=lambda item: item[:3])
    return Session(plan, _inputs(plan), tuple((n, m) for *_, n, m in found), truth)


def with_moved(session: Session, camera: str, pose: Pose, at_s: float) -> Session:
    """The same session, but that a camera hangs elsewhere from a moment on."""
    plan = session.plan
    moved = {**plan.cameras, camera: replace(plan.cameras[camera], map_from_camera=pose)}
    at_ns = EPOCH_NS + to_ns(at_s)
    kept = [m for m in session.messages if m[0] != camera or m[1].stamp_ns < at_ns]
    after = _pictures_of_one(replace(plan, cameras=moved), camera, session.truth)
    kept += [m for m in after if m[1].stamp_ns >= at_ns]
    kept.sort(key=lambda sent: (sent[1].stamp_ns, not isinstance(sent[1], Odometry)))
    return replace(session, messages=tuple(kept))


def _truth(robot: RobotPlan, reported: Pose, random: np.random.Generator) -> Pose:
    steps = reported[:-1].inverse() @ reported[1:]
    true = scattered_in_space(steps, robot.noise, np.array(robot.scales), random)
    return chained_in_space(robot.map_from_odom @ reported[0], true)


def pictures_of(plan: Plan, truth: dict[str, Pose]) -> list[tuple[str, Sightings]]:
    """What the cameras see of robots on these ways."""
    return [sent for name in plan.cameras for sent in _pictures_of_one(plan, name, truth)]


def _pictures_of_one(
    plan: Plan, name: str, truth: dict[str, Pose]
) -> Iterator[tuple[str, Sightings]]:
    camera, number = plan.cameras[name], list(plan.cameras).index(name)
    random = np.random.default_rng([plan.seed, 100, number])
    every = round(1 / plan.picture_rate / STEP_S)
    moments = np.arange(3 * number + 1, round(plan.seconds / STEP_S), every)
    where = (camera.map_from_camera, camera.lens, ())
    shown = {
        robot: seen_faces_each(its.target, truth[robot][moments], *where)
        for robot, its in plan.robots.items()
    }
    for row, index in enumerate(moments.tolist()):
        faces = []
        for robot, its in plan.robots.items():
            for seen in shown[robot][row]:
                sighting = _sighting(plan, its.target, seen, random)
                faces += [sighting] if sighting else []
        stamp_ns = EPOCH_NS + index * to_ns(STEP_S) + to_ns(camera.time_offset_s)
        yield name, Sightings(stamp_ns, f"{name}/optical", 640, 480, tuple(faces))


def _sighting(
    plan: Plan, target: Target, seen: SeenFace, random: np.random.Generator
) -> FaceSighting | None:
    if not seen.is_found(_SMALLEST_SQUARE_PX):
        return None
    pixels = seen.pixels + random.normal(0.0, 1.0, seen.pixels.shape) * plan.sigma
    if seen.face.reads_from_both_ends and random.random() < 0.5:
        pixels = pixels[::-1]
    return seen.sighting(target, target.name, pixels, plan.stated)


def _inputs(plan: Plan) -> Inputs:
    lines = ['site = "lab"']
    for name, camera in plan.cameras.items():
        lines += [f"[cameras.{name}]", f'source = "sim://{name}"', camera.more]
    for name, robot in plan.robots.items():
        noise = msgspec.structs.asdict(robot.noise)
        lines += [f"[robots.{name}]", 'port = "loop://"', f'target = "{name}.toml"']
        lines += [f"planar = {str(robot.planar).lower()}", f"[robots.{name}.odometry]"]
        lines += [f"{key} = {value!r}" for key, value in noise.items()]
    site = parse_site("\n".join([*lines, plan.more]), directory=Path())
    return Inputs(
        site,
        {name: robot.target for name, robot in plan.robots.items()},
        {name: camera.told or camera.lens for name, camera in plan.cameras.items()},
    )


def observed(session: Session, *, most: int | None = None) -> DataSet:
    """What the session's cameras saw of r1, without a place, up to so many observations."""
    inputs = session.inputs
    data = DataSet(inputs.site, inputs.targets, dict(inputs.lenses), inputs.known)
    intake = Intake(data)
    for node, message in session.messages:
        if isinstance(message, Odometry):
            data.tracks[node].add(message.stamp_ns, message.pose)
        elif isinstance(message, Sightings):
            intake.add(node, message, data.lenses[node])
    track = data.tracks["r1"]
    observations = intake.ready("r1", track.first_ns, track.last_ns)[:most]
    data.entries.extend(Entry(observation) for observation in observations)
    return data


def offline(session: Session) -> Results:
    """As `calibrate` does it."""
    return pushed(session.inputs, session.messages).results()


def pushed(inputs: Inputs, messages: tuple[tuple[str, Message], ...]) -> Pipeline:
    """A pipeline after everything was pushed in this order and it was finished."""
    pipeline = replayed(Pipeline(inputs, is_live=False), messages)
    pipeline.finish()
    return pipeline


def live(
    inputs: Inputs, arrivals: list[tuple[int, str, Message]]
) -> tuple[Pipeline, list[tuple[int, Output]]]:
    """A pipeline that got everything at its time of arrival (ns); what it sent, and when."""
    pipeline, sent = Pipeline(inputs), []
    for now_ns, node, message in sorted(arrivals, key=lambda item: item[0]):
        pipeline.push(node, message)
        sent += [(now_ns, output) for output in pipeline.advance(now_ns)]
    sent += [(0, output) for output in pipeline.finish()]
    return pipeline, sent


def write_session(session: Session, folder: Path) -> Path:
    """The session as `calibrate` reads it: session.mcap with its attachments, and truth.json."""
    folder.mkdir(parents=True, exist_ok=True)
    writer = McapWriter(folder / "session.mcap")
    files = {"site.toml": session.inputs.site.text}
    files |= {f"{name}.toml": target_text(t) for name, t in session.inputs.targets.items()}
    for name, text in files.items():
        writer.attach(name, text.encode(), "application/toml", time_ns=EPOCH_NS)
    infos: list[tuple[str, Sent]] = [
        (name, CameraInfo(EPOCH_NS, f"{name}/optical", model))
        for name, model in session.inputs.lenses.items()
    ]
    for node, message in (*infos, *session.messages):
        topic = INPUT_TOPICS[type(message)]
        writer.add(
            topic,
            topic.key("lab", node),
            cdr.encode(message),
            log_ns=message.stamp_ns,
            published_ns=message.stamp_ns,
        )
    writer.finish()
    (folder / "truth.json").write_bytes(msgspec.json.encode(session.truth_file))
    for name, poses in session.truth.items():
        stamps_ns = EPOCH_NS + to_ns(STEP_S) * np.arange(len(poses))
        (folder / f"{name}_truth.tum").write_bytes(encode_tum(stamps_ns, poses))
    return folder
