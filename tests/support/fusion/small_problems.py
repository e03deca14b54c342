"""A least-squares problem with every kind of unknown, small enough to be looked at as a whole."""

from pathlib import Path

import numpy as np
from support.builders import make_target
from support.fusion.drives import EPOCH_NS, lens

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.fusion.model.observations import (
    Observation,
    Reading,
    Verdict,
    View,
    base_from_faces,
    face_points,
    observation_of,
)
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.problem import CameraState, Problem, RobotState, State
from trigpoint.fusion.model.rolling_shutter import sweep_of
from trigpoint.fusion.solver.equations import Equations, covariance_of
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import parse_site
from trigpoint.site.target import Target
from trigpoint.testing.views import looking_at

from .slow_problem import moved_state

SITE = """
site = "lab"
target = "target.toml"
[cameras.c1]
source = "sim://c1"
intrinsics = "estimate"
time_offset_sigma = 0.01
[cameras.c2]
source = "sim://c2"
intrinsics = "estimate"
time_offset_sigma = 0.02
[robots.r1]
port = "loop://"
[robots.r1.odometry]
distance_scale = 0.03
heading_scale = 0.02
[robots.r2]
port = "loop://"
planar = false
[robots.r2.odometry]
vertical = 0.004
tilt = 0.003
tilt_turn = 0.005
distance_scale = 0.02
heading_scale = 0.03
[fusion]
target_translation = 0.004
target_rotation = 0.01
"""
SIGMA = 0.2
SECONDS = 4.0
EVERY_CORNER = 7  # only every seventh corner of a face is seen


def eyes() -> dict[str, Pose]:
    """The cameras' true poses."""
    return {
        "c1": looking_at((3.0, -1.0, 1.4), (0.5, 0.2, 0.5)),
        "c2": looking_at((2.2, 2.4, 1.2), (0.6, 0.2, 0.5)),
    }


def reported(robot: str, seconds: Array) -> Pose:
    """odom_from_base: r1 on an arc in the plane, r2 on a screw in space."""
    if robot == "r1":
        heading = 0.25 * seconds
        return Pose.planar(
            0.3 * np.sin(heading) / 0.25, 0.3 * (1 - np.cos(heading)) / 0.25, heading
        )
    turns = np.stack([0.1 * seconds, -0.15 * seconds, 0.3 * np.sin(seconds)], axis=-1)
    shifts = np.stack([0.2 * seconds, 0.1 * np.sin(seconds), 0.1 * seconds], axis=-1)
    return Pose(so3.exp(turns), shifts)


MAP_FROM_ODOM = {"r1": Pose.identity(), "r2": Pose.planar(0.4, -0.6, 0.7)}


def small_data(
    *,
    known: bool = False,
    past: bool = False,
    noise_px: float = 0.0,
    line_delay_s: float = 0.0,
    seed: int = 0,
    sightings: int = 12,
) -> DataSet:
    """Two robots that two cameras see at a few moments; all is true where there is no noise.

    `known`: the cameras have a joint prior instead of r1's first pose; `past`: with them, c1's
    lens, both clocks, r2's scales and r1's faces; `line_delay_s`: of c2's rolling shutter.
    """
    text = SITE.replace("[robots.r1]", f"line_delay = {line_delay_s}\n[robots.r1]", 1)
    site, random = parse_site(text, directory=Path()), np.random.default_rng(seed)
    lenses = {name: lens(62.0, (-0.2, 0.05, 1e-3, -5e-4, 0.01)) for name in site.cameras}
    targets = {name: make_target() for name in site.robots}
    before = KnownCameras.none()
    if known:
        before = known_past(random, lenses, targets) if past else known_eyes(random)
    data = DataSet(site, targets, lenses, before)
    for robot, track in data.tracks.items():
        fill_track(track, robot)
    for number in range(sightings):
        robot, camera = ("r1", "r2")[number % 2], ("c1", "c2")[number // 2 % 2]
        stamp_ns = EPOCH_NS + to_ns(SECONDS * (number + 0.63) / (sightings + 1))
        observation = see(data, camera, robot, stamp_ns, noise_px, random)
        pose = true_pose(data, robot, observation.stamp_ns)
        data.entries.append(Entry(observation, pose))
    return data


def known_eyes(random: np.random.Generator) -> KnownCameras:
    """A joint prior of centimetres and milliradians with correlations."""
    sigma = np.tile(np.repeat([0.01, 0.004], 3), 2)
    mixed = np.eye(12) + 0.2 * random.standard_normal((12, 12))
    covariance = sigma[:, None] * (mixed @ mixed.T) * sigma
    return KnownCameras(eyes(), np.linalg.inv(covariance))


def known_past(
    random: np.random.Generator, lenses: dict[str, CameraModel], targets: dict[str, Target]
) -> KnownCameras:
    """The same with what goes along with cameras."""
    faces = {"r1": base_from_faces(targets["r1"])}
    values = {
        ("lens", "c1"): lenses["c1"].parameters,
        ("clock", "c2"): np.zeros(2),
        ("clock", "c1"): np.zeros(2),
        ("scales", "r2"): np.zeros(2),
    }
    sigma = np.concatenate(
        [
            np.tile(np.repeat([0.01, 0.004], 3), 2 + len(faces["r1"])),
            np.full(4, 2.0),
            np.full(len(values["lens", "c1"]) - 4, 0.01),
            np.tile([0.004, 1e-5], 2),
            [0.01, 0.02],
        ]
    )
    mixed = np.eye(len(sigma)) + 0.1 * random.standard_normal((len(sigma), len(sigma)))
    covariance = sigma[:, None] * (mixed @ mixed.T) * sigma
    return KnownCameras(eyes(), np.linalg.inv(covariance), faces=faces, values=values)


def fill_track(track: OdometryTrack, robot: str) -> None:
    seconds = np.arange(0.0, SECONDS, 0.05)
    poses = reported(robot, seconds)
    for index, second in enumerate(seconds):
        track.add(EPOCH_NS + to_ns(float(second)), poses[index])


def true_pose(data: DataSet, robot: str, stamp_ns: int) -> Pose:
    """map_from_base by the robot's odometry, which is true where there is no noise."""
    track = data.tracks[robot]
    moved = track.motion(np.array([track.first_ns, stamp_ns]), np.zeros(2)).earlier_from_later[0]
    return MAP_FROM_ODOM[robot] @ track.odom_from_base[0] @ moved


def see(
    data: DataSet,
    camera: str,
    robot: str,
    stamp_ns: int,
    noise_px: float,
    random: np.random.Generator,
) -> Observation:
    """Both faces, whichever way they look: their readings are chosen already."""
    views, config = [], data.site.cameras[camera]
    for index, face in enumerate(data.targets[robot].faces):
        corners = np.arange(index, face.corner_count, EVERY_CORNER)
        points = face.base_from_face @ face_points(face, corners, is_turned=False)
        pixels = exposed(data, camera, robot, stamp_ns, points)
        pixels = pixels + noise_px * random.standard_normal(pixels.shape)
        sweep = sweep_of(config, pixels)
        views.append(View(corners, pixels, SIGMA, (Reading(index),), sweep))
    return observation_of(camera, robot, stamp_ns, tuple(views)).judged(Verdict.ACCEPTED)


def exposed(data: DataSet, camera: str, robot: str, stamp_ns: int, points: Array) -> Array:
    """The pixels (n, 2) of points (n, 3) on a robot, each while its row is exposed."""
    config, camera_from_map = data.site.cameras[camera], eyes()[camera].inverse()

    def project(point: Array, at_ns: int) -> Array:
        return data.lenses[camera].project(camera_from_map @ true_pose(data, robot, at_ns) @ point)

    pixels = np.array([project(point, stamp_ns) for point in points])
    for _ in range(3 if config.line_delay else 0):
        after_s = config.line_delay * (pixels[:, 1] - (config.height - 1) / 2)
        at = zip(points, after_s, strict=True)
        pixels = np.array([project(p, stamp_ns + to_ns(float(s))) for p, s in at])
    return pixels


def first_state(data: DataSet, *, off: float = 0.0) -> State:
    """The truth, or `off` (1: as far as is usual) in scales and time offsets; no nodes yet."""
    cameras = {
        name: CameraState(pose, data.lenses[name], off * offset_s)
        for (name, pose), offset_s in zip(eyes().items(), (0.008, -0.005), strict=True)
    }
    nowhere = Pose(np.zeros((0, 3, 3)), np.zeros((0, 3)))
    robots = {
        name: RobotState(nowhere, off * np.array([0.02, -0.03]), base_from_faces(target))
        for name, target in data.targets.items()
    }
    return State(cameras, robots)


def small_problem(
    *,
    known: bool = False,
    past: bool = False,
    noise_px: float = 0.0,
    line_delay_s: float = 0.0,
    off: float = 0.0,
) -> Assembled:
    """The problem over everything."""
    data = small_data(known=known, past=past, noise_px=noise_px, line_delay_s=line_delay_s)
    return assemble(data, first_state(data, off=off), list(range(len(data.entries))))


SHAKE = {"pose": 0.01, "lens": 1e-3, "faces": 2e-3, "last": 0.01, "nodes": 0.01}


def shaken(assembled: Assembled, *, seed: int = 1, amount: float = 1.0) -> State:
    """The start, moved at random by about SHAKE; scales and time offsets stay at what the problem
    was made for, as it is made anew until they do."""
    random, problem = np.random.default_rng(seed), assembled.problem
    layout = problem.layout
    dense = np.zeros(layout.size)
    for kind in ("pose", "lens", "faces", "last"):
        for column in getattr(layout, kind).values():
            dense[column] = SHAKE[kind] * random.standard_normal(len(column))
    for column in layout.lens.values():
        dense[column[:4]] *= 1e3  # pixels
    nodes = {}
    for name, chain in problem.chains.items():
        nodes[name] = SHAKE["nodes"] * random.standard_normal((len(chain) - 1, len(chain.tangent)))
        if chain.is_anchored:
            nodes[name][0] = 0.0
    moves = {name: amount * move for name, move in nodes.items()}
    return moved_state(problem, assembled.start, amount * dense, moves)


def unknowns(problem: Problem) -> list[tuple[str, int]]:
    """Every unknown in one order: each chain's inner nodes, then the dense part («»)."""
    found = []
    for name, chain in problem.chains.items():
        found += [(name, i) for i in range((len(chain) - 1) * len(chain.tangent))]
    return found + [("", i) for i in range(problem.layout.size)]


def stepped(problem: Problem, state: State, unknown: tuple[str, int], step: float) -> State:
    """The state with one unknown moved."""
    name, index = unknown
    dense, moves = np.zeros(problem.layout.size), {}
    if not name:
        dense[index] = step
    else:
        chain = problem.chains[name]
        move = np.zeros((len(chain) - 1) * len(chain.tangent))
        move[index] = step
        moves[name] = move.reshape(len(chain) - 1, len(chain.tangent))
    return moved_state(problem, state, dense, moves)


def whole_matrix(equations: Equations) -> Array:
    """The normal equations' matrix with nothing eliminated, in the order of `unknowns`."""
    return covariance_of(equations.system().covariance)


def whole_gradient(equations: Equations) -> Array:
    """The gradient in the order of `unknowns`."""
    return -whole_matrix(equations) @ equations.system().step
