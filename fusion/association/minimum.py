"""The minimum of a graph, for many explanations that differ only in how visits are read.

Gauss-Newton over all of them at once: their equations have one shape, and most of the time of small
problems is spent in saying what to compute.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians

from .graph import HELD, Graph, Layout, Place, Placed, RobotPath, Variant, own_values

_MOST_STEPS = 8
# Where no step moves anything by more than this (m, rad), or promises more of the score.
_SMALL_STEP = 1e-5
_SMALL_GAIN = 1e-3
# No odometry's scale is so far off; a step beyond comes from where the first order means nothing.
_FAR_OFF = 0.9
# So many numbers of equations are held at once.
_MOST_NUMBERS = 4_000_000


def placed(graph: Graph, variants: Sequence[Variant]) -> list[Placed | None]:
    """The minimum for each variant; None where it is not determined."""
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
    """Where one of them is not determined, the others are all the same."""
    try:
        return _Minimum(graph, layout, shape, variants).found()
    except np.linalg.LinAlgError:
        if len(variants) == 1:
            return [None]
        half = len(variants) // 2
        parts = variants[:half], variants[half:]
        return [each for part in parts for each in _minima(graph, layout, shape, part)]


class _Minimum:
    """Gauss-Newton over graphs of one layout; arrays lead with the variants (b)."""

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
        self.modes = np.array([[v.ties[n].mode for n in self.numbers] for v in variants], dtype=int)
        self.nodes = {
            robot: _stacked([_start(graph, robot, variant) for variant in variants])
            for robot in graph.paths
        }
        self.places = self._start_places()
        self.scales = {robot: np.zeros((len(variants), 2)) for robot in layout.scales}
        self.own = {
            camera: np.tile(graph.own_prior[camera][0], (len(variants), 1)) for camera in layout.own
        }
        for order, (camera, _) in enumerate(self.keys):
            if camera in self.own:
                self.own[camera] = self._own_values(order)

    def _start_places(self) -> dict[Place, Pose]:
        places = {(camera, 0): pose for camera, pose in self.graph.data.known.poses.items()}
        found = {key: pose.repeated(len(self.variants)) for key, pose in places.items()}
        for order, key in enumerate(self.keys):
            if key in found:
                continue
            seen = self._nodes_of(order) @ self._relative(order)[0]
            near = [v.near.places.get(key) if v.near is not None else None for v in self.variants]
            chosen = [there or seen[row] for row, there in enumerate(near)]
            found[key] = Pose.stack(chosen)
        return found

    def _nodes_of(self, order: int) -> Pose:
        """Where the robot of a tie was, (b)."""
        number = self.numbers[order]
        nodes = self.nodes[self.graph.visits[number].visit.robot]
        node = self.graph.node_of[number]
        return Pose(nodes.rotation[:, node], nodes.translation[:, node])

    def _relative(self, order: int) -> tuple[Pose, Array]:
        """What a tie says: base_from_camera (b) and its information (b, q, q)."""
        seen, information = self.graph.relative(self.numbers[order])
        return seen[self.modes[:, order]], information[self.modes[:, order]]

    def _own_values(self, order: int) -> Array:
        """What a tie says of its camera's own unknowns, (b, o)."""
        modes = self.graph.visits[self.numbers[order]].modes
        camera = self.keys[order][0]
        values = np.array([own_values(self.graph.data, camera, mode) for mode in modes])
        return values[self.modes[:, order]]

    # -- steps ------------------------------------------------------------------------------------

    def found(self) -> list[Placed | None]:
        """The minima."""
        for _ in range(_MOST_STEPS):
            self._linearise()
            scale = self._scale()
            scaled = self.matrix * scale[:, :, None] * scale[:, None]
            step = -scale * np.linalg.solve(scaled, (scale * self.gradient)[..., None])[..., 0]
            gain = -np.sum(step * self.gradient, axis=1)
            self._move(step)
            if np.all((np.abs(step).max(axis=1, initial=0.0) < _SMALL_STEP) | (gain < _SMALL_GAIN)):
                break
        self._linearise()
        scale = self._scale()
        factor = np.linalg.cholesky(self.matrix * scale[:, :, None] * scale[:, None])
        factor = factor / scale[..., None]
        diagonal = np.diagonal(factor, axis1=1, axis2=2)
        score = self.cost + 2 * np.sum(np.log(diagonal), axis=1)
        return [self._placed(row, factor, score[row]) for row in range(len(self.variants))]

    def _scale(self) -> Array:
        """(b, n): what is known exactly and what is hardly known have equations of one size."""
        return 1 / np.sqrt(np.diagonal(self.matrix, axis1=1, axis2=2))

    def _placed(self, row: int, factor: Array, score: float) -> Placed | None:
        score += self._constant(row)
        if not np.isfinite(score):
            return None
        return Placed(
            float(score),
            {robot: nodes[row] for robot, nodes in self.nodes.items()},
            {key: pose[row] for key, pose in self.places.items()},
            self.layout,
            factor[row].copy(),
        )

    def _constant(self, row: int) -> float:
        """What does not hang on where things are."""
        graph, variant, score = self.graph, self.variants[row], 0.0
        for robot, path in graph.paths.items():
            broken = [gap for gap in variant.breaks if gap[0] == robot]
            score += float(np.sum(np.delete(path.log_covariance, [step for _, step in broken])))
            score += len(broken) * float(np.sum(np.log(graph.room(path))))
            score -= sum(one.surprise for gap in broken if (one := graph.across(gap)))
        known = graph.data.known.poses
        unknown = sum(place > 0 or camera not in known for camera, place in self.places)
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
        for key, rows in self.layout.places.items():
            self.places[key] = self.places[key].disturbed(step[:, rows])
        for camera, rows in self.layout.own.items():
            self.own[camera] = self.own[camera] + step[:, rows]

    # -- equations --------------------------------------------------------------------------------

    def _linearise(self) -> None:
        count, size = len(self.variants), self.layout.size
        self.matrix = np.zeros((count, size, size))
        self.gradient, self.cost = np.zeros((count, size)), np.zeros(count)
        for robot, path in self.graph.paths.items():
            self._add_first(robot, path)
            if len(path.stamps_ns) > 1:
                self._add_steps(robot, path)
        for order in range(len(self.numbers)):
            self._add_tie(order)
        for camera, rows in self.layout.own.items():
            mean, sigma = self.graph.own_prior[camera]
            # Each tie has the prior once; together they have it once.
            times = 1 - sum(name == camera for name, _ in self.keys)
            self._add(rows, np.eye(len(rows)), self.own[camera] - mean, np.diag(times / sigma**2))
        self._add_known()

    def _add(self, rows: np.ndarray, jacobian: Array, residual: Array, information: Array) -> None:
        """Equations (b, k) of unknowns in these rows (m,), no row twice."""
        weighted = np.swapaxes(jacobian, -1, -2) @ information
        self.matrix[:, rows[:, None], rows] += weighted @ jacobian
        self.gradient[:, rows] += (weighted @ residual[..., None])[..., 0]
        self.cost += np.sum(residual * (information @ residual[..., None])[..., 0], axis=-1)

    def _add_first(self, robot: str, path: RobotPath) -> None:
        """Where a path begins, and its scales' prior."""
        tangent = path.tangent
        nodes = self.nodes[robot]
        first = Pose(nodes.rotation[:, 0], nodes.translation[:, 0])
        error = first.difference(path.odometry[0])[:, tangent]
        variance = np.full(len(tangent), HELD**2) if path.is_anchored else self.graph.room(path)
        rows = self.layout.nodes[robot][0]
        self._add(rows, np.eye(len(tangent)), error, np.diag(1 / variance))
        if robot in self.scales:
            held = np.where(path.scale_sigma > 0, path.scale_sigma, HELD)
            rows = self.layout.scales[robot]
            self._add(rows, np.eye(2), self.scales[robot], np.diag(held**-2.0))

    def _add_steps(self, robot: str, path: RobotPath) -> None:
        """What odometry says between a robot's nodes; where it was lifted, what a visit does."""
        nodes, tangent, d = self.nodes[robot], path.tangent, len(path.tangent)
        earlier = Pose(nodes.rotation[:, :-1], nodes.translation[:, :-1])
        later = Pose(nodes.rotation[:, 1:], nodes.translation[:, 1:])
        reported, by_scale = self._reported(robot, path)
        moved = earlier.inverse() @ later
        residual = moved.difference(reported)[..., tangent]
        by_earlier, by_later = relative_jacobians(earlier, later)
        parts: list[Array] = [
            by_earlier[..., tangent, :][..., tangent],
            by_later[..., tangent, :][..., tangent],
        ]
        information = np.tile(path.information, (len(self.variants), 1, 1, 1))
        for row, variant in enumerate(self.variants):
            for name, step in variant.breaks:
                if name != robot:
                    continue
                across, by_scale[row, step] = self.graph.across((name, step)), 0.0
                if across is None:  # anywhere: the width alone keeps it determined
                    information[row, step] = np.diag(1 / self.graph.room(path))
                    residual[row, step] = 0.0
                else:
                    information[row, step] = np.linalg.inv(across.covariance)
                    residual[row, step] = moved[row][step].difference(across.motion)[tangent]
        if robot in self.scales:
            parts.append(-by_scale)
        jacobian = np.concatenate(parts, axis=-1)
        weighted = np.swapaxes(jacobian, -1, -2) @ information
        hessian, gradient = weighted @ jacobian, (weighted @ residual[..., None])[..., 0]
        self.cost += np.einsum("bmi,bmij,bmj->b", residual, information, residual)
        rows = self.layout.nodes[robot]
        ends = [(rows[:-1], slice(0, d)), (rows[1:], slice(d, 2 * d))]
        for here, part in ends:
            self.gradient[:, here] += gradient[..., part]
            for there, other in ends:
                self.matrix[:, here[:, :, None], there[:, None, :]] += hessian[..., part, other]
        if robot in self.scales:
            scales, last = self.layout.scales[robot], slice(2 * d, None)
            self.gradient[:, scales] += gradient[..., last].sum(axis=1)
            self.matrix[:, scales[:, None], scales] += hessian[..., last, last].sum(axis=1)
            for here, part in ends:
                crossed = hessian[..., part, last]
                self.matrix[:, here[:, :, None], scales] += crossed
                self.matrix[:, scales[None, :, None], here[:, None, :]] += np.swapaxes(
                    crossed, -1, -2
                )

    def _reported(self, robot: str, path: RobotPath) -> tuple[Pose, Array]:
        """The motions that odometry reports (b, m) by the scales, and their derivatives."""
        count, tangent = len(self.variants), path.tangent
        scales = self.scales.get(robot, np.zeros((count, 2)))
        steps = [path.steps(row) for row in scales]
        by_scale = np.array([each.by_scale for each in steps])
        change = scales - np.array([each.about for each in steps])
        motion = _stacked([each.motion for each in steps])
        reported = motion.disturbed((by_scale @ change[:, None, :, None])[..., 0])
        return reported, by_scale[..., tangent, :]

    def _add_tie(self, order: int) -> None:
        """What a visit says of where its camera is from the robot."""
        number, key = self.numbers[order], self.keys[order]
        robot, node = self.graph.visits[number].visit.robot, self.graph.node_of[number]
        relative, information = self._relative(order)
        base, there = self._nodes_of(order), self.places[key]
        residual = (base.inverse() @ there).difference(relative)
        by_base, by_place = relative_jacobians(base, there)
        jacobian = np.concatenate(
            [by_base[..., self.graph.paths[robot].tangent], by_place], axis=-1
        )
        rows = [self.layout.nodes[robot][node], self.layout.places[key]]
        if key[0] in self.own:
            mine = self.own[key[0]] - self._own_values(order)
            residual = np.concatenate([residual, mine], axis=-1)
            whole = np.zeros(
                (len(residual), residual.shape[-1], jacobian.shape[-1] + mine.shape[-1])
            )
            whole[:, :6, : jacobian.shape[-1]] = jacobian
            whole[:, 6:, jacobian.shape[-1] :] = np.eye(mine.shape[-1])
            jacobian = whole
            rows.append(self.layout.own[key[0]])
        self._add(np.concatenate(rows), jacobian, residual, information)

    def _add_known(self) -> None:
        """What is known of cameras from before, each for itself."""
        known = self.graph.data.known
        for order, (name, pose) in enumerate(known.poses.items()):
            part = slice(6 * order, 6 * order + 6)
            information = np.linalg.inv(np.linalg.inv(known.information)[part, part])
            error = self.places[name, 0].difference(pose)
            self._add(self.layout.places[name, 0], np.eye(6), error, information)


# -- where it starts ------------------------------------------------------------------------------


def _start(graph: Graph, robot: str, variant: Variant) -> Pose:
    """A robot's nodes to start from."""
    near = variant.near
    if near is not None and not any(name == robot for name, _ in variant.breaks):
        return near.nodes[robot]
    return _chained(graph, robot, variant)


def _chained(graph: Graph, robot: str, variant: Variant) -> Pose:
    """Along odometry; after a break from where the next tie to a place seen before puts it."""
    path = graph.paths[robot]
    places: dict[Place, Pose] = {
        (camera, 0): pose for camera, pose in graph.data.known.poses.items()
    }
    motion = path.steps(np.zeros(2)).motion if len(path.stamps_ns) > 1 else None
    poses, loose, since = [path.odometry[0]], not path.is_anchored, 0
    ties = dict(_ties_by_node(graph, robot, variant))
    for node in range(len(path.stamps_ns)):
        if node:
            assert motion is not None
            poses.append(poses[-1] @ motion[node - 1])
            if (robot, node - 1) in variant.breaks:
                loose, since = True, node
        for key, seen in ties.get(node, []):
            if key in places and loose:
                there = places[key] @ seen.inverse()
                if path.track.planar:
                    x, y, _ = there.translation
                    there = Pose.planar(x, y, there.heading)
                shift = there @ poses[-1].inverse()
                poses[since:] = [shift @ pose for pose in poses[since:]]
                loose = False
            if not loose:
                places.setdefault(key, poses[-1] @ seen)
    return Pose.stack(poses)


def _ties_by_node(
    graph: Graph, robot: str, variant: Variant
) -> Iterator[tuple[int, list[tuple[Place, Pose]]]]:
    """By node of a robot: what its ties there see, and where from it."""
    found: dict[int, list[tuple[Place, Pose]]] = {}
    for number, tie in variant.ties.items():
        visit = graph.visits[number].visit
        if visit.robot == robot:
            seen = graph.relative(number)[0][tie.mode]
            found.setdefault(graph.node_of[number], []).append(((visit.camera, tie.place), seen))
    yield from found.items()


def _stacked(poses: list[Pose]) -> Pose:
    """Poses (n) of b variants as one (b, n)."""
    return Pose(
        np.array([pose.rotation for pose in poses]), np.array([pose.translation for pose in poses])
    )
