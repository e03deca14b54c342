"""The smoother against GTSAM on the same problem from the same start: poses, sigmas, time."""

from collections.abc import Callable
from functools import partial

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from benchmarks.study.oracle import known_to_oracle
from benchmarks.study.session import simulated_session
from benchmarks.table import Row, share_of
from benchmarks.timing import worked
from trigpoint.fusion.model.motion import composed
from trigpoint.fusion.model.problem import Problem, State
from trigpoint.fusion.solver.levenberg_marquardt import solve
from trigpoint.geometry import Pose
from trigpoint.tools.networks.cramer_rao import oracle_problem

from . import factor_graph
from .factor_graph import Graph, Solved

SITUATIONS = ("drive", "dance")
_TOLERANCE = 1e-4
_ROUNDS = 3
_FORMS = {"native": "GTSAM, relative poses", "reprojection": "GTSAM, custom factors"}


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
    rows = []
    seconds, ours = _best(partial(smoothed, problem, start), rounds)
    for form, title in _FORMS.items():
        others, other = _best(partial(solved_by, form, problem, start), rounds)
        apart = difference(ours, other)
        what = f"{name}, solution with covariance"
        rows += [
            Row("gtsam", what, "ms", 1e3 * seconds, 1e3 * others, title),
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


def solved_by(form: str, problem: Problem, start: State) -> Solved:
    """GTSAM's, the making of its graph included, as ours makes its equations."""
    made: Graph = getattr(factor_graph, form)(problem, start)
    return factor_graph.solved(made)


def difference(ours: Solved, other: Solved) -> Difference:
    """How far two solutions are apart."""
    sigma = np.sqrt(np.diagonal(ours.covariance))
    others = np.sqrt(np.diagonal(other.covariance))
    apart = other.map_from_camera.difference(ours.map_from_camera).reshape(-1)
    return Difference(float(np.abs(apart / sigma).max()), float(np.abs(others / sigma - 1).max()))


def _best(job: Callable[[], Solved], rounds: int) -> tuple[float, Solved]:
    """Seconds of work, the least of some rounds, and the result."""
    turns = [worked(job) for _ in range(rounds)]
    return min(turn[0] for turn in turns), turns[0][1]
