"""What a sighting is taken for: its corners, and how far they are believed."""

import numpy as np
import pytest
from support.builders import make_target

from trigpoint.contract.messages import FaceSighting
from trigpoint.fusion.model.observations import (
    LEAST_SIGMA_PX,
    Observation,
    Verdict,
    points_of,
    view_of,
)
from trigpoint.fusion.model.observations import observation_of as observed
from trigpoint.site.config import CameraConfig

TARGET = make_target()


def observation_of(sigma: float) -> Observation:
    """A face's corners, seen to `sigma` pixels."""
    pixels = np.arange(8, dtype=np.float32).reshape(4, 2)
    corners = np.arange(4, dtype=np.uint16)
    sighting = FaceSighting(TARGET.name, TARGET.faces[1].id, corners, pixels, sigma)
    view = view_of(TARGET, sighting, CameraConfig("sim://c1"))
    assert view is not None
    return observed("c1", "r1", 0, (view,)).judged(Verdict.ACCEPTED)


@pytest.mark.parametrize("sigma", [0.003, 0.0199])
def test_sharp_corners_are_believed_as_far_as_lens_and_print_are(sigma: float) -> None:
    weights = points_of(observation_of(sigma), TARGET).weights
    assert np.array_equal(weights, np.full(4, 1 / LEAST_SIGMA_PX))


def test_a_sigma_of_the_least_stays_what_a_sighting_has() -> None:
    """Sightings hold float32: 0.02 is a little less there."""
    assert float(np.float32(0.02)) == LEAST_SIGMA_PX


def test_blurred_corners_weigh_by_their_own_sigma() -> None:
    assert np.array_equal(points_of(observation_of(0.15), TARGET).weights, np.full(4, 1 / 0.15))
