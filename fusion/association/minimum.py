"""The minimum of an explanation's graph, found by the core (`native/src/fusion/graph.cpp`)."""

from collections import Counter
from itertools import pairwise

import numpy as np
from msgspec import Struct

from trigpoint.geometry.pose import rows_of
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .graph import Factor, Graph, Layout, Place, Placed, Tie, Variant
from .linear import HELD
from .path import Steps, VisualStep, in_all_axes

# The bound of scale errors: no odometry is so far off, and a step beyond it comes from where the
# linearisation is not valid.
_FAR_OFF = 0.9
# How often a minimum is searched with the motions of another scale error than before.
_MOST_SCALES = 4
_REAL, _WHOLE = np.float64, np.int64
Ties = list[tuple[int, Tie]]
"""Visits, in order, and what is used of each."""
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
START = Kernel(
    "tp_graph_start",
    *(Out(_REAL, ("n", 12)), In(_WHOLE, ("n", 2)), In(_WHOLE, ("r", 4))),
    *(In(_WHOLE, ("k", 4)), In(_REAL, ("k", 12)), In(_WHOLE, ("k",))),
)


class _Terms(Struct, frozen=True):
    """What is the same in all graphs of a layout: the unknowns of each pose, -1 where a direction
    is held (`pose_rows` (n, 6)); the priors on poses (`absolute`); of the values (scale errors,
    then the cameras' own unknowns) the bounds, rows, prior means and information, and where each
    camera's begin (`own`); and the part of the score that does not depend on anything else."""

    layout: Layout
    pose_rows: np.ndarray
    absolute: tuple[np.ndarray, Array, Array]
    bounds: Array
    value_rows: np.ndarray
    mean: Array
    information: Array
    own: dict[str, slice]
    constant: float


class _Way(Struct, frozen=True):
    """The motions (m) between one robot's nodes: by odometry, or by a visit that shows one more
    precisely; where the robot was lifted, by a visit alone, if one shows it. `terms`: as the core
    takes them, the ends (m, 4), motions (m, 12), their information (m, 6, 6), derivatives by the
    scale errors (m, 6, 2) and about which of these (m, 2); `log_covariance` (m,): what their noise
    adds to the score."""

    terms: tuple[np.ndarray, Array, Array, Array, Array]
    log_covariance: Array

    def copy(self) -> "_Way":
        ends, motion, information, by_scale, about = (part.copy() for part in self.terms)
        return _Way((ends, motion, information, by_scale, about), self.log_covariance.copy())

    def take(self, step: int, shown: VisualStep) -> None:
        """Take a step as a visit shows it."""
        _, motion, information, by_scale, about = self.terms
        motion[step], information[step] = shown.motion.rows(), shown.information
        by_scale[step], about[step] = shown.by_scale, 0.0
        self.log_covariance[step] = shown.log_covariance - shown.surprise


class Minima:
    """Solves the graphs of a session's explanations; what they share is laid out once."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self._terms: dict[frozenset[Place], _Terms] = {}
        self._ways: dict[tuple[object, ...], _Way] = {}
        self._room = {
            robot: (in_all_axes(np.diag(1 / room), path.tangent), float(np.log(room).sum()))
            for robot, path in graph.paths.items()
            for room in [graph.room(path)]
        }
        visits, first = graph.visits, graph.layout([]).first
        self._node = [
            first[found.visit.robot] + node
            for found, node in zip(visits, graph.node_of, strict=True)
        ]
        # Every mode of every visit: what it ties, and how well.
        self._mode = np.cumsum([0, *(len(found.modes) for found in visits)]).tolist()
        self._seen = rows_of(modes.base_from_camera for modes in graph.modes)
        most = max((len(mean) for mean, _ in graph.own_prior.values()), default=0)
        self._own = np.zeros((len(self._seen), most))
        self._information = np.zeros((len(self._seen), 6 + most, 6 + most))
        self._score = np.array([mode.score for found in visits for mode in found.modes], _REAL)
        for first, end, modes in zip(self._mode, self._mode[1:], graph.modes, strict=False):
            if end > first:
                size = 6 + modes.own.shape[1]
                self._own[first:end, : size - 6] = modes.own
                self._information[first:end, :size, :size] = modes.information

    def placed(self, variant: Variant) -> Placed | None:
        """Return the minimum of a variant's graph; None where it is not determined, or its score is
        not finite."""
        graph, ties = self.graph, sorted(variant.ties.items())
        places = [(graph.visits[n].visit.camera, tie.place) for n, tie in ties]
        terms = self._terms_of(frozenset(places))
        layout, modes = terms.layout, [self._mode[n] + tie.mode for n, tie in ties]
        values, information = terms.mean.copy(), terms.information.copy()
        if variant.near is not None:
            scales = variant.near.values[: 2 * len(layout.scales)]
            values[: len(scales)] = scales
        ends = np.full((len(ties), 4), (0, 0, -1, 0), _WHOLE)
        ends[:, 0] = [self._node[n] for n, _ in ties]
        ends[:, 1] = [layout.at[place] for place in places]
        counts = Counter(camera for camera, _ in places) if terms.own else {}
        for order, (camera, _) in enumerate(places if terms.own else ()):
            if own := terms.own.get(camera):
                # The information of each tie includes this prior, which counts only once in all.
                information[own] = terms.information[own] * (1 - counts[camera])
                ends[order, 2:] = own.start, own.stop - own.start
                values[own] = self._own[modes[order], : own.stop - own.start]
        said = ends, self._seen[modes], self._information[modes], self._own[modes]
        poses = initial_poses(graph, layout, variant, ties, *said[:2])
        factor, score, ways = Factor(), np.empty(2), list[_Way]()
        steps = self._steps(layout, values)
        for _ in range(_MOST_SCALES):
            ways = [self._way(robot, layout, variant, each) for robot, each in steps.items()]
            is_found = MINIMUM(
                factor,
                *(poses, terms.pose_rows),
                *(values, terms.bounds, terms.value_rows),
                *terms.absolute,
                *(terms.mean, information),
                *(np.concatenate(part) for part in zip(*(way.terms for way in ways), strict=True)),
                *said,
                score,
            )
            if not is_found:
                return None
            before, steps = steps, self._steps(layout, values)
            if all(steps[robot] is each for robot, each in before.items()):
                break
        total = float(score.sum() + self._score[modes].sum()) + terms.constant
        total += sum(float(way.log_covariance.sum()) for way in ways)
        if not np.isfinite(total):
            return None
        return Placed(total, poses, values, variant.ties, variant.breaks, layout, factor)

    def _steps(self, layout: Layout, values: Array) -> dict[str, Steps]:
        """Return each robot's motions by odometry at its current scale errors, which are the first
        of the values."""
        scales = dict.fromkeys(self.graph.paths, np.zeros(2))
        scales |= {robot: values[2 * n : 2 * n + 2] for n, robot in enumerate(layout.scales)}
        return {robot: path.steps(scales[robot]) for robot, path in self.graph.paths.items()}

    def _way(self, robot: str, layout: Layout, variant: Variant, by_odometry: Steps) -> _Way:
        """Return what constrains a robot's motions; kept but for where it was lifted."""
        key = robot, self.graph.silent(variant.nothing), *by_odometry.about.tolist()
        if key not in self._ways:
            self._ways[key] = self._unbroken(robot, layout, variant.nothing, by_odometry)
        gaps = [step for name, step in variant.breaks if name == robot]
        return self._broken(self._ways[key], robot, variant.nothing, gaps)

    def _unbroken(
        self, robot: str, layout: Layout, nothing: frozenset[int], by_odometry: Steps
    ) -> _Way:
        path, count = self.graph.paths[robot], len(by_odometry.motion)
        ends = np.zeros((count, 4), _WHOLE)
        ends[:, 0] = layout.first[robot] + np.arange(count)
        ends[:, 1], ends[:, 2] = ends[:, 0] + 1, -1
        if robot in layout.scales:
            ends[:, 2] = 2 * list(layout.scales).index(robot)
        motion, by_scale = by_odometry.motion.rows(), by_odometry.by_scale.copy()
        about, information = np.tile(by_odometry.about, (count, 1)), path.information.copy()
        way = _Way((ends, motion, information, by_scale, about), path.log_covariance.copy())
        for step, shown in self.graph.seen(robot, nothing).items():
            way.take(step, shown)
        return way

    def _broken(self, way: _Way, robot: str, nothing: frozenset[int], gaps: list[int]) -> _Way:
        """Return a way with these steps, in which the robot was lifted: each as a visit shows it
        across the lift, or else unknown."""
        if not gaps:
            return way
        way, (anywhere, log_room) = way.copy(), self._room[robot]
        ends, _, information, *_ = way.terms
        for step in gaps:
            across = self.graph.across((robot, step), nothing)
            if across is None:  # only the prior of the room keeps it determined
                ends[step, 3], information[step], way.log_covariance[step] = 1, anywhere, log_room
            else:
                way.take(step, across)
                way.log_covariance[step] += log_room
        return way

    def _terms_of(self, places: frozenset[Place]) -> _Terms:
        if places not in self._terms:
            self._terms[places] = self._made_terms(places)
        return self._terms[places]

    def _made_terms(self, places: frozenset[Place]) -> _Terms:
        """Return what is the same in all graphs with these places, and those of the cameras that
        are known from before."""
        graph, known = self.graph, self.graph.data.known.poses
        layout = graph.layout(sorted(places | {(camera, 0) for camera in known}))
        rows = np.full((len(graph.odometry) + len(layout.at), 6), -1, dtype=_WHOLE)
        for robot, mine in layout.nodes.items():
            first = layout.first[robot]
            rows[first : first + len(mine), graph.paths[robot].tangent] = mine
        for place, mine in layout.places.items():
            rows[layout.at[place]] = mine
        sigmas = [graph.paths[robot].scale_sigma for robot in layout.scales]
        scales = np.concatenate([np.zeros(0), *sigmas])
        own, priors, count = {}, [graph.own_prior[camera] for camera in layout.own], len(scales)
        for camera, mine in layout.own.items():
            own[camera], count = slice(count, count + len(mine)), count + len(mine)
        sigma = np.concatenate([np.where(scales > 0, scales, HELD), *(each for _, each in priors)])
        unknown = sum(place > 0 or camera not in known for camera, place in layout.places)
        constant = unknown * graph.events.pose_score
        return _Terms(
            layout,
            rows,
            self._absolute(layout),
            np.where(np.arange(count) < len(scales), _FAR_OFF, np.inf),
            np.concatenate([np.zeros(0, _WHOLE), *layout.scales.values(), *layout.own.values()]),
            np.concatenate([np.zeros(len(scales)), *(mean for mean, _ in priors)]),
            sigma**-2.0,
            own,
            constant + 2 * float(np.log(sigma[len(scales) :]).sum()),
        )

    def _absolute(self, layout: Layout) -> tuple[np.ndarray, Array, Array]:
        """Return the priors on poses: of a path's first, anywhere in the room unless the path is
        the anchored one, and of the cameras known from before, each by its marginal information."""
        graph = self.graph
        which, expected, information = [], [], []
        for robot, path in graph.paths.items():
            variance = graph.room(path)
            if path.is_anchored:
                variance = np.full(len(variance), HELD**2)
            which.append(layout.first[robot])
            expected.append(path.odometry[0])
            information.append(in_all_axes(np.diag(1 / variance), path.tangent))
        which += [layout.at[name, 0] for name in graph.data.known.poses]
        return (
            np.array(which, dtype=_WHOLE),
            np.concatenate([rows_of(expected), graph.known_rows]),
            np.concatenate([np.array(information).reshape(-1, 6, 6), graph.known_information]),
        )


def initial_poses(
    graph: Graph, layout: Layout, variant: Variant, ties: Ties, ends: np.ndarray, seen: Array
) -> Array:
    """Return the initial poses (n, 12) of a layout: as in the graph that the variant is near, or
    else by odometry, with the parts that new ties constrain moved to their first ones.

    `ties`: the variant's (k); `ends` (k, 4): first the two poses that each ties; `seen` (k, 12):
    the second, as seen from the first.
    """
    near = variant.near
    poses = np.concatenate([graph.odometry, np.zeros((len(layout.at), 12))])
    begun, settled = np.zeros((len(poses), 2), _WHOLE), {}
    if near is not None:
        lifted = {robot for robot, _ in near.breaks - variant.breaks}
        for robot, first in layout.first.items():
            mine = slice(first, first + len(graph.paths[robot].stamps_ns))
            if robot not in lifted:
                poses[mine] = near.poses[mine]
        if not lifted:  # else where it put cameras is not known any more
            settled = near.ties
            for place in layout.at.keys() & near.layout.at.keys():
                poses[layout.at[place]] = near.poses[near.layout.at[place]]
                begun[layout.at[place], 1] = 1
    known = [layout.at[camera, 0] for camera in graph.data.known.poses]
    poses[known], begun[known, 0] = graph.known_rows, 1
    is_new = [settled.get(number) != tie for number, tie in ties]
    START(poses, begun, _parts(graph, layout, variant), ends, seen, np.array(is_new, _WHOLE))
    return poses


def _parts(graph: Graph, layout: Layout, variant: Variant) -> np.ndarray:
    """Return the parts (r, 4) of the robots' paths between lifts, the anchored robot's first: its
    poses, whether it begins where it has to, whether it is in the plane."""
    found = []
    for robot in sorted(graph.paths, key=lambda name: not graph.paths[name].is_anchored):
        path, start = graph.paths[robot], layout.first[robot]
        lifts = sorted(gap + 1 for name, gap in variant.breaks if name == robot)
        for first, end in pairwise([0, *lifts, len(path.stamps_ns)]):
            is_held = path.is_anchored and not first
            found.append((start + first, start + end, is_held, path.track.planar))
    return np.array(found, _WHOLE)
