"""What is kept of a robot that stands before a camera for long."""

from collections.abc import Iterable

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.fusion.intake.standstills import MOST_ALIKE, Standstills
from trigpoint.fusion.model.observations import Observation, Reading, View, observation_of
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.geometry import Pose
from trigpoint.site.config import OdometryNoise

PERIOD_NS = to_ns(0.2)
SIGMA = 0.1
CORNERS = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1).reshape(-1, 2) * 20 + 300
ONE_WAY = (Reading(0),)
EITHER_WAY = (Reading(0), Reading(0, is_turned=True))

random = np.random.default_rng(7)


def view(pixels: np.ndarray = CORNERS, readings: tuple[Reading, ...] = ONE_WAY) -> View:
    noisy = pixels + random.normal(0.0, SIGMA, pixels.shape)
    return View(np.arange(len(pixels)), noisy, SIGMA, readings)


class Scene:
    """A robot before a camera, a picture each PERIOD_NS; all of it goes on from call to call."""

    def __init__(self) -> None:
        self.track = OdometryTrack(OdometryNoise(), planar=True)
        self.standstills = Standstills({"r1": self.track})
        self.kept: list[Observation] = []
        self._count, self._x = 0, 0.0

    def show(self, pictures: Iterable[tuple[View, ...]], *, speed: float = 0.0) -> int:
        """Take pictures of the robot; how many of them are kept."""
        before = len(self.kept)
        for views in pictures:
            self._count += 1
            self._x += speed * PERIOD_NS / 1e9
            stamp_ns = self._count * PERIOD_NS
            self.track.add(stamp_ns, Pose.planar(self._x, 0.0, 0.0))
            observation = observation_of("c1", "r1", stamp_ns, views)
            if not self.standstills.repeats(observation):
                self.kept.append(observation)
        return len(self.kept) - before


def alike(count: int) -> list[tuple[View, ...]]:
    return [(view(),) for _ in range(count)]


def test_of_a_long_standstill_a_stated_number_is_kept() -> None:
    scene = Scene()
    assert scene.show(alike(2000)) == MOST_ALIKE


def test_everything_of_a_short_one_is_kept() -> None:
    assert Scene().show(alike(MOST_ALIKE)) == MOST_ALIKE


def test_everything_of_a_driving_robot_is_kept_however_alike_it_looks() -> None:
    scene = Scene()
    scene.show(alike(200))
    assert scene.show(alike(300), speed=0.1) == 300
    assert scene.show(alike(300)) == MOST_ALIKE - 1  # the last one it drove to is the first


def test_a_robot_or_camera_that_was_moved_is_looked_at_again_at_once() -> None:
    scene = Scene()
    scene.show(alike(500))
    moved = [(view(CORNERS + 1.0),) for _ in range(500)]
    assert scene.show(moved) == MOST_ALIKE
    assert scene.show(alike(500)) == MOST_ALIKE  # and back


def test_a_face_that_appears_is_taken_and_one_that_flickers_is_not_taken_anew() -> None:
    scene = Scene()
    scene.show(alike(500))
    other = (Reading(1),)
    both = [(view(), view(CORNERS + 90.0, other)) for _ in range(500)]
    assert scene.show(both) == MOST_ALIKE
    assert scene.show([*alike(50), *both, *alike(50)]) == 0


def test_corners_that_are_hidden_for_a_while_make_no_other_look() -> None:
    scene = Scene()
    scene.show(alike(500))
    assert scene.show([(view(CORNERS[:6]),) for _ in range(50)]) == 0


def test_one_wild_corner_makes_no_other_look() -> None:
    scene = Scene()
    scene.show(alike(500))
    wild = CORNERS.copy()
    wild[5] += 30.0
    assert scene.show([(view(wild),) for _ in range(50)]) == 0


def test_a_board_read_from_its_other_end_looks_the_same() -> None:
    scene = Scene()
    ends = (CORNERS, CORNERS[::-1])
    turns = [(view(ends[i % 2], EITHER_WAY),) for i in range(1000)]
    assert scene.show(turns) == MOST_ALIKE


def test_what_a_trembling_camera_adds_is_bounded() -> None:
    scene = Scene()
    trembling = [(view(CORNERS + 5.0 * (i % 2)),) for i in range(2000)]
    assert scene.show(trembling) <= 17 * MOST_ALIKE


def test_what_was_kept_is_kept_again_where_it_is_read_again() -> None:
    scene = Scene()
    scene.show([*alike(300), *((view(CORNERS + 4.0),) for _ in range(300))])
    again = Standstills({"r1": scene.track})
    assert not any(again.repeats(observation) for observation in scene.kept)


class Twins:
    """A robot before a camera that any of two may be; `drives`: which of them drive, if any."""

    def __init__(self) -> None:
        tracks = {name: OdometryTrack(OdometryNoise(), planar=True) for name in ("r1", "r2")}
        self._tracks, self._standstills = tracks, Standstills(tracks)
        self._count, self._x = 0, dict.fromkeys(tracks, 0.0)

    def show(self, pictures: Iterable[tuple[View, ...]], *drives: str) -> int:
        """Take pictures; how many of them are kept."""
        kept = 0
        for views in pictures:
            self._count += 1
            stamp_ns = self._count * PERIOD_NS
            for name, track in self._tracks.items():
                self._x[name] += 0.1 * (name in drives)
                track.add(stamp_ns, Pose.planar(self._x[name], 0.0, 0.0))
            kept += not self._standstills.shown_again("c1", ("r1", "r2"), stamp_ns, views)
        return kept


def elsewhere(count: int) -> list[tuple[View, ...]]:
    """A robot that drives through the picture."""
    return [(view(CORNERS + 2.0 * number),) for number in range(count)]


def test_of_twins_that_stand_a_stated_number_is_kept() -> None:
    twins = Twins()
    assert twins.show(alike(200)) == MOST_ALIKE


def test_a_twin_that_drives_makes_the_standing_one_worth_another_look() -> None:
    twins = Twins()
    twins.show(alike(150))
    twins.show(alike(10), "r2")
    assert twins.show(alike(150)) in (MOST_ALIKE - 1, MOST_ALIKE)


def test_what_is_kept_of_a_standing_twin_is_bounded_however_the_other_drives() -> None:
    twins = Twins()
    assert twins.show(alike(1400), "r2") <= 17 * MOST_ALIKE


def test_everything_of_a_driving_twin_is_kept_while_the_other_stands_elsewhere() -> None:
    twins = Twins()
    for _ in range(2):
        assert twins.show(elsewhere(600), "r2") == 600
