"""What the noise of a session may be."""

import pytest
from msgspec.structs import replace
from support.oracle.sessions import Shape, data_of

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.learning import learnt_noise
from trigpoint.fusion.association.memory import Memory
from trigpoint.fusion.association.noise import PESSIMISTIC, Noise, on_a_floor
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation

EVENTS = Events()
PRIORS = EVENTS.priors
UNTOLD = on_a_floor(Noise(sway=PRIORS.target_sway), PRIORS.floor_tilt)
SHAPE = Shape(0, (0, 1, 0), is_alike=False)


def stated_smaller(times: float) -> tuple[DataSet, list[Observation]]:
    """A session whose corners are stated so many times too well."""
    data, observations = data_of(SHAPE)
    return data, [each.scattering(1 / times) for each in observations]


def test_short_session_of_noise_as_stated_has_that_and_what_a_decision_must_survive() -> None:
    data, observations = stated_smaller(1.0)
    scales, noises = learnt_noise(data, observations, EVENTS, Memory())
    assert set(scales.values()) == {1.0}
    assert [each.by_robot["r1"] for each in noises] == [UNTOLD, PESSIMISTIC]
    assert [each.score for each in noises] == [0.0, EVENTS.noise_score]


def test_where_corners_scatter_more_odometry_may_do_so_alone() -> None:
    data, observations = stated_smaller(3.0)
    scales, noises = learnt_noise(data, observations, EVENTS, Memory())
    assert min(scales.values()) > 1.5
    stated, noisier, pessimistic = (each.by_robot["r1"] for each in noises)
    assert stated == UNTOLD
    assert noisier == replace(UNTOLD, odometry=noisier.odometry)
    assert noisier.odometry == pytest.approx(3.0, rel=0.3)
    assert pessimistic == replace(PESSIMISTIC, odometry=noisier.odometry)
    assert {each.score for each in noises} == {0.0}
