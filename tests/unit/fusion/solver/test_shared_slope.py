"""A slope that hundreds of pictures share: solved from where the search may begin."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.small_problems import first_state, shaken, small_data

from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.solver.levenberg_marquardt import begun, solve


@pytest.fixture(scope="module")
def sloping() -> Assembled:
    """A robot on a floor whose slope its pictures share, four hundred in all: these are fifty."""
    data = small_data(noise_px=0.5, sightings=50)
    assembled = assemble(data, first_state(data), list(range(50)))
    jitter, batches = Jitter(sway=1e-6, tilt=0.005, length=1.0), []
    for batch in assembled.problem.batches:
        variances = jitter.in_pictures(np.zeros((400, 3)))[: len(batch.nodes)]
        batches.append(replace(batch, jitter=variances))
    return replace(assembled, problem=replace(assembled.problem, batches=tuple(batches)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_tilt_that_hundreds_of_pictures_share_leaves_steps_that_lead_on(
    sloping: Assembled, seed: int
) -> None:
    """From nodes and cameras 5 cm off. Four hundred times the variance is a deviation of six
    degrees in each picture, about whose fit no search ended where it should."""
    start = shaken(sloping, seed=seed, amount=5.0)
    found = solve(sloping.problem, start, tolerance=1e-4)
    assert found.has_converged
    least = solve(sloping.problem, sloping.start, tolerance=1e-4)
    assert found.cost == pytest.approx(least.cost, abs=0.02)  # of χ²


@pytest.mark.parametrize("seed", range(16))
def test_solution_that_begins_without_deviations_ends_at_the_minimum(
    sloping: Assembled, seed: int
) -> None:
    start = begun(sloping.problem, shaken(sloping, seed=seed, amount=5.0))
    found = solve(sloping.problem, start, tolerance=1e-4)
    assert found.has_converged
    least = solve(sloping.problem, sloping.start, tolerance=1e-4)
    assert found.cost == pytest.approx(least.cost, abs=0.02)  # of χ²
