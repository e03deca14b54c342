"""From when on sightings are kept, so that memory is bounded and no robot is lost."""

import pytest
from msgspec.structs import replace
from support.fusion.drives import EPOCH_NS
from support.fusion.small_problems import small_data

from trigpoint.base.clock import to_ns
from trigpoint.fusion.estimators.smoother.settled_past import Limits
from trigpoint.fusion.estimators.smoother.smoother import Smoother
from trigpoint.fusion.model.dataset import DataSet, Entry, Move
from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.fusion.model.past import Past
from trigpoint.geometry import Pose

_SECONDS = 400


def data_of(seen_s: dict[str, range]) -> DataSet:
    """Two robots that drive, with a message a second, each seen at these seconds."""
    data = small_data(sightings=1)
    (entry,) = data.entries
    data.entries.clear()
    for robot, track in data.tracks.items():
        end = int((track.last_ns - EPOCH_NS) // to_ns(1.0)) + 1
        for second in range(end, _SECONDS):
            track.add(EPOCH_NS + to_ns(second), Pose.planar(0.2 * second, 0.0, 0.0))
        for second in seen_s[robot]:
            seen = replace(entry.observation, robot=robot, stamp_ns=EPOCH_NS + to_ns(second))
            data.entries.append(Entry(seen))
    return data


def kept_since_s(limits: Limits, data: DataSet) -> dict[str, float]:
    return {r: (ns - EPOCH_NS) / 1e9 for r, ns in limits.since_ns(data).items()}


def test_the_newest_sightings_are_kept() -> None:
    data = data_of({"r1": range(100, 300, 2), "r2": range(101, 300, 2)})
    assert kept_since_s(Limits(sightings=100), data) == {"r1": 200.0, "r2": 200.0}


def test_of_much_odometry_the_newest_is_kept_whatever_was_seen() -> None:
    data = data_of({"r1": range(100, 300, 2), "r2": range(101, 399, 2)})
    since = kept_since_s(Limits(sightings=100, odometry=100), data)
    assert since == {"r1": pytest.approx(350.0, abs=1.0), "r2": pytest.approx(350.0, abs=1.0)}


def test_of_many_visits_the_newest_are_kept_however_few_pictures_they_have() -> None:
    data = data_of({"r1": range(100, 400, 15), "r2": range(101, 400, 15)})
    limits = Limits(sightings=100, visits=12)
    assert limits.is_reached(data, is_open=False)
    assert not replace(limits, visits=20).is_reached(data, is_open=False)
    # Twenty pictures of a robot stay in any case: here all of it.
    assert kept_since_s(limits, data) == {"r1": 100.0, "r2": 101.0}
    more = data_of({"r1": range(10, 390, 15), "r2": range(15, 395, 15)})
    assert kept_since_s(limits, more) == {"r1": 100.0, "r2": 105.0}
    assert kept_since_s(replace(limits, visits=50), more) == {"r1": 25.0, "r2": 25.0}


def test_pictures_in_a_row_are_one_visit() -> None:
    data = data_of({"r1": range(100, 300), "r2": range(200, 300)})
    assert not Limits(sightings=1000, visits=1).is_reached(data, is_open=False)
    assert kept_since_s(Limits(sightings=1000, visits=1), data) == {"r1": 200.0, "r2": 200.0}


def test_a_robot_that_was_not_seen_for_long_keeps_its_last_sightings() -> None:
    data = data_of({"r1": range(100, 400), "r2": range(5, 45)})
    assert kept_since_s(Limits(sightings=100), data) == {"r1": 300.0, "r2": 25.0}


def test_a_robot_that_was_seen_seldom_keeps_all_of_it() -> None:
    data = data_of({"r1": range(100, 400), "r2": range(5, 15)})
    assert kept_since_s(Limits(sightings=100), data) == {"r1": 300.0, "r2": 5.0}


def test_nothing_that_is_past_is_kept_again() -> None:
    data = data_of({"r1": range(100, 400), "r2": range(25, 45)})
    before = {"r1": EPOCH_NS + to_ns(90.0), "r2": EPOCH_NS + to_ns(25.0)}
    data.past = Past(KnownCameras.none(), before, None, EPOCH_NS, {})
    assert kept_since_s(Limits(sightings=100), data) == {"r1": 300.0, "r2": 25.0}
    data.entries = [e for e in data.entries if e.observation.robot == "r1"]
    assert kept_since_s(Limits(sightings=100), data) == {"r1": 300.0, "r2": 300.0}


def test_a_robot_that_was_not_seen_for_days_keeps_none() -> None:
    data = data_of({"r1": range(100, 400), "r2": range(5, 45)})
    since = kept_since_s(Limits(sightings=100, odometry=300), data)
    assert since == {"r1": 300.0, "r2": pytest.approx(250.0, abs=1.0)}


def test_none_is_kept_from_before_a_camera_was_moved_in_the_past() -> None:
    """Where it hung then is not known any more."""
    data = data_of({"r1": range(100, 400), "r2": range(5, 45)})
    data.moves.append(Move("c1", "c1@1", EPOCH_NS + to_ns(30.0), EPOCH_NS + to_ns(20.0)))
    data.moves.append(Move("c2", "c2@1", EPOCH_NS + to_ns(350.0), EPOCH_NS + to_ns(340.0)))
    assert kept_since_s(Limits(sightings=100), data) == {"r1": 300.0, "r2": 30.0}


@pytest.mark.parametrize(
    ("count", "is_open", "is_reached"),
    [
        (200, False, False),
        (201, False, True),
        (300, True, False),
        (301, True, True),
    ],
)
def test_what_is_open_is_given_more_time(count: int, is_open: bool, is_reached: bool) -> None:
    data = data_of({"r1": range(0), "r2": range(0)})
    data.entries = [Entry(small_data(sightings=1).entries[0].observation)] * count
    assert Limits(sightings=100).is_reached(data, is_open=is_open) == is_reached


def test_what_is_settled_is_summarised_as_soon_as_the_limits_say() -> None:
    data = data_of({"r1": range(100, 251), "r2": range(0)})
    assert Limits(sightings=100, growth=1.5).is_reached(data, is_open=False)
    assert not Limits(sightings=100, growth=1.5).is_reached(data, is_open=True)
    assert not Limits(sightings=100).is_reached(data, is_open=False)


@pytest.mark.parametrize(("paths", "is_much"), [(False, True), (True, False)])
def test_a_recording_of_robots_that_look_alike_is_kept_whole(paths: bool, is_much: bool) -> None:
    data = data_of({"r1": range(100, 400), "r2": range(0)})
    assert data.has_alike_robots
    assert Smoother(data, Limits(100, paths=paths))._is_much(is_open=False) == is_much
