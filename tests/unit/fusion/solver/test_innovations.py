"""How far a sighting is from where everything else predicts it, by the inverse of the whole."""

from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.picture_jitter import base_jacobian
from support.fusion.small_problems import first_state, small_data

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.prediction import batch_jacobian
from trigpoint.fusion.model.problem import Batch, Problem, State, layout_of
from trigpoint.fusion.solver.equations import System
from trigpoint.fusion.solver.innovations import innovations
from trigpoint.fusion.solver.levenberg_marquardt import Minimum, minimise
from trigpoint.geometry.rotation import Array

ROOM = Events().room_variances


def shown(jitter: Jitter | None, *, known: bool) -> tuple[Minimum, np.ndarray]:
    """Forty pictures of two robots, and their sightings (s, 3); three are displaced by 3 px."""
    data = small_data(noise_px=0.2, sightings=40, known=known)
    assembled = assemble(data, first_state(data, off=0.0), list(range(len(data.entries))))
    batches, sightings, first = [], [], 0
    for batch in assembled.problem.batches:
        n, pixels = len(batch.nodes), batch.pixels.copy()
        pixels[2, data.entries[int(batch.sources[2])].observation.parts[0]] += 3.0
        shaken = jitter.in_pictures(np.zeros((n, 3))) if jitter else None
        batches.append(replace(batch, pixels=pixels, jitter=shaken))
        for row, source in enumerate(batch.sources.tolist()):
            parts = data.entries[source].observation.parts
            sightings += [(first + row, part.start, part.stop - part.start) for part in parts]
        first += n
    problem = replace(assembled.problem, batches=tuple(batches))
    found = minimise(problem, assembled.start, huber=np.inf, tolerance=1e-10, most_iterations=50)
    return found, np.array(sightings)


def expected(found: Minimum, system: System, batch: Batch, row: int, corners: slice) -> Array:
    """The χ² and ln |S| at the minimum of a pose of its own for corners, by the inverse of the
    whole."""
    problem = system.problem
    jacobian, residual, columns = batch_jacobian(problem, batch, found.state)
    nodes = system.node_rows(batch.robot, int(batch.nodes[row]))
    rows = np.concatenate([nodes, system.dense_row + columns])
    by, left = jacobian[row].reshape(-1, jacobian.shape[-1]), residual[row].reshape(-1)
    left = left + by @ system.step[rows]
    by_base = base_jacobian(batch, found.state)[row]
    own = np.zeros_like(by_base)
    own[corners] = by_base[corners]
    by_base, own, noise = by_base.reshape(-1, 6), own.reshape(-1, 6), np.eye(len(left))
    if batch.jitter is not None:
        noise += by_base @ (batch.jitter[row, 0][:, None] * by_base.T)
    weight = np.linalg.inv(noise)
    across = own.T @ weight @ by
    covariance = system.covariance[np.ix_(rows, rows)]
    information = own.T @ weight @ own - across @ covariance @ across.T
    pull = own.T @ weight @ left
    spread = -np.linalg.slogdet(information)[1]
    return np.array([pull @ np.linalg.solve(information, pull), spread])


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("jitter", [None, Jitter(sway=0.002, tilt=0.01)])
def test_innovations_are_those_of_the_whole_system(jitter: Jitter | None, known: bool) -> None:
    found, asked = shown(jitter, known=known)
    problem, system = found.equations.problem, found.equations.system()
    assert min(len(chain) for chain in problem.chains.values()) > 16
    chi2, spread = innovations(found.equations, found.state, asked, room_variances=1e6 * ROOM)
    first = 0
    for batch in problem.batches:
        for at in np.flatnonzero((asked[:, 0] >= first) & (asked[:, 0] < first + len(batch.nodes))):
            picture, begin, count = asked[at].tolist()
            corners = slice(begin, begin + count)
            own = expected(found, system, batch, picture - first, corners)
            np.testing.assert_allclose([chi2[at], spread[at]], own, rtol=1e-3, atol=1e-3)
        first += len(batch.nodes)


def test_what_is_left_of_the_way_to_the_minimum_contradicts_nothing() -> None:
    """All is right; a camera that two sightings place is still off by many of their sigmas."""
    data = small_data(noise_px=0.2, sightings=15)
    assembled = assemble(data, first_state(data, off=0.02), list(range(len(data.entries))))
    whole = minimise(
        assembled.problem, assembled.start, huber=np.inf, tolerance=1e-9, most_iterations=50
    )
    short = minimise(
        assembled.problem, assembled.start, huber=np.inf, tolerance=0.0, most_iterations=1
    )
    asked = np.array(
        [(row, 0, 4) for row in range(sum(len(b.nodes) for b in assembled.problem.batches))]
    )
    there, here = (
        innovations(found.equations, found.state, asked, room_variances=ROOM)
        for found in (whole, short)
    )
    assert short.cost > whole.cost + 1.0
    np.testing.assert_allclose(here[0], there[0], rtol=0.2, atol=2.0)


def minimised(change: Callable[[Problem, State], Problem]) -> tuple[State, State]:
    """The first and the last state of a problem with other columns."""
    data = small_data(noise_px=0.2, sightings=15)
    assembled = assemble(data, first_state(data, off=0.02), list(range(len(data.entries))))
    problem, start = change(assembled.problem, assembled.start), assembled.start
    found = minimise(problem, start, huber=np.inf, tolerance=1e-6, most_iterations=20)
    return start, found.state


def test_problem_with_a_column_of_two_unknowns_or_of_none_is_refused() -> None:
    """What a picture depends on would be fewer than its terms have derivatives by."""

    def with_none(problem: Problem, _: State) -> Problem:
        return replace(problem, layout=replace(problem.layout, size=problem.layout.size + 1))

    def with_two(problem: Problem, _: State) -> Problem:
        layout = problem.layout
        columns, last = next(iter(layout.pose.values())), next(iter(layout.last.values()))
        last = dict.fromkeys(layout.last, columns[: len(last)])
        return replace(problem, layout=replace(layout, last=last))

    for change in (with_none, with_two):
        with pytest.raises(RuntimeError, match="do not fit together"):
            minimised(change)


def test_cameras_may_share_a_lens() -> None:
    def with_one(problem: Problem, state: State) -> Problem:
        one, other = cameras = list(problem.layout.pose)
        lens, clock = problem.priors.lens, problem.priors.time_offset
        priors = replace(
            problem.priors,
            lens={one: lens[one]},
            time_offset={one: clock[one]},
            owners={other: one},
        )
        layout = layout_of(cameras, problem.chains, priors, state)
        return replace(problem, priors=priors, layout=layout)

    start, found = minimised(with_one)
    one, other = (
        np.subtract(found.cameras[name].lens.parameters, camera.lens.parameters)
        for name, camera in start.cameras.items()
    )
    np.testing.assert_allclose(one, other, atol=1e-6)
    assert np.abs(one).max() > 1e-3
