"""The minimum of an explanation's graph, found by the core (`native/src/fusion/graph.cpp`)."""

from collections.abc import Sequence

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.pose import rows_of
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .factor import Factor
from .graph import Graph, Placed, Variant
from .initial_values import initial_values
from .linear import HELD
from .path import Steps, Way

# The bound of scale errors: no odometry is so far off, and a step beyond it comes from where the
# linearisation is not valid.
_FAR_OFF = 0.9
# How often a minimum is searched with the motions of another scale error than before.
_MOST_SCALES = 4
_REAL, _WHOLE = np.float64, np.int64
MINIMUM = Kernel(
    "tp_graph_minimum",
    Factor,
    *(Out(_REAL, ("n", 12)), In(_WHOLE, ("n", 6))),
    *(Out(_REAL, ("v",)), In(_REAL, ("v",)), In(_WHOLE, ("v",))),
    *(In(_WHOLE, ("p",)), In(_REAL, ("p", 12)), In(_REAL, ("p", 6, 6))),
    *(In(_REAL, ("v",)), In(_REAL, ("v",))),
    *(In(_WHOLE, ("m", 4)), In(_REAL, ("m", 12)), In(_REAL, ("m", 6, 6))),
    *(In(_REAL, ("m", 6, 2)), In(_REAL, ("m", 2))),
    *(In(_WHOLE, ("k", 4)), In(_REAL, ("k", 12)), In(_REAL, ("k", "q", "q"))),
    In(_REAL, ("k", "o")),
    Out(_REAL, (2,)),
)


def placed(graph: Graph, variants: Sequence[Variant]) -> list[Placed | None]:
    """Return the minimum of each variant's graph; None where it is not determined."""
    return [_Minimum(graph, variant).found() for variant in variants]


class _Minimum:
    """One variant's graph as the core takes it: poses (all robots' nodes, then the places), values
    (scale errors, then the cameras' own unknowns), and what is said of them."""

    def __init__(self, graph: Graph, variant: Variant) -> None:
        self.graph, self.variant = graph, variant
        self.ties = sorted(variant.ties.items())
        keys = {(graph.visits[n].visit.camera, tie.place) for n, tie in self.ties}
        known = graph.data.known.poses
        self.layout = layout = graph.layout(sorted(keys | {(camera, 0) for camera in known}))
        nodes, places = initial_values(graph, variant)
        self.first: dict[str, int] = {}
        count = 0
        for robot in graph.paths:
            self.first[robot], count = count, count + len(nodes[robot])
        self.place = {key: count + order for order, key in enumerate(layout.places)}
        self.poses = rows_of(
            [*(nodes[robot] for robot in graph.paths), *(places[key] for key in layout.places)]
        )
        self.ways = {robot: _way(graph, robot, variant) for robot in graph.paths}
        self._set_values()

    def _set_values(self) -> None:
        """Lay out the values: where each robot's scale errors and each camera's own begin."""
        graph, layout = self.graph, self.layout
        self.value: dict[str, int] = {}
        self.own: dict[str, int] = {}
        values, bounds, rows = list[Array](), list[Array](), list[np.ndarray]()
        mean, information = list[Array](), list[Array]()
        count = 0
        for robot, mine in layout.scales.items():
            sigma = graph.paths[robot].scale_sigma
            held = np.where(sigma > 0, sigma, HELD)
            self.value[robot], count = count, count + 2
            values.append(np.zeros(2))
            bounds.append(np.full(2, _FAR_OFF))
            mean.append(np.zeros(2))
            information.append(held**-2.0)
            rows.append(mine)
        for camera, mine in layout.own.items():
            expected, sigma = graph.own_prior[camera]
            said = [(n, tie) for n, tie in self.ties if graph.visits[n].visit.camera == camera]
            self.own[camera], count = count, count + len(mine)
            values.append(graph.own_values(said[-1][0])[said[-1][1].mode] if said else expected)
            bounds.append(np.full(len(mine), np.inf))
            mean.append(expected)
            # The information of each tie includes this prior, which counts only once in all.
            information.append((1 - len(said)) / sigma**2)
            rows.append(mine)
        none = np.zeros(0)
        self.values, self.bounds = np.concatenate([none, *values]), np.concatenate([none, *bounds])
        self.mean, self.information = (
            np.concatenate([none, *mean]),
            np.concatenate([none, *information]),
        )
        self.value_rows = np.concatenate([none, *rows]).astype(_WHOLE)

    def found(self) -> Placed | None:
        """Return the minimum; None where it is not determined, or its score is not finite."""
        factor, score = Factor(), np.empty(2)
        fixed = self._pose_rows(), *self._absolute()
        ties = self._ties()
        for _ in range(_MOST_SCALES):
            steps = {robot: self._steps(robot) for robot in self.graph.paths}
            is_found = MINIMUM(
                factor,
                *(self.poses, fixed[0]),
                *(self.values, self.bounds, self.value_rows),
                *fixed[1:],
                *(self.mean, self.information),
                *self._moved(steps),
                *ties,
                score,
            )
            if not is_found:
                return None
            if all(self._steps(robot) is each for robot, each in steps.items()):
                break
        total = float(score.sum()) + self._constant()
        return self._placed(total, factor) if np.isfinite(total) else None

    def _placed(self, score: float, factor: Factor) -> Placed:
        def pose(first: int, count: int) -> Pose:
            part = self.poses[first : first + count]
            return Pose(part[:, :9].reshape(-1, 3, 3), part[:, 9:])

        nodes = {
            robot: pose(first, len(self.graph.paths[robot].stamps_ns))
            for robot, first in self.first.items()
        }
        places = {key: pose(at, 1)[0] for key, at in self.place.items()}
        return Placed(score, nodes, self.variant.breaks, places, self.layout, factor)

    def _constant(self) -> float:
        """Return the part of the score that does not depend on the unknowns' values."""
        graph, known = self.graph, self.graph.data.known.poses
        score = 0.0
        for robot, (way, _) in self.ways.items():
            lifts = sum(name == robot for name, _ in self.variant.breaks)
            room = float(np.sum(np.log(graph.room(graph.paths[robot]))))
            score += float(way.log_covariance.sum()) + lifts * room
        unknown = sum(place > 0 or camera not in known for camera, place in self.layout.places)
        score += unknown * graph.events.pose_score
        for camera in self.layout.own:
            score += 2 * float(np.sum(np.log(graph.own_prior[camera][1])))
        return score + sum(graph.visits[n].modes[tie.mode].score for n, tie in self.ties)

    # -- what is said -----------------------------------------------------------------------------

    def _pose_rows(self) -> np.ndarray:
        """Return the rows (n, 6) of the poses' unknowns, -1 where a direction is held."""
        rows = np.full((len(self.poses), 6), -1, dtype=_WHOLE)
        for robot, mine in self.layout.nodes.items():
            first = self.first[robot]
            rows[first : first + len(mine), self.graph.paths[robot].tangent] = mine
        for key, mine in self.layout.places.items():
            rows[self.place[key]] = mine
        return rows

    def _absolute(self) -> tuple[np.ndarray, Array, Array]:
        """Return the priors on poses: of a path's first, anywhere in the room unless the path is
        the anchored one, and of the cameras known from before, each by its marginal information."""
        which, expected, information = [], [], []
        for robot, path in self.graph.paths.items():
            variance = self.graph.room(path)
            if path.is_anchored:
                variance = np.full(len(variance), HELD**2)
            which.append(self.first[robot])
            expected.append(path.odometry[0])
            information.append(_whole(np.diag(1 / variance)[None], path.tangent)[0])
        for order, (name, pose) in enumerate(self.graph.data.known.poses.items()):
            which.append(self.place[name, 0])
            expected.append(pose)
            information.append(self.graph.known_information(order))
        return (
            np.array(which, dtype=_WHOLE),
            rows_of(expected),
            np.array(information).reshape(-1, 6, 6),
        )

    def _steps(self, robot: str) -> Steps:
        """Return a robot's motions by odometry at its current scale errors."""
        at = self.value.get(robot)
        scales = np.zeros(2) if at is None else self.values[at : at + 2]
        return self.graph.paths[robot].steps(scales)

    def _moved(self, steps: dict[str, Steps]) -> tuple[np.ndarray, Array, Array, Array, Array]:
        """Return the motions between nodes: by odometry, or by a visit that shows one more
        precisely; where the robot was lifted, by a visit alone, if one shows it."""
        count = sum(len(each.motion) for each in steps.values())
        ends, motion = np.zeros((count, 4), dtype=_WHOLE), np.empty((count, 12))
        information, by_scale = np.empty((count, 6, 6)), np.empty((count, 6, 2))
        about, start = np.zeros((count, 2)), 0
        for robot, by_odometry in steps.items():
            path, (way, anywhere) = self.graph.paths[robot], self.ways[robot]
            mine = slice(start, start + len(by_odometry.motion))
            start = mine.stop
            ends[mine, 0] = self.first[robot] + np.arange(len(by_odometry.motion))
            ends[mine, 1], ends[mine, 2] = ends[mine, 0] + 1, self.value.get(robot, -1)
            motion[mine], by_scale[mine] = rows_of([by_odometry.motion]), by_odometry.by_scale
            about[mine] = by_odometry.about
            shown, free = mine.start + way.steps, mine.start + np.array(anywhere, dtype=int)
            motion[shown], by_scale[shown], about[shown] = rows_of([way.motion]), way.by_scale, 0.0
            information[mine] = _whole(way.information, path.tangent)
            # Only the prior of the room keeps such a step determined.
            information[free] = _whole(np.diag(1 / self.graph.room(path))[None], path.tangent)
            ends[free, 3] = 1
        return ends, motion, information, by_scale, about

    def _ties(self) -> tuple[np.ndarray, Array, Array, Array]:
        """Return the poses of cameras relative to the robot, and the cameras' own unknowns, that
        visits show."""
        graph = self.graph
        most = max((len(mine) for mine in self.layout.own.values()), default=0)
        ends = np.empty((len(self.ties), 4), dtype=_WHOLE)
        seen, values = np.empty((len(ends), 12)), np.zeros((len(ends), most))
        information = np.zeros((len(ends), 6 + most, 6 + most))
        for row, (number, tie) in enumerate(self.ties):
            visit = graph.visits[number].visit
            said, known = graph.relative(number)
            own = graph.own_values(number)[tie.mode]
            place = self.place[visit.camera, tie.place]
            ends[row, :2] = self.first[visit.robot] + graph.node_of[number], place
            ends[row, 2:] = self.own.get(visit.camera, -1), len(own)
            seen[row, :9], seen[row, 9:] = (
                said.rotation[tie.mode].ravel(),
                said.translation[tie.mode],
            )
            values[row, : len(own)] = own
            information[row, : 6 + len(own), : 6 + len(own)] = known[tie.mode]
        return ends, seen, information, values


def _way(graph: Graph, robot: str, variant: Variant) -> tuple[Way, list[int]]:
    """Return what constrains a robot's steps: odometry, visits, or nothing but the room; and the
    steps of which that is so."""
    way, anywhere = graph.way(robot, variant.nothing), []
    for step in sorted(step for name, step in variant.breaks if name == robot):
        across = graph.across((robot, step), variant.nothing)
        way = way.broken(step, across)
        if across is None:
            anywhere.append(step)
    return way, anywhere


def _whole(information: Array, tangent: list[int]) -> Array:
    """Return the information (m, 6, 6) of disturbances of which only some directions are free."""
    whole = np.zeros((len(information), 6, 6))
    whole[np.ix_(range(len(information)), tangent, tangent)] = information
    return whole
