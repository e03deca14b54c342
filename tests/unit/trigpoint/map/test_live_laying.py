"""The map is laid while poses still come."""

import math

import numpy as np
import pytest

from trigpoint.base.errors import InputError
from trigpoint.geometry import Pose
from trigpoint.map.building import Building
from trigpoint.map.live_laying import LiveLaying
from trigpoint.site.config import MapConfig
from trigpoint.site.config.map import PointConfig

S = 1_000_000_000
COVARIANCE = 1e-6 * np.eye(3)
FRAME_FROM_MAP = Pose.planar(5.0, -2.0, 0.7)
PLACES = {"c1": [0.0, 0.0, 2.0], "c2": [4.0, 0.0, 2.0], "mark": [4.0, 3.0, 0.0]}


def surveyed() -> MapConfig:
    points = {
        name: PointConfig(
            position=tuple((FRAME_FROM_MAP @ np.array(place)).tolist()),
            robot="r1" if name == "mark" else None,
            at=10.0,
        )
        for name, place in PLACES.items()
    }
    return MapConfig(points=points)


def test_an_origin_is_there_at_once() -> None:
    laid = LiveLaying(MapConfig(origin=(1.0, 2.0, 0.5)), None).given()
    assert laid is not None
    assert laid.frame_from_map.translation.tolist() == [1.0, 2.0, 0.0]
    assert LiveLaying(surveyed(), None).given() is None
    assert LiveLaying(None, None).given() is None


def test_cameras_and_a_robot_on_its_mark_lay_it() -> None:
    laying = LiveLaying(surveyed(), None)
    laying.take_camera("c1", np.array(PLACES["c1"]), COVARIANCE)
    laying.take_camera("c9", np.zeros(3), COVARIANCE)  # not surveyed
    laying.take_robot("r1", 100 * S, np.array([9.0, 9.0, 0.0]), COVARIANCE)  # not there yet
    assert isinstance(laying.laid(100 * S), InputError)  # one point says nothing of the heading
    laying.take_camera("c2", np.array(PLACES["c2"]), COVARIANCE)
    laying.take_robot("r1", 111 * S, np.array(PLACES["mark"]), COVARIANCE)
    laid = laying.laid(111 * S)
    assert isinstance(laid, Building)
    assert laid.frame_from_map.translation == pytest.approx([5.0, -2.0, 0.0], abs=1e-3)
    rotation = laid.frame_from_map.rotation
    assert math.atan2(rotation[1, 0], rotation[0, 0]) == pytest.approx(0.7, abs=1e-3)
    assert laid.missing == ()


def test_it_is_laid_anew_every_five_seconds_at_most() -> None:
    laying = LiveLaying(surveyed(), None)
    for name in ("c1", "c2"):
        laying.take_camera(name, np.array(PLACES[name]), COVARIANCE)
    assert isinstance(laying.laid(100 * S), Building)
    assert laying.laid(106 * S) is None  # nothing new
    laying.take_camera("c1", np.array(PLACES["c1"]), COVARIANCE)
    assert laying.laid(104 * S) is None
    assert isinstance(laying.laid(104 * S, at_once=True), Building)
