"""The oracle: for small sessions, the posterior of every explanation, enumerated outright.

An explanation says of each picture which face each sighting shows and which way up, or that it is
wrong; of each gap between pictures whether the robot was lifted in it; of each camera whether it
was moved between two of its pictures. Its score is -2 ln of its posterior with all poses integrated
out by Laplace's approximation, up to a constant: χ² at the minimum, the log-determinant of its
second derivative, the priors of what happened, and of each pose that may be anywhere its room.

Nothing of fusion is used: the poses of robot and cameras are found by a dense Levenberg-Marquardt
with derivatives by differences, over many explanations of one structure at a time. Explanations are
left out only where a bound says that they hold less than e^(-window/2) of the best one: no picture
can be more probable than its best reading, nor two pictures of a camera agree better than the
camera's height and the vertical that they show, and a camera's first picture costs the same in
whatever company.
"""

import math
from functools import cached_property

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from support.oracle.solver import Solution, Structure, gaps_of
from support.oracle.verdict import Explanation, Scored, Verdict, apart, verdict_of
from support.oracle.views import Label, Look, Priors, Reading, corners_of, readings_of, residuals

from trigpoint.contract.messages import Odometry
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise
from trigpoint.site.target import Target

WINDOW = 40.0  # of cost: 2e-9 of the best explanation
_BEAM = 200
_MOST_EXPLANATIONS = 20_000
_REFINED = 30.0  # of cost: explanations near the best are solved over the pixels themselves
_REFINEMENTS = 3
_AT_MINIMUM = 1e-6  # of χ²: a reading that nothing pulls is solved already
# How much of a disagreement that is worked out to first order is counted on.
_TRUST = 0.5
_PARALLEL = 1e-12  # the sine of an angle about no axis of its own


class _Longer(Struct, frozen=True):
    """An explanation of one picture more, and what it costs at least, or exactly."""

    node: Explanation
    bound: float
    is_exact: bool


class Oracle:
    """All explanations of one robot's pictures.

    `odometry`: every message, in order; `looks`: pictures with a sighting, in order, each at the
    stamp of a message. Raises ValueError where a picture's stamp has none.
    """

    def __init__(
        self,
        odometry: list[Odometry],
        looks: list[Look],
        target: Target,
        noise: OdometryNoise,
        priors: Priors | None = None,
    ) -> None:
        self.looks, self.target = looks, target
        self.priors = priors if priors is not None else Priors()
        self.readings = [readings_of(look, target, self.priors) for look in looks]
        self._start, self._gaps = gaps_of(odometry, [look.stamp_ns for look in looks], noise)
        self._earlier = [
            [k for k in range(view) if looks[k].camera == look.camera]
            for view, look in enumerate(looks)
        ]
        self._pairs = {
            (k, view): _disagreement(self.readings[k], self.readings[view])
            for view in range(len(looks))
            for k in self._earlier[view]
        }
        room = 2 * math.log(self.priors.camera_room)
        self._alone = [_alone(readings, room) for readings in self.readings]
        self._structures: dict[tuple[object, ...], Structure] = {}

    @cached_property
    def explanations(self) -> list[Scored]:
        """Every explanation within the window of the best one, best first.

        Raises ValueError where they are too many to be enumerated.
        """
        beam = self._searched(np.inf, _BEAM)
        found = self._searched(min(beam.values()) + WINDOW, None)
        best = min(found.values())
        near = [e for e, cost in found.items() if cost < best + _REFINED]
        far = [e for e, cost in found.items() if cost >= best + _REFINED]
        return _distinct([*self._scored(near, times=_REFINEMENTS), *self._scored(far, times=0)])

    def verdicts(self) -> dict[str, Verdict]:
        """Of each camera that has a picture."""
        scored = self.explanations
        masses = np.exp(-0.5 * np.array([s.cost - scored[0].cost for s in scored]))
        masses /= masses.sum()
        cameras = sorted({look.camera for look in self.looks})
        return {camera: verdict_of(camera, scored, masses) for camera in cameras}

    # -- the search -------------------------------------------------------------------------------

    def _searched(self, limit: float, width: int | None) -> dict[Explanation, float]:
        """Explanations of all pictures and their costs; those whose bound is above the limit, and
        beyond a beam's width, are left out."""
        nodes: dict[Explanation, float] = {Explanation(): 0.0}
        for view in range(len(self.looks)):
            after = self._least_after(view)
            grown = [
                longer
                for node, cost in nodes.items()
                for longer in self._extended(node, cost, view, limit - after)
            ]
            if width is None and len(grown) > _MOST_EXPLANATIONS:
                raise ValueError(f"{len(grown)} explanations of {view + 1} pictures are too many")
            if width is not None:
                grown = sorted(grown, key=lambda longer: longer.bound)[:width]
            costs = {longer.node: longer.bound for longer in grown if longer.is_exact}
            costs |= self._costs([longer.node for longer in grown if not longer.is_exact])
            nodes = {node: cost for node, cost in costs.items() if cost + after <= limit}
        return nodes

    def _extended(self, node: Explanation, cost: float, view: int, limit: float) -> list[_Longer]:
        """A node with each reading of a picture, with and without a lift and a move before it,
        where that may cost less than the limit."""
        found = []
        is_met_again = bool(self._earlier[view])
        for is_moved in (False, True) if is_met_again else (False,):
            moves = node.moves | {view} if is_moved else node.moves
            bounds, is_exact = self._bounds(node, view, is_moved=is_moved)
            # The map begins where the robot is seen first.
            for is_lifted in (False, True) if view else (False,):
                lifts = node.lifts | {view} if is_lifted else node.lifts
                before = self.priors.happened(len(node.lifts) + len(node.moves))
                after = self.priors.happened(len(lifts) + len(moves))
                least = bounds + (cost + after - before)
                for index in np.flatnonzero(least <= limit).tolist():
                    longer = Explanation((*node.readings, index), lifts, moves)
                    found.append(_Longer(longer, float(least[index]), bool(is_exact[index])))
        return found

    def _bounds(self, node: Explanation, view: int, *, is_moved: bool) -> tuple[Array, np.ndarray]:
        """What each of a picture's readings (n,) costs at least beside what comes before it, and
        whether it is exactly that: the first picture of a place, or one that is wrong, costs the
        same in whatever company."""
        first, own, is_wrong = self._alone[view]
        same = [] if is_moved else self._same_place(node, view)
        right = [k for k in same if self.readings[k][node.readings[k]].covariance is not None]
        if not right:
            return first, np.ones(len(first), dtype=bool)
        agreed = np.max([self._pairs[k, view][node.readings[k]] for k in right], axis=0)
        return np.where(is_wrong, first, own + _TRUST * agreed), is_wrong

    def _same_place(self, node: Explanation, view: int) -> list[int]:
        """Earlier pictures of the camera since it was last moved."""
        since = max((k for k in self._earlier[view] if k in node.moves), default=0)
        return [k for k in self._earlier[view] if k >= since]

    def _least_after(self, view: int) -> float:
        """What the pictures after this one cost at least."""
        seen = {look.camera for look in self.looks[: view + 1]}
        least = 0.0
        for look, (first, own, _) in zip(
            self.looks[view + 1 :], self._alone[view + 1 :], strict=True
        ):
            if look.camera in seen:
                least += float(own.min())
            else:
                least += float(first.min())
                seen.add(look.camera)
        return least

    def _costs(self, nodes: list[Explanation]) -> dict[Explanation, float]:
        """Costs of explanations of the first pictures, those of one structure solved together."""
        costs: dict[Explanation, float] = {}
        for same in self._by_structure(nodes):
            solution = self._solved(same, self._chosen(same))
            keep = ~solution.is_below_floor if self.priors.is_above_floor else ...
            good = np.array(range(len(same)))[keep]
            costs |= {same[i]: float(solution.costs[i]) for i in good.tolist()}
        return costs

    def _by_structure(self, nodes: list[Explanation]) -> list[list[Explanation]]:
        groups: dict[tuple[object, ...], list[Explanation]] = {}
        for node in nodes:
            groups.setdefault(self._key(node), []).append(node)
        return list(groups.values())

    def _key(self, node: Explanation) -> tuple[object, ...]:
        right = tuple(
            self.readings[view][index].covariance is not None
            for view, index in enumerate(node.readings)
        )
        return right, tuple(sorted(node.lifts)), tuple(sorted(node.moves))

    def _chosen(self, nodes: list[Explanation]) -> list[list[Reading]]:
        return [
            [self.readings[view][index] for view, index in enumerate(node.readings)]
            for node in nodes
        ]

    def _solved(self, nodes: list[Explanation], chosen: list[list[Reading]]) -> Solution:
        key = self._key(nodes[0])
        if key not in self._structures:
            right, _, _ = key
            assert isinstance(right, tuple)
            cameras = [look.camera for look in self.looks[: len(right)]]
            self._structures[key] = Structure(
                self._start, self._gaps[: len(right)], cameras, right, nodes[0], self.priors
            )
        return self._structures[key].solved(chosen)

    def _scored(self, nodes: list[Explanation], *, times: int) -> list[Scored]:
        """Explanations with their cameras' places, solved so many times more over the pixels
        themselves; without those by which a camera hangs below the floor."""
        scored = []
        for same in self._by_structure(nodes):
            chosen = self._chosen(same)
            solution = self._solved(same, chosen)
            for _ in range(times):
                chosen = [
                    [self._relinearised(view, one, solution, row) for view, one in enumerate(of)]
                    for row, of in enumerate(chosen)
                ]
                solution = self._solved(same, chosen)
            is_out = self.priors.is_above_floor & solution.is_below_floor
            for row in np.flatnonzero(~is_out).tolist():
                labels = tuple(reading.labels for reading in chosen[row])
                scored.append(_of_solution(same[row], labels, solution, row))
        return scored

    def _relinearised(self, view: int, reading: Reading, solution: Solution, row: int) -> Reading:
        """A reading's quadratic about where a solution puts it, not about its own minimum."""
        if reading.camera_from_base is None or reading.covariance is None:
            return reading
        look, pose = self.looks[view], solution.camera_from_base(view, row)
        if apart(pose, reading.camera_from_base, reading.covariance) < _AT_MINIMUM:
            return reading
        points, pixels, sigmas = corners_of(look, self.target, reading.labels)
        error, jacobian = residuals(look.lens, pose, points, pixels, sigmas)
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        step = -covariance @ (jacobian.T @ error)
        chi2 = float(error @ error + error @ (jacobian @ step))
        moved = pose.disturbed(step)
        return replace(reading, camera_from_base=moved, chi2=chi2, covariance=covariance)


def _of_solution(
    node: Explanation, labels: tuple[tuple[Label, ...], ...], solution: Solution, row: int
) -> Scored:
    structure = solution.structure
    last = {c: number for c, number in structure.last_places.items() if number is not None}
    places = {c: solution.place(n, row) for c, n in last.items() if structure.is_tied[n]}
    cut = frozenset(c for c, n in last.items() if not structure.is_tied[n])
    return Scored(node, labels, float(solution.costs[row]), places, cut)


def _alone(readings: list[Reading], room: float) -> tuple[Array, Array, np.ndarray]:
    """Of each reading (n,): -2 ln of its evidence for a camera of which nothing is known, what it
    costs at least, and whether all its sightings are wrong. `room`: 2 ln of the cameras'."""
    is_wrong = np.array([reading.covariance is None for reading in readings])
    first = np.array([reading.first_cost for reading in readings]) + np.where(is_wrong, 0.0, room)
    return first, np.array([reading.cost + reading.chi2 for reading in readings]), is_wrong


def _disagreement(first: list[Reading], second: list[Reading]) -> Array:
    """χ² that a camera's height and the vertical that it sees differ by, which no motion of a robot
    on a floor changes; (n, m) of two pictures' readings, 0 where all sightings are wrong."""
    rows, (up, height, spread) = _upright(first)
    columns, (up_too, height_too, spread_too) = _upright(second)
    up, height, spread = up[:, None], height[:, None], spread[:, None]
    axis = np.cross(up_too, up)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, np.sum(up * up_too, axis=-1))[..., None]
    any_axis = angle * np.array([1.0, 0.0, 0.0])
    turn = axis * (angle / np.maximum(sine, _PARALLEL)[..., None])
    turn = np.where(sine[..., None] > _PARALLEL, turn, any_axis)
    error = np.concatenate([turn, (height - height_too)[..., None]], axis=-1)
    free = np.concatenate([up, np.zeros((len(rows), 1, 1))], axis=-1)  # the heading
    information = np.linalg.inv(spread + spread_too)
    weighted, open_one = ((information @ v[..., None])[..., 0] for v in (error, free))
    along = np.sum(free * weighted, axis=-1)
    found = np.zeros((len(first), len(second)))
    found[np.ix_(rows, columns)] = np.sum(error * weighted, axis=-1) - along**2 / np.sum(
        free * open_one, axis=-1
    )
    return found


def _upright(readings: list[Reading]) -> tuple[list[int], tuple[Array, Array, Array]]:
    """The numbers (k) of those readings that not all sightings are wrong in; of each the vertical
    in the camera's axes (k, 3), the camera's height (k,), and the covariance (k, 4, 4) of a turn of
    the first and of the second."""
    found = [
        (number, reading.camera_from_base, reading.covariance)
        for number, reading in enumerate(readings)
        if reading.camera_from_base is not None and reading.covariance is not None
    ]
    pose = Pose.stack([pose for _, pose, _ in found])
    covariance = np.array([covariance for *_, covariance in found]).reshape(-1, 6, 6)
    up = pose.rotation[:, :, 2]
    by = np.zeros((len(found), 4, 6))
    by[:, :3, 3:] = np.eye(3)
    by[:, 3, :3], by[:, 3, 3:] = -up, -np.cross(up, pose.translation)
    height = -np.sum(up * pose.translation, axis=-1)
    return [number for number, *_ in found], (up, height, by @ covariance @ np.swapaxes(by, 1, 2))


def _distinct(scored: list[Scored]) -> list[Scored]:
    """Best first; minima that came to be one are counted once."""
    kept: dict[tuple[object, ...], list[Scored]] = {}
    for one in sorted(scored, key=lambda s: s.cost):
        key = (one.labels, one.explanation.lifts, one.explanation.moves)
        same = kept.setdefault(key, [])
        if not any(_is_one_minimum(one, other) for other in same):
            same.append(one)
    return sorted((s for same in kept.values() for s in same), key=lambda s: s.cost)


def _is_one_minimum(one: Scored, other: Scored) -> bool:
    if not one.places or one.places.keys() != other.places.keys():
        return False
    return all(
        apart(pose, other.places[camera][0], covariance) < 1.0
        for camera, (pose, covariance) in one.places.items()
    )
