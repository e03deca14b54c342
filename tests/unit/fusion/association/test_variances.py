"""The misfit of a visit, its derivatives by the noise, and what broke on the way."""

import numpy as np
import pytest
from msgspec.structs import astuple, replace
from support.fusion.linear_visits import drawn_visit, slow_misfit

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.linear import Linear
from trigpoint.fusion.association.noise import STATED, Noise
from trigpoint.fusion.association.variances import interrupted, misfit

NOISES = {
    "no jitter": STATED,
    "noisy odometry": Noise(odometry=2.0, slip=0.5),
    "free odometry": Noise(odometry=1e3, slip=1e3),
    "mast": Noise(tilt=2e-3, sway=1e-3),
    "floor": Noise(tilt=2e-3, sway=1e-3, length=0.7, odometry=1.5),
}
VISITS = {
    "plane": drawn_visit(1, 3),
    "space": drawn_visit(2, 6),
    "two parts": drawn_visit(3, 3, parts=2, steps=1, others=6),
    "one stop": replace(drawn_visit(4, 3), places=np.zeros((7, 3))),
    "many others": drawn_visit(5, 6, parts=12, steps=7, others=20),
}


@pytest.mark.parametrize("visit", VISITS.values(), ids=VISITS)
@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
def test_misfit_is_that_of_the_whole_covariance(visit: Linear, noise: Noise) -> None:
    # The two differ by a constant: what the floor's slopes add is in one covariance or beside it.
    found, known = (misfit(visit, each).value for each in (noise, STATED))
    expected, reference = (slow_misfit(visit, each)[0] for each in (noise, STATED))
    assert found - known == pytest.approx(expected - reference, abs=1e-5)
    assert known == pytest.approx(reference, abs=1e-6)


@pytest.mark.parametrize("visit", VISITS.values(), ids=VISITS)
@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
def test_derivatives_are_those_of_finite_differences(visit: Linear, noise: Noise) -> None:
    names, found = ("tilt", "sway", "length", "odometry", "slip"), misfit(visit, noise).by_noise
    for order, (name, value) in enumerate(zip(names, astuple(noise), strict=True)):
        more, less = (
            misfit(visit, replace(noise, **{name: value * np.exp(by)})).value
            for by in (1e-4, -1e-4)
        )
        assert found[order] == pytest.approx((more - less) / 2e-4, abs=1e-4, rel=1e-5)


@pytest.mark.parametrize("visit", VISITS.values(), ids=VISITS)
def test_without_a_step_chi2_is_lower_by_what_it_says(visit: Linear) -> None:
    noise = NOISES["floor"]
    whole = slow_misfit(visit, noise)[1]
    for step, saved in enumerate(misfit(visit, noise).by_step):
        broken = visit.broken.copy()
        broken[step] += 1e3 * np.eye(broken.shape[-1])
        without = slow_misfit(replace(visit, broken=broken), noise)[1]
        assert saved == pytest.approx(whole - without, abs=1e-4)


@pytest.mark.parametrize("d", [3, 6])
def test_only_the_steps_that_jump_are_broken(d: int) -> None:
    visit = drawn_visit(7, d, parts=10, steps=6)
    assert interrupted(visit, STATED, Events())[1] == 0
    visit = replace(visit, nodes=np.array([0, 0, 1, 2, 2, 3, 4, 5, 5, 6]))
    steps = visit.steps.copy()
    steps[3] += 0.5
    broken, count = interrupted(replace(visit, steps=steps), STATED, Events())
    assert count == 1
    assert [step for step in range(6) if np.any(broken.broken[step])] == [3]


def test_visit_that_determines_nothing_is_infinitely_improbable() -> None:
    visit = drawn_visit(1, 3)
    unseen = replace(visit, by_others=visit.by_others * (np.arange(9) != 4))
    assert misfit(unseen, STATED).value == np.inf
    spoilt = replace(visit, shifts=visit.shifts * np.nan)
    assert misfit(spoilt, STATED).value == np.inf
    assert interrupted(spoilt, STATED, Events()) == (spoilt, 0)


def test_part_at_no_node_is_refused() -> None:
    visit = drawn_visit(1, 3)
    with pytest.raises(RuntimeError, match="nodes"):
        misfit(replace(visit, nodes=visit.nodes + 1), STATED)
