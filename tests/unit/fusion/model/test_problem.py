"""The normal equations against finite differences of the cost and of its residuals."""

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.linalg import LinAlgError
from support.fusion.slow_problem import known_errors, rescaled, slow_equations
from support.fusion.small_problems import (
    first_state,
    shaken,
    small_data,
    small_problem,
    stepped,
    unknowns,
    whole_gradient,
    whole_matrix,
)

from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.prediction import batch_jacobian, odometry_terms
from trigpoint.fusion.model.problem import Problem, State
from trigpoint.fusion.solver.equations import EXACT
from trigpoint.fusion.solver.levenberg_marquardt import linearise, minimise
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array


@pytest.fixture(
    scope="module",
    params=[
        "map held by the first pose",
        "map held by known cameras",
        "map held by a known past",
        "a rolling shutter",
    ],
)
def assembled(request: pytest.FixtureRequest) -> Assembled:
    """Every kind of unknown with its prior, away from what the priors say."""
    line_delay_s = 3e-4 if "rolling" in request.param else 0.0
    return small_problem(
        known="known" in request.param,
        past="past" in request.param,
        noise_px=0.5,
        line_delay_s=line_delay_s,
        off=1.0,
    )


def kinds(problem: Problem) -> dict[str, list[tuple[str, int]]]:
    """The unknowns by kind."""
    layout, found = problem.layout, {}
    for kind in ("pose", "lens", "time_offset", "scales", "faces", "last"):
        columns = getattr(layout, kind).values()
        found[kind] = [("", i) for column in columns for i in column.tolist()]
    for name in problem.chains:
        found[f"nodes of {name}"] = [u for u in unknowns(problem) if u[0] == name]
    return found


def sigmas(problem: Problem, state: State) -> Array:
    """About what moves the cost by one, for each unknown."""
    diagonal = np.diagonal(whole_matrix(linearise(problem, state))).copy()
    diagonal[diagonal > EXACT / 2] -= EXACT
    return 1 / np.sqrt(diagonal)


def cost_of(problem: Problem, state: State, huber: float) -> float:
    """The cost at a state."""
    return minimise(problem, state, huber=huber, tolerance=0.0, most_iterations=0).cost


@pytest.mark.parametrize("huber", [np.inf, 3.0])
def test_gradient_is_the_slope_of_the_cost_by_every_unknown(
    assembled: Assembled, huber: float
) -> None:
    problem, state = assembled.problem, shaken(assembled)
    # The core keeps the equations of least squares alone; its robust steps are held to the others.
    gradient = (
        slow_equations(problem, state, huber=huber).gradient
        if np.isfinite(huber)
        else whole_gradient(linearise(problem, state))
    )
    order, sigma = unknowns(problem), sigmas(problem, state)
    for kind, members in kinds(problem).items():
        assert members, kind
        for unknown in members:
            at = order.index(unknown)
            step = 1e-3 * sigma[at]
            upper, lower = (
                cost_of(problem, stepped(problem, state, unknown, sign * step), huber)
                for sign in (1, -1)
            )
            slope = (upper - lower) / (4 * step)  # the gradient is half the cost's
            scale = abs(gradient[at]) + 1 / sigma[at]
            assert abs(slope - gradient[at]) < 1e-5 * scale, (kind, unknown)


def residuals(problem: Problem, state: State) -> Array:
    """Every residual over its sigma, in a row; the sum of their squares is the cost."""
    found = [batch_jacobian(problem, batch, state)[1] for batch in problem.batches]
    for name, chain in problem.chains.items():
        assert chain.motion is not None
        nodes, scales = state.robots[name].map_from_base, state.robots[name].scales
        motion = rescaled(chain.motion, scales - chain.scales)
        found.append(odometry_terms(nodes[:-1], nodes[1:], motion, chain.tangent).residual)
    priors = problem.priors
    for name, (expected, sigma) in priors.lens.items():
        found.append((state.cameras[name].lens.parameters - expected) / sigma)
    for name, sigma in priors.time_offset.items():
        camera = state.cameras[name]
        found.append(np.array([camera.time_offset_s, camera.time_drift]) / sigma)
    for name, sigma in priors.scales.items():
        found.append(state.robots[name].scales / sigma)
    for name, (expected, translation, rotation) in priors.faces.items():
        error = state.robots[name].base_from_face.difference(expected)
        found.append(error / np.repeat([translation, rotation], 3))
    if priors.known.poses:
        root = np.linalg.cholesky(priors.known.information)
        found.append(root.T @ known_errors(problem, state)[1])
    return np.concatenate([part.reshape(-1) for part in found])


def test_cost_is_the_sum_of_all_squared_residuals(assembled: Assembled) -> None:
    state = shaken(assembled)
    cost = linearise(assembled.problem, state).cost
    np.testing.assert_allclose(cost, np.sum(residuals(assembled.problem, state) ** 2), rtol=1e-12)


def test_matrix_is_that_of_the_residuals_slopes(assembled: Assembled) -> None:
    problem, state = assembled.problem, shaken(assembled)
    sigma = sigmas(problem, state)
    slopes = []
    for unknown, step in zip(unknowns(problem), 1e-2 * sigma, strict=True):
        upper, lower = (
            residuals(problem, stepped(problem, state, unknown, s * step)) for s in (1, -1)
        )
        slopes.append((upper - lower) / (2 * step))
    jacobian = np.stack(slopes, axis=1) * sigma
    matrix = whole_matrix(linearise(problem, state))
    for index, (name, node) in enumerate(unknowns(problem)):
        if name and problem.chains[name].is_anchored and node < len(problem.chains[name].tangent):
            matrix[index, index] -= EXACT
    whitened = matrix * sigma[:, None] * sigma
    # Faces' priors of a few milliradians: their Log's slope is taken as 1, half of that is left.
    np.testing.assert_allclose(whitened, jacobian.T @ jacobian, atol=5e-3)


def test_cost_far_off_counts_linearly_beyond_huber(assembled: Assembled) -> None:
    problem, state = assembled.problem, shaken(assembled)
    huber = 3.0
    expected = 0.0
    for batch in problem.batches:
        length = np.linalg.norm(batch_jacobian(problem, batch, state)[1], axis=-1)
        expected += np.sum(np.where(length > huber, huber * (2 * length - huber), length**2))
    without = sum(
        np.sum(batch_jacobian(problem, batch, state)[1] ** 2) for batch in problem.batches
    )
    rest = linearise(problem, state).cost - without
    cost = cost_of(problem, state, huber)
    np.testing.assert_allclose(cost, rest + expected, rtol=1e-12)
    assert cost < linearise(problem, state).cost


def test_outlier_and_padding_weigh_nothing(assembled: Assembled) -> None:
    batch = assembled.problem.batches[0]
    wild = batch.pixels.copy()
    weights = batch.weights.copy()
    wild[0, 0], weights[0, 0] = [1e4, -1e4], 0.0
    costs = []
    for pixels in (batch.pixels, wild):
        changed = replace(batch, pixels=pixels, weights=weights)
        problem = replace(assembled.problem, batches=(changed,))
        costs.append(linearise(problem, assembled.start).cost)
    assert costs[0] == costs[1]


def test_corner_behind_the_camera_costs_much_and_stays_finite(assembled: Assembled) -> None:
    eye = assembled.start.cameras["c1"]
    behind = eye.map_from_camera @ Pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    cameras = assembled.start.cameras | {"c1": replace(eye, map_from_camera=behind)}
    state = replace(assembled.start, cameras=cameras)
    equations = linearise(assembled.problem, state)
    assert np.all(np.isfinite(equations.reduced().information))
    assert linearise(assembled.problem, assembled.start).cost < equations.cost < np.inf


def test_robot_seen_once_has_no_inner_node() -> None:
    data = small_data()
    assembled = assemble(data, first_state(data), [1])
    equations = linearise(assembled.problem, assembled.start)
    assert len(assembled.problem.chains["r2"]) == 1
    with pytest.raises(LinAlgError):  # one sighting tells nothing of where in the map it was
        equations.system()
    # A first pose that is the only one is held in the dense part.
    held = replace(assembled.problem.chains["r2"], is_anchored=True)
    problem = replace(assembled.problem, chains={"r2": held})
    last = problem.layout.last["r2"]
    gained = linearise(problem, assembled.start).reduced().information
    gained -= equations.reduced().information
    assert np.all(np.diagonal(gained)[last] == pytest.approx(EXACT))
