"""Finds the minima of the graphs of many explanations at once.

Graphs with the same ties of visits to places have normal equations of one shape, so Gauss-Newton
runs over all of them together: for small problems most of the time is the overhead of calls, not
arithmetic.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians

from .equations import Equations, Factor, Pattern
from .graph import Graph, Layout, Place, Placed, Variant
from .initial_values import initial_values
from .linear import HELD
from .path import RobotPath
from .shown_steps import shown_steps

_MOST_STEPS = 8
# The iteration ends where each graph's step is smaller than this in every unknown (m, rad), or
# promises a smaller gain in its score.
_SMALL_STEP = 1e-5
_SMALL_GAIN = 1e-3
# The bound of scale errors: no odometry is so far off, and a step beyond it comes from where the
# linearisation is not valid.
_FAR_OFF = 0.9
# Graphs solved together have at most so many matrix entries.
_MOST_NUMBERS = 4_000_000


def placed(graph: Graph, variants: Sequence[Variant]) -> list[Placed | None]:
    """Return the minimum of each variant's graph; None where it is not determined."""
    found: list[Placed | None] = [None] * len(variants)
    alike: dict[tuple[tuple[int, int], ...], list[int]] = {}
    for order, variant in enumerate(variants):
        shape = tuple(sorted((number, tie.place) for number, tie in variant.ties.items()))
        alike.setdefault(shape, []).append(order)
    for shape, orders in alike.items():
        places = {(graph.visits[number].visit.camera, place) for number, place in shape}
        layout = graph.layout(sorted(places | {(camera, 0) for camera in graph.data.known.poses}))
        most = max(1, _MOST_NUMBERS // layout.size**2) if layout.size else len(orders)
        for start in range(0, len(orders), most):
            part = orders[start : start + most]
            minima = _minima(graph, layout, shape, [variants[order] for order in part])
            for order, minimum in zip(part, minima, strict=True):
                found[order] = minimum
    return found


def _minima(
    graph: Graph,
    layout: Layout,
    shape: tuple[tuple[int, int], ...],
    variants: list[Variant],
) -> list[Placed | None]:
    """Return the minima of variants of one shape, None where one is not determined: they are halved
    until it is alone, so that the others are still found."""
    try:
        return _Minimum(graph, layout, shape, variants).found()
    except np.linalg.LinAlgError:
        if len(variants) == 1:
            return [None]
        half = len(variants) // 2
        parts = variants[:half], variants[half:]
        return [each for part in parts for each in _minima(graph, layout, shape, part)]


@dataclass(frozen=True, slots=True)
class _Block:
    """The contribution of k terms of m unknowns each to the normal equations of b variants:
    `hessian` (b, k, m, m), `gradient` (b, k, m), and `cost` (b,), summed over the terms."""

    hessian: Array
    gradient: Array
    cost: Array


def _block(jacobian: Array, residual: Array, information: Array) -> _Block:
    """Return the block of residuals (b, k, r), given their derivatives (b, k, r, m) and information
    (b, k, r, r)."""
    weighted = np.swapaxes(jacobian, -1, -2) @ information
    gradient = (weighted @ residual[..., None])[..., 0]
    cost = np.einsum("bki,bkij,bkj->b", residual, information, residual)
    return _Block(weighted @ jacobian, gradient, cost)


def _prior(error: Array, information: Array) -> _Block:
    """Return the block of a prior on the unknowns themselves, given their errors (b, m) and
    information (m, m)."""
    shape = len(error), 1, *information.shape
    jacobian = np.broadcast_to(np.eye(error.shape[-1]), shape)
    return _block(jacobian, error[:, None], np.broadcast_to(information, shape))


@dataclass(frozen=True, slots=True)
class _Ties:
    """The ties (k) of one robot to cameras with o unknowns of their own, in b variants.

    `nodes`, `places` (k,): by number; `cameras`: by name; `relative` (b, k): base_from_camera by
    the tied mode, `own` (b, k, o): the camera's own unknowns by it, `information`
    (b, k, 6 + o, 6 + o): of both; `rows` (k, d + 6 + o): the unknowns of each tie.
    """

    robot: str
    nodes: np.ndarray
    places: np.ndarray
    cameras: list[str]
    relative: Pose
    own: Array
    information: Array
    rows: np.ndarray


class _Minimum:
    """Gauss-Newton over graphs of one layout; the first axis of arrays is the variants' (b)."""

    def __init__(
        self,
        graph: Graph,
        layout: Layout,
        shape: tuple[tuple[int, int], ...],
        variants: list[Variant],
    ) -> None:
        self.graph, self.layout, self.variants = graph, layout, variants
        self.numbers = [number for number, _ in shape]
        self.keys: list[Place] = [(graph.visits[n].visit.camera, place) for n, place in shape]
        self.shown = {robot: shown_steps(graph, robot, variants) for robot in graph.paths}
        self.modes = np.array([[v.ties[n].mode for n in self.numbers] for v in variants], dtype=int)
        starts = [initial_values(graph, variant) for variant in variants]
        self.nodes = {
            robot: _stacked([nodes[robot] for nodes, _ in starts]) for robot in graph.paths
        }
        self.places = _stacked([Pose.stack([at[key] for key in layout.places]) for _, at in starts])
        self.scales = {robot: np.zeros((len(variants), 2)) for robot in layout.scales}
        self.own = {
            camera: np.tile(graph.own_prior[camera][0], (len(variants), 1)) for camera in layout.own
        }
        for order, (camera, _) in enumerate(self.keys):
            if camera in self.own:
                self.own[camera] = graph.own_values(self.numbers[order])[self.modes[:, order]]
        self.ties = self._tied()
        self.pattern = Pattern(layout.size, self._rows())

    def _tied(self) -> list[_Ties]:
        """Return the ties, grouped by the robot and the number of the camera's own unknowns, so
        that the equations of each group have one shape."""
        graph, layout = self.graph, self.layout
        alike: dict[tuple[str, int], list[int]] = {}
        for order, (number, key) in enumerate(zip(self.numbers, self.keys, strict=True)):
            own = len(layout.own.get(key[0], ()))
            alike.setdefault((graph.visits[number].visit.robot, own), []).append(order)
        index = {key: place for place, key in enumerate(layout.places)}
        found = []
        for (robot, own), orders in alike.items():
            numbers, keys = [self.numbers[o] for o in orders], [self.keys[o] for o in orders]
            modes = [self.modes[:, o] for o in orders]
            said = [graph.relative(n) for n in numbers]
            values = [graph.own_values(n) for n in numbers]
            nodes = np.array([graph.node_of[n] for n in numbers])
            rows = [layout.nodes[robot][nodes], np.array([layout.places[key] for key in keys])]
            if own:
                rows.append(np.array([layout.own[camera] for camera, _ in keys]))
            pairs = list(zip(said, modes, strict=True))
            found.append(
                _Ties(
                    robot,
                    nodes,
                    np.array([index[key] for key in keys]),
                    [camera for camera, _ in keys],
                    Pose(
                        np.stack([seen.rotation[m] for (seen, _), m in pairs], axis=1),
                        np.stack([seen.translation[m] for (seen, _), m in pairs], axis=1),
                    ),
                    np.stack([v[m] for v, m in zip(values, modes, strict=True)], axis=1),
                    np.stack([information[m] for (_, information), m in pairs], axis=1),
                    np.concatenate(rows, axis=1),
                )
            )
        return found

    # -- steps ------------------------------------------------------------------------------------

    def found(self) -> list[Placed | None]:
        """Return the minima, None where a score is not finite. Raise LinAlgError if a graph is not
        determined."""
        for _ in range(_MOST_STEPS):
            equations, cost = self._linearised()
            step = equations.step()
            gain = -np.sum(step * equations.gradient, axis=1)
            self._move(step)
            if np.all((np.abs(step).max(axis=1, initial=0.0) < _SMALL_STEP) | (gain < _SMALL_GAIN)):
                cost = cost - gain
                break
        else:
            equations, cost = self._linearised()
        factors = equations.factors()
        return [self._placed(row, factor, cost[row]) for row, factor in enumerate(factors)]

    def _placed(self, row: int, factor: Factor, cost: float) -> Placed | None:
        score = cost + factor.log_determinant + self._constant(row)
        if not np.isfinite(score):
            return None
        return Placed(
            float(score),
            {robot: nodes[row] for robot, nodes in self.nodes.items()},
            self.variants[row].breaks,
            dict(zip(self.layout.places, self._places_of(row), strict=True)),
            self.layout,
            factor,
        )

    def _places_of(self, row: int) -> list[Pose]:
        rotations, translations = self.places.rotation[row], self.places.translation[row]
        return [Pose(r, t) for r, t in zip(rotations, translations, strict=True)]

    def _constant(self, row: int) -> float:
        """Return the part of a variant's score that does not depend on the unknowns' values."""
        graph, variant = self.graph, self.variants[row]
        score = sum(float(shown.log_covariance[row]) for shown in self.shown.values())
        known = graph.data.known.poses
        unknown = sum(place > 0 or camera not in known for camera, place in self.layout.places)
        score += unknown * graph.events.pose_score
        for camera in self.layout.own:
            score += 2 * float(np.sum(np.log(graph.own_prior[camera][1])))
        return score + sum(graph.visits[n].modes[tie.mode].score for n, tie in variant.ties.items())

    def _move(self, step: Array) -> None:
        for robot, rows in self.layout.nodes.items():
            whole = np.zeros((len(step), len(rows), 6))
            whole[..., self.graph.paths[robot].tangent] = step[:, rows]
            self.nodes[robot] = self.nodes[robot].disturbed(whole)
        for robot, rows in self.layout.scales.items():
            self.scales[robot] = np.clip(self.scales[robot] + step[:, rows], -_FAR_OFF, _FAR_OFF)
        if self.layout.places:
            rows = np.array(list(self.layout.places.values()))
            self.places = self.places.disturbed(step[:, rows])
        for camera, rows in self.layout.own.items():
            self.own[camera] = self.own[camera] + step[:, rows]

    # -- equations --------------------------------------------------------------------------------

    def _rows(self) -> list[np.ndarray]:
        """Return the rows of the unknowns of all blocks, in the order of the blocks in
        `_linearised`."""
        rows = []
        for robot, path in self.graph.paths.items():
            nodes = self.layout.nodes[robot]
            rows.append(nodes[:1])
            if robot in self.scales:
                rows.append(self.layout.scales[robot][None])
            if len(path.stamps_ns) > 1:
                parts = [nodes[:-1], nodes[1:]]
                if robot in self.scales:
                    parts.append(np.tile(self.layout.scales[robot], (len(nodes) - 1, 1)))
                rows.append(np.concatenate(parts, axis=1))
        rows += [ties.rows for ties in self.ties]
        rows += [each[None] for each in self.layout.own.values()]
        rows += [self.layout.places[name, 0][None] for name in self.graph.data.known.poses]
        return rows

    def _linearised(self) -> tuple[Equations, Array]:
        """Return the normal equations, linearised at the current estimate, and its cost (b,)."""
        blocks: list[_Block] = []
        for robot, path in self.graph.paths.items():
            blocks += self._beginning(robot, path)
            if len(path.stamps_ns) > 1:
                blocks.append(self._steps(robot, path))
        blocks += [self._said(ties) for ties in self.ties]
        for camera in self.layout.own:
            mean, sigma = self.graph.own_prior[camera]
            # The information of each tie includes this prior, which counts only once in all.
            times = 1 - sum(name == camera for name, _ in self.keys)
            blocks.append(_prior(self.own[camera] - mean, np.diag(times / sigma**2)))
        blocks += self._known()
        cost = np.zeros(len(self.variants)) + sum(block.cost for block in blocks)
        hessians, gradients = [b.hessian for b in blocks], [b.gradient for b in blocks]
        return self.pattern.equations(hessians, gradients, count=len(self.variants)), cost

    def _beginning(self, robot: str, path: RobotPath) -> list[_Block]:
        """Return the priors on a path's first pose, anywhere in the room unless the path is the
        anchored one, and on its scale errors."""
        tangent = path.tangent
        nodes = self.nodes[robot]
        first = Pose(nodes.rotation[:, 0], nodes.translation[:, 0])
        error = first.difference(path.odometry[0])[:, tangent]
        variance = np.full(len(tangent), HELD**2) if path.is_anchored else self.graph.room(path)
        found = [_prior(error, np.diag(1 / variance))]
        if robot in self.scales:
            held = np.where(path.scale_sigma > 0, path.scale_sigma, HELD)
            found.append(_prior(self.scales[robot], np.diag(held**-2.0)))
        return found

    def _steps(self, robot: str, path: RobotPath) -> _Block:
        """Return the block of the motions between a robot's nodes: by odometry, or by a visit that
        shows one more precisely; where the robot was lifted, by a visit alone, if one shows it."""
        nodes, tangent = self.nodes[robot], path.tangent
        earlier = Pose(nodes.rotation[:, :-1], nodes.translation[:, :-1])
        later = Pose(nodes.rotation[:, 1:], nodes.translation[:, 1:])
        shown = self.shown[robot]
        reported, by_scale = self._reported(robot, path)
        moved = earlier.inverse() @ later
        residual = moved.difference(reported)[..., tangent]
        residual[shown.is_anywhere], by_scale[shown.is_anywhere] = 0.0, 0.0
        by_earlier, by_later = relative_jacobians(earlier, later)
        parts: list[Array] = [
            by_earlier[..., tangent, :][..., tangent],
            by_later[..., tangent, :][..., tangent],
        ]
        if robot in self.scales:
            parts.append(-by_scale)
        return _block(np.concatenate(parts, axis=-1), residual, shown.information)

    def _reported(self, robot: str, path: RobotPath) -> tuple[Pose, Array]:
        """Return the motions (b, m) that odometry reports or visits show, at the current scale
        errors, and their derivatives (b, m, d, 2) by these."""
        count, tangent = len(self.variants), path.tangent
        scales = self.scales.get(robot, np.zeros((count, 2)))
        steps = [path.steps(row) for row in scales]
        by_scale = np.array([each.by_scale for each in steps])
        change = scales - np.array([each.about for each in steps])
        motion = _stacked([each.motion for each in steps])
        reported = motion.disturbed((by_scale @ change[:, None, :, None])[..., 0])
        shown = self.shown[robot]
        at = shown.rows, shown.steps
        seen = shown.motion.disturbed((shown.by_scale @ scales[shown.rows][..., None])[..., 0])
        reported.rotation[at], reported.translation[at] = seen.rotation, seen.translation
        by_scale[at] = shown.by_scale
        return reported, by_scale[..., tangent, :]

    def _said(self, ties: _Ties) -> _Block:
        """Return the block of ties: the poses of cameras relative to the robot that visits show."""
        nodes = self.nodes[ties.robot]
        base = Pose(nodes.rotation[:, ties.nodes], nodes.translation[:, ties.nodes])
        there = Pose(self.places.rotation[:, ties.places], self.places.translation[:, ties.places])
        residual = (base.inverse() @ there).difference(ties.relative)
        by_base, by_place = relative_jacobians(base, there)
        tangent = self.graph.paths[ties.robot].tangent
        jacobian = np.concatenate([by_base[..., tangent], by_place], axis=-1)
        own = ties.own.shape[-1]
        if own:
            mine = np.stack([self.own[camera] for camera in ties.cameras], axis=1) - ties.own
            residual = np.concatenate([residual, mine], axis=-1)
            before = jacobian.shape[-1]
            whole = np.zeros((*residual.shape, before + own))
            whole[..., :6, :before] = jacobian
            whole[..., 6:, before:] = np.eye(own)
            jacobian = whole
        return _block(jacobian, residual, ties.information)

    def _known(self) -> list[_Block]:
        """Return the priors on the poses of cameras known from before, each by its marginal
        information."""
        known, found = self.graph.data.known, []
        index = {key: place for place, key in enumerate(self.layout.places)}
        for order, (name, pose) in enumerate(known.poses.items()):
            information, place = self.graph.known_information(order), index[name, 0]
            there = Pose(self.places.rotation[:, place], self.places.translation[:, place])
            found.append(_prior(there.difference(pose), information))
        return found


def _stacked(poses: list[Pose]) -> Pose:
    """Stack the poses (n) of each of b variants as (b, n)."""
    return Pose(
        np.array([pose.rotation for pose in poses]), np.array([pose.translation for pose in poses])
    )
