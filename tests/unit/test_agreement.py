"""Agreement with the oracle is a place, not a word."""

import numpy as np
import pytest
from support.oracle.agreement import disagreements
from support.oracle.verdict import Place, Verdict

from trigpoint.geometry import Pose
from trigpoint.map.network import CameraRecord, PoseRecord

_COVARIANCE = 1e-4 * np.eye(6)


def _place(x: float, mass: float) -> Place:
    return Place(Pose(np.eye(3), np.array([x, 0.0, 1.0])), _COVARIANCE, mass)


def _located(x: float) -> CameraRecord:
    pose = PoseRecord.of(_place(x, 1.0).map_from_camera)
    covariance = tuple(_COVARIANCE.ravel().tolist())
    return CameraRecord("located", map_from_camera=pose, covariance=covariance)


@pytest.mark.parametrize(
    ("places", "said", "count"),
    [
        ([_place(1, 1.0)], _located(1.02), 0),
        ([_place(1, 1.0)], _located(2.0), 1),
        ([_place(1, 1.0)], CameraRecord("undetermined"), 1),
        ([_place(1, 0.7), _place(3, 0.3)], CameraRecord("undetermined"), 0),
        ([_place(1, 0.7), _place(3, 0.3)], _located(1.0), 1),
        # Too near to the limit to say which of two approximations is right.
        ([_place(1, 0.99999), _place(3, 1e-5)], _located(1.0), 0),
        ([_place(1, 0.99999), _place(3, 1e-5)], CameraRecord("undetermined"), 0),
        ([_place(1, 0.99999), _place(3, 1e-5)], _located(3.0), 1),
    ],
)
def test_a_camera_agrees_where_it_is_located_as_the_oracle_says(
    places: list[Place], said: CameraRecord, count: int
) -> None:
    verdict = Verdict("c1", tuple(places), 0.0, 0.0)
    assert len(disagreements({"c1": verdict}, {"c1": said})) == count
