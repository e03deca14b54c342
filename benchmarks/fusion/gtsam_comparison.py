"""The smoother against GTSAM on the same problem from the same start: poses, sigmas, time.

The problem as a GTSAM factor graph, in two forms. `native`: GTSAM's own factors alone. Each picture
is first solved by itself for the camera's pose from the robot, which enters as a relative pose with
its covariance: the fastest fair form. `reprojection`: the smoother's own residuals of corners, as
custom factors.

GTSAM disturbs a pose on its right by (rotation, translation); the contract on its left, in the
parent's axes, by (translation, rotation). To first order δθ = Rω and δt = Rv.
"""

from collections.abc import Callable
from functools import partial

import gtsam  # pyright: ignore[reportMissingImports] - of the extra `bench`
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from benchmarks.study.oracle import known_to_oracle
from benchmarks.study.session import simulated_session
from benchmarks.table import Row, share_of
from benchmarks.timing import best_of
from trigpoint.fusion.model.motion import composed
from trigpoint.fusion.model.problem import Batch, Chain, Problem, State
from trigpoint.fusion.solver.levenberg_marquardt import solve
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.tools.networks.cramer_rao import oracle_problem

SITUATIONS = ("drive", "dance")
_TOLERANCE = 1e-4
_ROUNDS = 3


# The first node is known exactly: 0.3 µm and µrad, as in the smoother.
_EXACT = 3e-7
# A planar robot's steps are flat to 10 nm and nrad: hundreds of them are then far flatter than a
# camera's tilt is known after hundreds of pictures, 10 µrad.
_FLAT = 1e-8
_UPRIGHT = [2, 3, 4]
_PICTURE_STEPS = 20
_PICTURE_TOLERANCE = 1e-9


class Graph(Struct, frozen=True, eq=False):
    """A factor graph, where to start, and the cameras' keys in order."""

    factors: gtsam.NonlinearFactorGraph
    start: gtsam.Values
    cameras: dict[str, int]


class Solved(Struct, frozen=True, eq=False):
    """`map_from_camera` (n) and their joint covariance (6n, 6n) by the contract's convention."""

    map_from_camera: Pose
    covariance: Array


def native(problem: Problem, start: State) -> Graph:
    """Odometry and pictures as relative poses."""
    graph = _with_chains(problem, start)
    for batch in problem.batches:
        seen = _solved_pictures(batch, start)
        key = graph.cameras[batch.camera]
        for node, (base_from_camera, information) in zip(batch.nodes, seen, strict=True):
            noise = gtsam.noiseModel.Gaussian.Information(information)
            factor = gtsam.BetweenFactorPose3(_node(batch.robot, problem, int(node)), key,
                                              _pose3(base_from_camera), noise)  # fmt: skip
            graph.factors.add(factor)
    return graph


def reprojection(problem: Problem, start: State) -> Graph:
    """Every corner by its residual."""
    graph = _with_chains(problem, start)
    for batch in problem.batches:
        lens = start.cameras[batch.camera].lens
        in_base = _points_in_base(batch, start)
        for row, node in enumerate(batch.nodes):
            used = batch.weights[row] > 0
            keys = [_node(batch.robot, problem, int(node)), graph.cameras[batch.camera]]
            seen = _Seen(
                lens, in_base[row, used], batch.pixels[row, used], batch.weights[row, used]
            )
            noise = gtsam.noiseModel.Unit.Create(2 * int(used.sum()))
            graph.factors.add(gtsam.CustomFactor(noise, keys, seen.error))
    return graph


def solved(graph: Graph) -> Solved:
    """The graph's minimum by Levenberg-Marquardt, and the cameras' joint covariance there."""
    parameters = gtsam.LevenbergMarquardtParams()
    # The error is χ²/2; the smoother ends when a step promises less than 1e-4 of χ².
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(5e-5)
    found = gtsam.LevenbergMarquardtOptimizer(graph.factors, graph.start, parameters).optimize()
    keys = list(graph.cameras.values())
    marginals = gtsam.Marginals(graph.factors, found)
    joint = marginals.jointMarginalCovariance(gtsam.KeyVector(keys))
    poses = [_pose(found.atPose3(key)) for key in keys]
    turns = [_contract_from_right(pose.rotation) for pose in poses]
    blocks = [
        [turn @ joint.at(key, other) @ turned.T for other, turned in zip(keys, turns, strict=True)]
        for key, turn in zip(keys, turns, strict=True)
    ]
    return Solved(Pose.stack(poses), np.block(blocks))


class Difference(Struct, frozen=True, eq=False):
    """Between two solutions of a session: the largest difference of a coordinate of a camera's
    pose in sigmas, and of a sigma, relative."""

    poses: float
    sigmas: float


def run(effort: float = 1.0) -> list[Row]:
    """Both forms of both situations."""
    rounds = share_of(_ROUNDS, effort)
    return [
        row
        for name in SITUATIONS[: share_of(len(SITUATIONS), effort)]
        for row in _rows(name, *problem_of(name, seed=1), rounds)
    ]


def _rows(name: str, problem: Problem, start: State, rounds: int) -> list[Row]:
    jobs = {
        "ours": partial(smoothed, problem, start),
        "GTSAM, relative poses": partial(solved_by, native, problem, start),
        "GTSAM, custom factors": partial(solved_by, reprojection, problem, start),
    }
    rows = list[Row]()
    (seconds, ours), *others = best_of(rounds, jobs).values()
    for title, (others_s, other) in zip(list(jobs)[1:], others, strict=True):
        apart = difference(ours, other)
        what = f"{name}, solution with covariance"
        rows += [
            Row("gtsam", what, "ms", 1e3 * seconds, 1e3 * others_s, title),
            Row("gtsam", f"{name}, poses apart at most", "sigma", apart.poses, 0.0, title),
            Row("gtsam", f"{name}, sigmas apart at most", "%", 100 * apart.sigmas, 0.0, title),
        ]
    return rows


def problem_of(name: str, *, seed: int) -> tuple[Problem, State]:
    """A situation's problem with its faces told, and a start: the robot by its odometry alone, the
    cameras a few centimetres and degrees off."""
    session = simulated_session(name, seed)
    assembled = oracle_problem(*known_to_oracle(session.inputs, session.simulated))
    random = np.random.default_rng(seed)
    truth = assembled.start
    cameras = {
        camera: replace(
            state,
            map_from_camera=state.map_from_camera.disturbed(
                random.normal(0.0, 1.0, 6) * np.repeat([0.03, 0.02], 3)
            ),
        )
        for camera, state in truth.cameras.items()
    }
    robots = {}
    for robot, state in truth.robots.items():
        motion = assembled.problem.chains[robot].motion
        assert motion is not None  # it drove
        way = state.map_from_base[0] @ composed(motion.earlier_from_later)
        robots[robot] = replace(state, map_from_base=way)
    return assembled.problem, State(cameras, robots)


def smoothed(problem: Problem, start: State) -> Solved:
    """Our solution with the cameras' joint covariance."""
    solution = solve(problem, start, tolerance=_TOLERANCE)
    layout = solution.reduced.layout
    names = list(layout.pose)
    columns = np.concatenate(list(layout.pose.values()))
    covariance = solution.reduced.covariance()[np.ix_(columns, columns)]
    poses = Pose.stack([solution.state.cameras[name].map_from_camera for name in names])
    return Solved(poses, covariance)


def solved_by(form: Callable[[Problem, State], Graph], problem: Problem, start: State) -> Solved:
    """GTSAM's, the making of its graph included, as ours makes its equations."""
    return solved(form(problem, start))


def difference(ours: Solved, other: Solved) -> Difference:
    """How far two solutions are apart."""
    sigma = np.sqrt(np.diagonal(ours.covariance))
    others = np.sqrt(np.diagonal(other.covariance))
    apart = other.map_from_camera.difference(ours.map_from_camera).reshape(-1)
    return Difference(float(np.abs(apart / sigma).max()), float(np.abs(others / sigma - 1).max()))


def _with_chains(problem: Problem, start: State) -> Graph:
    """The poses to start from, the first ones held, and their motion as relative poses."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for robot, chain in problem.chains.items():
        nodes = start.robots[robot].map_from_base
        for node in range(len(chain)):
            values.insert(_node(robot, problem, node), _pose3(nodes[node]))
        if chain.is_anchored:
            exact = gtsam.noiseModel.Isotropic.Sigma(6, _EXACT)
            key = _node(robot, problem, 0)
            factors.add(gtsam.PriorFactorPose3(key, _pose3(nodes[0]), exact))
        _add_motion(factors, problem, chain)
    cameras = {}
    for index, name in enumerate(problem.layout.pose):
        cameras[name] = gtsam.symbol("C", index)
        values.insert(cameras[name], _pose3(start.cameras[name].map_from_camera))
    return Graph(factors, values, cameras)


def _add_motion(factors: gtsam.NonlinearFactorGraph, problem: Problem, chain: Chain) -> None:
    if chain.motion is None:
        return
    steps = chain.motion.earlier_from_later
    for index, covariance in enumerate(_in_the_plane(chain)):
        to_right = np.linalg.inv(_contract_from_right(steps.rotation[index]))
        noise = gtsam.noiseModel.Gaussian.Covariance(to_right @ covariance @ to_right.T)
        earlier, later = (_node(chain.robot, problem, index + offset) for offset in (0, 1))
        factors.add(gtsam.BetweenFactorPose3(earlier, later, _pose3(steps[index]), noise))


def _in_the_plane(chain: Chain) -> Array:
    """The motions' covariances (n, 6, 6); what a planar robot does not do is held to `_FLAT`."""
    assert chain.motion is not None
    covariance = chain.motion.covariance.copy()
    if chain.planar:
        covariance[:, _UPRIGHT], covariance[:, :, _UPRIGHT] = 0.0, 0.0
        covariance[:, _UPRIGHT, _UPRIGHT] = _FLAT**2
    return covariance


class _Seen(Struct, frozen=True, eq=False):
    """Corners (n, 3) in the base frame, their pixels (n, 2) and 1/sigma (n,)."""

    lens: CameraModel
    points: Array
    pixels: Array
    weights: Array

    def error(
        self, factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[np.ndarray] | None
    ) -> np.ndarray:
        """Whitened residuals (2n,) and their derivatives by base and camera, (2n, 6) each."""
        node, camera = (_pose(values.atPose3(key)) for key in list(factor.keys()))
        optical = (camera.inverse() @ node) @ self.points
        pixels, by_optical, _lens = self.lens.project_jacobians(optical)
        weights = self.weights[:, None]
        if jacobians is not None:
            by_point = by_optical * weights[..., None]
            jacobians[0] = _by_base(by_point, camera, node, self.points)
            jacobians[1] = _by_camera(by_point, optical)
        return ((pixels - self.pixels) * weights).reshape(-1)


def _by_camera(by_point: Array, optical: Array) -> Array:
    """With o the corner in the optical frame, o' = Exp(-ω)(o - v): ∂o = [o]× ω - v."""
    return np.concatenate([by_point @ so3.hat(optical), -by_point], axis=-1).reshape(-1, 6)


def _by_base(by_point: Array, camera: Pose, node: Pose, points: Array) -> Array:
    turned = by_point @ (camera.rotation.T @ node.rotation)
    return np.concatenate([-turned @ so3.hat(points), turned], axis=-1).reshape(-1, 6)


def _solved_pictures(batch: Batch, start: State) -> list[tuple[Pose, Array]]:
    """For each picture base_from_camera of least reprojection error, by Gauss-Newton's steps, and
    its information (6, 6) by GTSAM's convention; all pictures of a batch at once."""
    lens, points = start.cameras[batch.camera].lens, _points_in_base(batch, start)
    nodes = start.robots[batch.robot].map_from_base[batch.nodes]
    pose = nodes.inverse() @ start.cameras[batch.camera].map_from_camera
    weights = batch.weights[..., None]
    n = len(points)
    hessian = np.zeros((n, 6, 6))
    for _ in range(_PICTURE_STEPS):
        optical = pose.inverse() @ points
        optical = np.where(batch.weights[..., None] > 0, optical, [0.0, 0.0, 1.0])
        pixels, by_optical, _lens = lens.project_jacobians(optical)
        jacobian = _by_camera(by_optical * weights[..., None], optical).reshape(n, -1, 6)
        residual = ((pixels - batch.pixels) * weights).reshape(n, -1, 1)
        transposed = np.swapaxes(jacobian, 1, 2)
        hessian = transposed @ jacobian
        step = -np.linalg.solve(hessian, transposed @ residual)[..., 0]
        moved = Pose(so3.exp(step[:, :3]), step[:, 3:])
        pose = pose @ moved
        if np.abs(step).max() < _PICTURE_TOLERANCE:
            break
    return [(pose[i], hessian[i]) for i in range(n)]


def _points_in_base(batch: Batch, start: State) -> Array:
    """(n, K, 3)."""
    faces = start.robots[batch.robot].base_from_face[batch.faces]
    return (faces.rotation @ batch.face_points[..., None])[..., 0] + faces.translation


def _contract_from_right(rotation: Array) -> Array:
    """(6, 6), from GTSAM's (rotation, translation) on the right to the contract's disturbance."""
    turn = np.zeros((6, 6))
    turn[:3, 3:] = turn[3:, :3] = rotation
    return turn


def _node(robot: str, problem: Problem, index: int) -> int:
    return gtsam.symbol(chr(ord("a") + list(problem.chains).index(robot)), index)


def _pose3(pose: Pose) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(pose.rotation), pose.translation)


def _pose(pose: gtsam.Pose3) -> Pose:
    return Pose(pose.rotation().matrix(), pose.translation())
