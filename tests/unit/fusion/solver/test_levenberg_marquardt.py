"""Elimination against the dense matrix, steps to the least cost, and when rebuilding ends."""

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.linalg import LinAlgError
from support.fusion.slow_problem import node_rows, slow_equations, slow_minimum
from support.fusion.small_problems import (
    first_state,
    shaken,
    small_data,
    small_problem,
    unknowns,
)

from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.problem import Problem, State
from trigpoint.fusion.solver.equations import EXACT, covariance_of
from trigpoint.fusion.solver.levenberg_marquardt import (
    Solution,
    linearise,
    minimise,
    solve,
)
from trigpoint.geometry.rotation import Array


@pytest.fixture(scope="module", params=["first pose", "known cameras", "a known past"])
def assembled(request: pytest.FixtureRequest) -> Assembled:
    """Every kind of unknown with its prior, without noise; the map held by this."""
    return small_problem(known="known" in request.param, past="past" in request.param)


def split(problem: Problem, state: State) -> tuple[Array, Array, Array, Array]:
    """The parts A, B, C of the matrix written out, and the gradient."""
    slow, inner = slow_equations(problem, state), len(unknowns(problem)) - problem.layout.size
    matrix = slow.matrix
    return matrix[:inner, :inner], matrix[:inner, inner:], matrix[inner:, inner:], slow.gradient


def test_reduced_information_is_the_schur_complement(assembled: Assembled) -> None:
    state = shaken(assembled)
    a, b, c, gradient = split(assembled.problem, state)
    reduced = linearise(assembled.problem, state).reduced()
    solved = np.linalg.solve(a, np.column_stack([gradient[: len(a)], b]))
    expected = c - b.T @ solved[:, 1:]
    scale = 1 / np.sqrt(np.diagonal(expected))
    # Numbers of sixteen digits over a matrix whose condition is the EXACT first pose's, 1e13,
    # over what a sighting tells, 1e5 and more: eight digits are left.
    np.testing.assert_allclose(
        reduced.information * scale[:, None] * scale, expected * scale[:, None] * scale, atol=1e-7
    )
    slope = gradient[len(a) :] - b.T @ solved[:, 0]
    np.testing.assert_allclose(reduced.gradient * scale, slope * scale, rtol=1e-7, atol=1e-6)


def test_covariance_is_the_block_of_the_dense_inverse(assembled: Assembled) -> None:
    a, b, c, _ = split(assembled.problem, assembled.start)
    matrix = np.block([[a, b], [b.T, c]])
    scale = 1 / np.sqrt(np.diagonal(matrix))
    inverse = np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale
    expected = inverse[len(a) :, len(a) :]
    found = linearise(assembled.problem, assembled.start).reduced().covariance()
    sigma = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        found / sigma[:, None] / sigma, expected / sigma[:, None] / sigma, atol=1e-6
    )


def test_covariance_of_a_badly_scaled_matrix_is_its_inverse() -> None:
    scale = np.array([1e-7, 1.0, 1e6])
    information = scale[:, None] * np.array([[2.0, 0.5, 0], [0.5, 1, 0.1], [0, 0.1, 1]]) * scale
    identity = (covariance_of(information) / scale[:, None] ** -1 / scale**-1) @ (
        information / scale[:, None] / scale
    )
    np.testing.assert_allclose(identity, np.eye(3), atol=1e-12)


def test_covariance_of_what_nothing_determines_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        covariance_of(np.zeros((2, 2)))


def solved_anew(assembled_of, state: State) -> tuple[State, list[Solution]]:
    """Solve, and make the problem anew for the scales and offsets found, a few times."""
    solutions = []
    for _ in range(6):
        assembled = assembled_of(state)
        solutions.append(solve(assembled.problem, assembled.start, tolerance=1e-12))
        state = solutions[-1].state
    return state, solutions


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_data_without_noise_lead_back_to_the_truth(known: bool, seed: int) -> None:
    data = small_data(known=known)
    entries = list(range(len(data.entries)))
    begun = assemble(data, first_state(data, off=1.0), entries)
    start = shaken(begun, seed=seed, amount=2.0)
    for index, node in begun.node_of.items():
        entry = data.entries[index]
        entry.map_from_base = start.robots[entry.observation.robot].map_from_base[node]
    state, solutions = solved_anew(lambda s: assemble(data, s, entries), start)
    truth = first_state(data)
    assert all(solution.has_converged for solution in solutions)
    assert solutions[-1].cost < 1e-6  # of χ²: a thousandth of a sigma in all
    for name, camera in truth.cameras.items():
        error = state.cameras[name].map_from_camera.difference(camera.map_from_camera)
        np.testing.assert_allclose(error, 0.0, atol=1e-5)
        assert state.cameras[name].time_offset_s == pytest.approx(0.0, abs=1e-5)
    for name in data.site.robots:
        np.testing.assert_allclose(state.robots[name].scales, 0.0, atol=1e-5)


def test_no_step_raises_the_cost(assembled: Assembled) -> None:
    start = shaken(assembled, amount=10.0)
    costs = [solve(assembled.problem, start, most_iterations=n).cost for n in range(8)]
    assert len(set(costs)) > 3
    assert all(after <= before for before, after in pairwise(costs))
    solution = solve(assembled.problem, start)
    assert solution.cost == linearise(assembled.problem, solution.state).cost


def test_solution_ends_in_time_and_says_whether_it_came_to_rest(assembled: Assembled) -> None:
    start = shaken(assembled)
    hurried = solve(assembled.problem, start, most_iterations=1)
    assert (hurried.iterations, hurried.has_converged) == (1, False)
    patient = solve(assembled.problem, start)
    assert patient.has_converged
    assert patient.iterations < 50
    assert patient.cost < hurried.cost < linearise(assembled.problem, start).cost


def test_start_at_the_least_cost_ends_at_once(assembled: Assembled) -> None:
    solution = solve(assembled.problem, assembled.start)
    assert (solution.iterations, solution.has_converged) == (1, True)


def test_robust_cost_leads_past_wild_corners() -> None:
    data = small_data()
    assembled = assemble(data, first_state(data), list(range(len(data.entries))))
    batch = assembled.problem.batches[0]
    pixels = batch.pixels.copy()
    pixels[0, 0] += 100.0
    problem = replace(
        assembled.problem,
        batches=(replace(batch, pixels=pixels), *assembled.problem.batches[1:]),
    )
    truth = assembled.start.cameras["c1"].map_from_camera
    errors = [
        np.abs(
            solve(problem, assembled.start, huber=huber)
            .state.cameras["c1"]
            .map_from_camera.difference(truth)
        ).max()
        for huber in (np.inf, 4.0)
    ]
    assert errors[1] < 0.1 * errors[0]


def unheld(assembled: Assembled) -> Problem:
    """The problem without a fixed map: three directions of it are free."""
    chains = {n: replace(c, is_anchored=False) for n, c in assembled.problem.chains.items()}
    return replace(assembled.problem, chains=chains)


def test_problem_that_leaves_the_map_free_ends_without_an_error() -> None:
    assembled = small_problem()
    problem, start = unheld(assembled), shaken(assembled)
    solution = solve(problem, start, tolerance=1e-9)
    assert np.all(np.isfinite(solution.reduced.information))
    assert solution.cost < 1e-6 < linearise(problem, start).cost  # anywhere, it fits


def test_camera_that_nothing_is_known_of_ends_without_an_error() -> None:
    assembled = small_problem()
    problem = replace(assembled.problem, batches=assembled.problem.batches[:1])
    solution = solve(problem, assembled.start)
    assert not solution.has_converged
    with pytest.raises(np.linalg.LinAlgError):
        solution.reduced.covariance()


SITUATIONS = {
    "one node each": {"entries": [0, 1]},
    "one node, and two": {"entries": [0, 1, 3]},
    "two robots seen by one camera": {"entries": [0, 1, 4, 5, 8, 9]},
    "all": {"entries": list(range(12))},
    "many nodes": {"entries": list(range(50)), "sightings": 50},
    "known cameras": {"entries": list(range(12)), "known": True},
    "a known past": {"entries": list(range(12)), "known": True, "past": True},
    "a rolling shutter": {"entries": list(range(12)), "line_delay_s": 3e-4},
}


def jittered(problem: Problem) -> Problem:
    """The problem with robots that sway in each picture, on a floor whose slope all share."""
    jitter = Jitter(sway=0.003, tilt=0.02, length=1.0)
    batches = [
        replace(batch, jitter=jitter.in_pictures(np.zeros((len(batch.nodes), 3))))
        for batch in problem.batches
    ]
    return replace(problem, batches=tuple(batches))


def unlinked(problem: Problem) -> Problem:
    """The problem without odometry: each node is where its pictures say."""
    return replace(problem, chains={n: replace(c, motion=None) for n, c in problem.chains.items()})


def holding(problem: Problem) -> Problem:
    """The problem with clocks and scales that are known exactly."""
    priors = problem.priors
    clocks = dict.fromkeys(priors.time_offset, np.zeros(2))
    scales = dict.fromkeys(priors.scales, np.zeros(2))
    return replace(problem, priors=replace(priors, time_offset=clocks, scales=scales))


def in_a_row(state: State) -> Array:
    """All numbers of a state."""
    cameras = [
        [*c.map_from_camera.rows()[0], *c.lens.parameters, c.time_offset_s, c.time_drift]
        for c in state.cameras.values()
    ]
    robots = [
        [*r.map_from_base.rows().reshape(-1), *r.scales, *r.base_from_face.rows().reshape(-1)]
        for r in state.robots.values()
    ]
    return np.concatenate([*cameras, *robots])


@cache
def noisy(situation: str) -> Assembled:
    """Its problem, with corners half a pixel off; made once for all that is asked of it."""
    given = dict(SITUATIONS[situation])
    entries = given.pop("entries")
    data = small_data(noise_px=0.5, **given)
    return assemble(data, first_state(data), entries)


@pytest.mark.parametrize(
    ("situation", "changed"),
    [
        *((situation, replace) for situation in SITUATIONS),
        *((situation, jittered) for situation in SITUATIONS),
        *(("known cameras", changed) for changed in (unlinked, holding)),
    ],
)
@pytest.mark.parametrize("huber", [np.inf, 3.0])
def test_iteration_is_the_one_written_out(
    situation: str, changed: Callable[[Problem], Problem], huber: float
) -> None:
    assembled = noisy(situation)
    problem, start = changed(assembled.problem), shaken(assembled)
    for most in (0, 1, 12):
        settings = {"huber": huber, "tolerance": 1e-3, "most_iterations": most}
        found = minimise(problem, start, **settings)
        state, slow, iterations, has_converged = slow_minimum(problem, start, **settings)
        assert (found.iterations, found.has_converged) == (iterations, has_converged)
        assert found.cost == pytest.approx(slow.cost, rel=1e-8)
        np.testing.assert_allclose(in_a_row(found.state), in_a_row(state), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("situation", SITUATIONS)
def test_system_is_the_matrix_written_out(situation: str) -> None:
    given = dict(SITUATIONS[situation])
    entries = given.pop("entries")
    data = small_data(noise_px=0.5, known=True, **{k: v for k, v in given.items() if k != "known"})
    assembled = assemble(data, first_state(data), entries)
    problem, state = jittered(assembled.problem), shaken(assembled)
    system, slow = linearise(problem, state).system(), slow_equations(problem, state)
    sigma = np.sqrt(np.diagonal(system.covariance))
    whitened = slow.matrix * sigma[:, None] * sigma
    unit = system.covariance / sigma[:, None] / sigma @ whitened
    np.testing.assert_allclose(unit, np.eye(len(unit)), atol=1e-6)
    expected = -np.linalg.solve(whitened, sigma * slow.gradient)
    np.testing.assert_allclose(system.step / sigma, expected, rtol=1e-6, atol=1e-6)
    determinant = np.linalg.slogdet(whitened)[1] - 2 * np.sum(np.log(sigma))
    held = sum(len(c.tangent) for c in problem.chains.values() if c.is_anchored)
    determinant += slow.log_determinant - held * np.log(EXACT)
    assert system.log_determinant == pytest.approx(determinant, abs=1e-5)
    for name in problem.chains:
        np.testing.assert_array_equal(system.node_rows(name, 0), node_rows(problem, name, 0))


def test_same_problem_gives_the_same_bits(assembled: Assembled) -> None:
    start = shaken(assembled)
    first, second = (solve(jittered(assembled.problem), start, huber=3.0) for _ in range(2))
    np.testing.assert_array_equal(in_a_row(first.state), in_a_row(second.state))
    np.testing.assert_array_equal(first.reduced.information, second.reduced.information)


def test_equations_of_a_robust_minimum_are_those_of_least_squares() -> None:
    noisy = small_problem(noise_px=0.5)
    found = minimise(noisy.problem, shaken(noisy), huber=2.0, tolerance=1e-6, most_iterations=3)
    plain = linearise(noisy.problem, found.state)
    assert found.cost < found.equations.cost == plain.cost
    np.testing.assert_array_equal(
        found.equations.reduced().information, plain.reduced().information
    )


def test_what_is_not_finite_is_no_minimum(assembled: Assembled) -> None:
    batch = assembled.problem.batches[0]
    pixels = batch.pixels.copy()
    pixels[0, 0] = np.nan
    problem = replace(assembled.problem, batches=(replace(batch, pixels=pixels),))
    found = minimise(problem, assembled.start, huber=np.inf, tolerance=1e-6, most_iterations=50)
    assert not np.isfinite(found.cost)
    assert not found.has_converged
    np.testing.assert_array_equal(in_a_row(found.state), in_a_row(assembled.start))
    for ask in (found.equations.reduced, found.equations.system):
        with pytest.raises(np.linalg.LinAlgError):
            ask()


def test_motion_of_no_covariance_is_refused(assembled: Assembled) -> None:
    chain = assembled.problem.chains["r1"]
    assert chain.motion is not None
    motion = replace(chain.motion, covariance=0 * chain.motion.covariance)
    chains = assembled.problem.chains | {"r1": replace(chain, motion=motion)}
    with pytest.raises(np.linalg.LinAlgError):
        linearise(replace(assembled.problem, chains=chains), assembled.start)


def test_picture_of_a_node_that_is_none_is_refused(assembled: Assembled) -> None:
    batch = assembled.problem.batches[0]
    beyond = replace(batch, nodes=batch.nodes + len(assembled.problem.chains[batch.robot]))
    with pytest.raises(RuntimeError, match="do not fit together"):
        linearise(replace(assembled.problem, batches=(beyond,)), assembled.start)


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("spoilt", [-1.0, 0.0, np.nan, np.inf])
@pytest.mark.parametrize("cell", [(2, 2), (3, 2)])
def test_information_that_determines_nothing_has_no_covariance(
    spoilt: float, cell: tuple[int, int]
) -> None:
    information = np.full((4, 4), 1.0) + np.eye(4)
    assert covariance_of(information) @ information == pytest.approx(np.eye(4), abs=1e-12)
    information[cell] = information[cell[::-1]] = spoilt
    if cell == (3, 2) and np.isfinite(spoilt):
        information[2, 2] = information[3, 3] = 0.5 * abs(spoilt)
    with pytest.raises(LinAlgError):
        covariance_of(information)
