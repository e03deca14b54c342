"""The minimum of a pose graph, held to scipy's over the same terms with derivatives by differences,
and where its search starts."""

from dataclasses import dataclass

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.optimize import least_squares
from support.oracle.sessions import Shape, graph_of

from trigpoint.fusion.association.agreement import AGREEMENT, agreement
from trigpoint.fusion.association.graph import Factor, Graph, Layout, Placed, Tie, Variant
from trigpoint.fusion.association.minimum import MINIMUM, Minima, initial_poses
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes

NODES, PLACES, SCALES, OWN = 4, 2, 2, 3
PLANAR = [0, 1, 5]
UNKNOWNS = 3 * NODES + 6 * PLACES + SCALES + OWN
BY_SCALE = 0.1
LIFTED = 1  # the step of which only the room says anything
ROOM = np.diag([0.01, 0.01, 0.0, 0.0, 0.0, 0.1])


@dataclass
class Drawn:
    """Terms of a planar robot's four nodes, two cameras, one lens and the scale errors."""

    start: Pose
    expected: Pose
    steps: Pose
    by_scale: Array
    about: Array
    ties: Pose
    own: Array
    tie_information: Array
    ends: np.ndarray

    @classmethod
    def of(cls, seed: int) -> "Drawn":
        random = np.random.default_rng(seed)
        nodes = Pose.planar(np.arange(NODES) * 0.7, random.normal(0, 0.2, NODES), [0, 0.3, 0.9, 2])
        places = Pose.from_vector(random.normal(0, 1, (PLACES, 6)))
        both = Pose.joined([nodes, places])
        ends = np.array([[0, 4], [1, 5], [2, 4], [3, 5]])
        seen = both[ends[:, 0]].inverse() @ both[ends[:, 1]]
        square = random.normal(0, 1, (len(ends), 6 + OWN, 6 + OWN))
        steps = nodes[: NODES - 1].inverse() @ nodes[1:]
        planar = np.zeros((NODES - 1, 6))
        planar[:, PLANAR] = random.normal(0, 0.005, (NODES - 1, 3))
        by_scale = np.zeros((NODES - 1, 6, 2))
        by_scale[:, 0, 0], by_scale[:, 5, 1] = 0.7, 0.5
        return cls(
            both,
            nodes[0],
            steps.disturbed(planar),
            by_scale,
            random.normal(0, 0.01, (NODES - 1, 2)),
            seen.disturbed(random.normal(0, 0.003, (len(ends), 6))),
            random.normal(0, 0.01, (len(ends), OWN)),
            50 * square @ np.swapaxes(square, 1, 2) + 100 * np.eye(6 + OWN),
            ends,
        )

    def moved(self, by: Array) -> tuple[Pose, Array]:
        """Poses and values, these unknowns from where they start."""
        whole = np.zeros((NODES + PLACES, 6))
        whole[:NODES, PLANAR] = by[: 3 * NODES].reshape(-1, 3)
        whole[NODES:] = by[3 * NODES : 3 * NODES + 6 * PLACES].reshape(-1, 6)
        return self.start.disturbed(whole), by[3 * NODES + 6 * PLACES :]

    def residuals(self, by: Array) -> Array:
        """Every term, whitened."""
        poses, values = self.moved(by)
        first = poses[0].difference(self.expected)[PLANAR] * 1e3
        change = (self.by_scale @ (values[:SCALES] - self.about)[..., None])[..., 0]
        steps = poses[: NODES - 1].inverse() @ poses[1:NODES]
        step = steps.difference(self.steps.disturbed(change))[:, PLANAR] * 40
        step = np.delete(step, LIFTED, axis=0)
        ties = (poses[self.ends[:, 0]].inverse() @ poses[self.ends[:, 1]]).difference(self.ties)
        told = np.concatenate([ties, values[SCALES:] - self.own], axis=1)
        roots = np.swapaxes(np.linalg.cholesky(self.tie_information), 1, 2)
        tie = (roots @ told[..., None]).ravel()
        return np.concatenate([first, step.ravel(), tie, values / BY_SCALE])

    def found(self) -> tuple[int, Pose, Array, Array, Factor]:
        """By the core."""
        rows = np.full((NODES + PLACES, 6), -1)
        rows[:NODES, PLANAR] = np.arange(3 * NODES).reshape(-1, 3)
        rows[NODES:] = 3 * NODES + np.arange(6 * PLACES).reshape(-1, 6)
        poses, values, score = numbers(self.start), np.zeros(SCALES + OWN), np.empty(2)
        information = np.zeros((NODES - 1, 6, 6))
        information[:, PLANAR, PLANAR] = 1600.0
        information[LIFTED] = ROOM
        steps = np.array([[n, n + 1, 0, n == LIFTED] for n in range(NODES - 1)])
        first = np.zeros((1, 6, 6))
        first[:, PLANAR, PLANAR] = 1e6
        factor = Factor()
        is_found = MINIMUM(
            *(factor, poses, rows),
            *(values, np.full(len(values), 0.9)),
            UNKNOWNS - len(values) + np.arange(len(values)),
            *(np.zeros(1, dtype=int), numbers(self.expected), first),
            *(np.zeros(len(values)), np.full(len(values), BY_SCALE**-2)),
            *(steps, numbers(self.steps), information, self.by_scale, self.about),
            np.column_stack([self.ends, np.full((len(self.ends), 2), [SCALES, OWN])]),
            *(numbers(self.ties), self.tie_information, self.own, score),
        )
        return is_found, Pose(poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]), values, score, factor


def numbers(poses: Pose) -> Array:
    return np.hstack([poses.rotation.reshape(-1, 9), poses.translation.reshape(-1, 3)])


@pytest.mark.parametrize("seed", range(5))
def test_minimum_is_that_of_all_terms(seed: int) -> None:
    drawn = Drawn.of(seed)
    is_found, poses, values, score, factor = drawn.found()
    assert is_found
    best = least_squares(drawn.residuals, np.zeros(UNKNOWNS), xtol=1e-12, ftol=1e-12)
    expected, expected_values = drawn.moved(best.x)
    assert np.allclose(poses.difference(expected), 0.0, atol=2e-4)
    assert np.allclose(values, expected_values, atol=2e-3)
    assert score[0] == pytest.approx(2 * best.cost, abs=5e-3)
    across = by_differences(drawn, best.x)  # over the lift only the room is known
    information = best.jac.T @ best.jac + across.T @ ROOM @ across
    assert score[1] == pytest.approx(np.linalg.slogdet(information)[1], abs=0.05)
    rows = np.array([3, 4, 5, 14, UNKNOWNS - 1])
    covariance = np.linalg.inv(information)[np.ix_(rows, rows)]
    assert np.allclose(factor.covariance(rows), covariance, rtol=0.02, atol=1e-6)


def by_differences(drawn: Drawn, at: Array) -> Array:
    """The derivative (6, unknowns) of the motion over the lifted step."""

    def motion(by: Array) -> Pose:
        poses, _ = drawn.moved(by)
        return poses[LIFTED].inverse() @ poses[LIFTED + 1]

    here, step = motion(at), 1e-6
    each = [motion(at + step * unit).difference(here) / step for unit in np.eye(UNKNOWNS)]
    return np.array(each).T


def test_pose_of_which_nothing_is_said_is_not_determined() -> None:
    drawn = Drawn.of(0)
    keep = drawn.ends[:, 1] == 4  # nothing is left of the second camera
    drawn.ties, drawn.own = drawn.ties[keep], drawn.own[keep]
    drawn.tie_information, drawn.ends = drawn.tie_information[keep], drawn.ends[keep]
    assert not drawn.found()[0]


def test_terms_of_what_is_not_there_are_refused() -> None:
    drawn = Drawn.of(0)
    drawn.ends = drawn.ends + 3
    with pytest.raises(RuntimeError, match="a pose or value that is none"):
        drawn.found()
    with pytest.raises(RuntimeError, match="nothing is factorised"):
        Factor().covariance(np.zeros(0, dtype=int))


def test_agreement_of_modes_is_by_the_graphs_joint_covariance() -> None:
    """About where two modes together put the robots."""
    random, factor = np.random.default_rng(7), Drawn.of(1).found()[-1]

    def drawn(count: int, free: list[int], first: int) -> tuple[Array, ...]:
        rows = np.full(6, -1)
        rows[free] = first + np.arange(len(free))
        base, seen = Pose.from_vector(random.normal(size=(1, 6))), random.normal(size=(count, 6))
        square = 0.1 * random.normal(size=(count, 6, 6))
        spread = square @ np.swapaxes(square, 1, 2) + 0.01 * np.eye(6)
        return numbers(base), rows, numbers(Pose.from_vector(seen)), spread, seen[:, 0].copy()

    old, new = drawn(2, PLANAR, 3), drawn(3, [*PLANAR, 2], 12)
    beside, cost = 0.02 * np.eye(6), np.empty((2, 3))
    AGREEMENT(factor, *old, *new, beside, cost)
    unknowns = np.concatenate([side[1][side[1] >= 0] for side in (old, new)])
    shared = factor.covariance(unknowns)
    for k, m in np.ndindex(2, 3):
        expected, is_there, moved = 0.0, False, np.zeros(len(unknowns))
        while not is_there:
            poses, by, own = [], [], beside
            shifts = in_all_axes(moved, old, new)
            for side, mode, sign, shift in zip((old, new), (k, m), (-1, 1), shifts, strict=True):
                base = Pose.from_rows(side[0])[0].disturbed(shift)
                pose, turn = base @ Pose.from_rows(side[2])[mode], turned_axes(base.rotation)
                poses.append(pose)
                by.append(sign * lever(pose.translation - base.translation)[:, side[1] >= 0])
                own = own + turn @ side[3][mode] @ turn.T
            both = np.concatenate(by, axis=1)
            error = poses[1].difference(poses[0]) - both @ moved
            spread = both @ shared @ both.T + own
            weighted = np.linalg.solve(spread, error)
            expected = error @ weighted + np.linalg.slogdet(spread)[1]
            further = -shared @ both.T @ weighted - moved
            turns = in_all_axes(further, old, new)[:, 3:]
            is_there, moved = bool(np.all(np.linalg.norm(turns, axis=1) < 0.01)), moved + further
        assert cost[k, m] == pytest.approx(expected + old[4][k] + new[4][m], rel=1e-9)


def in_all_axes(by: Array, *sides: tuple[Array, ...]) -> Array:
    """Changes of the sides' free unknowns, one side after the other, as disturbances (2, 6)."""
    every = np.zeros((len(sides), 6))
    every[np.array([side[1] >= 0 for side in sides])] = by
    return every


NOWHERE = frozenset[tuple[str, int]]()
LIFT = frozenset({("r1", 1)})


@pytest.fixture
def graph() -> Graph:
    """Of c1, c2 and c1 again."""
    return graph_of(Shape(0, (0, 1, 0), is_alike=False))


def met_again(breaks: frozenset[tuple[str, int]] = NOWHERE) -> Variant:
    return Variant({0: Tie(0, 0), 2: Tie(0, 0)}, frozenset(), breaks)


def solved(graph: Graph, variant: Variant) -> Placed:
    found = Minima(graph).placed(variant)
    assert found is not None
    return found


def begun(graph: Graph, layout: Layout, variant: Variant) -> Array:
    """The poses with which a variant whose ties are all of c1 begins."""
    ties = sorted(variant.ties.items())
    ends = np.array([[graph.node_of[n], layout.at["c1", 0], -1, 0] for n, _ in ties])
    seen = np.concatenate([graph.modes[n].base_from_camera.rows()[[tie.mode]] for n, tie in ties])
    return initial_poses(graph, layout, variant, ties, ends, seen)


def started(graph: Graph, variant: Variant) -> tuple[Pose, Pose]:
    """Where the robot's nodes and the camera begin."""
    poses = begun(graph, graph.layout([("c1", 0)]), variant)
    return Pose.from_rows(poses[:-1]), Pose.from_rows(poses[-1])


def test_along_odometry_where_it_is_near_nothing(graph: Graph) -> None:
    nodes, camera = started(graph, met_again())
    odometry = graph.paths["r1"].odometry
    assert np.allclose(nodes.translation, odometry.translation)
    seen = graph.modes[0].base_from_camera[0]
    assert np.allclose(camera.difference(odometry[graph.node_of[0]] @ seen), 0.0)


def test_what_it_is_near_is_where_it_starts(graph: Graph) -> None:
    near = solved(graph, met_again())
    poses = begun(graph, near.layout, replace(met_again(), near=near))
    assert np.array_equal(poses, near.poses)


def test_after_a_lift_a_robot_is_where_its_next_tie_puts_it(graph: Graph) -> None:
    near = solved(graph, met_again())
    turned, last = Pose.from_rows(near.poses[:-1]), graph.node_of[2]
    off = near.poses.copy()
    off[last:-1] = (Pose.planar(3.0, -2.0, 2.0) @ turned[last:]).rows()
    before = replace(near, poses=off, breaks=LIFT, ties={0: Tie(0, 0)})
    nodes, _ = started(graph, replace(met_again(LIFT), near=before))
    assert np.allclose(nodes[last].difference(turned[last]), 0.0, atol=0.1)
    assert np.allclose(nodes[0].difference(turned[0]), 0.0)


def test_without_the_lift_of_what_it_is_near_odometry_holds_again(graph: Graph) -> None:
    near = solved(graph, met_again(LIFT))
    nodes, _ = started(graph, replace(met_again(), near=near))
    assert np.allclose(nodes.translation, graph.paths["r1"].odometry.translation)


@pytest.mark.parametrize("breaks", [NOWHERE, LIFT])
def test_start_does_not_say_what_the_minimum_is(
    graph: Graph, breaks: frozenset[tuple[str, int]]
) -> None:
    alone = solved(graph, met_again(breaks))
    by = np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.1])
    away = replace(alone, poses=Pose.from_rows(alone.poses).disturbed(by).rows())
    beside = solved(graph, replace(met_again(breaks), near=away))
    assert beside.score == pytest.approx(alone.score, abs=2e-3)


def test_modes_agree_wherever_a_lifted_robot_is_thought_to_stand(graph: Graph) -> None:
    """What a mode says was turned with the robot as it stood by odometry: of two modes of a camera
    after a lift the wrong one agreed better, and was the only one tried."""
    loose, last = solved(graph, replace(met_again(LIFT), ties={0: Tie(0, 0)})), graph.node_of[2]
    away = loose.poses.copy()
    away[last] = (loose.node("r1", last) @ Pose.planar(0.0, 0.0, 2.0)).rows()
    here, there = (
        agreement(graph, replace(loose, poses=poses), ("c1", 0), 2) for poses in (loose.poses, away)
    )
    assert there == pytest.approx(here, abs=2.0)
