"""Where one camera is that a robot drives past, or in words why not."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import (
    CameraPlan,
    Plan,
    RobotPlan,
    circle,
    lens,
    make_session,
    observed,
    standing,
    straight,
)

from trigpoint.fusion.association.engine import explain
from trigpoint.fusion.association.events import Events, window
from trigpoint.fusion.association.explanation import CameraFinding
from trigpoint.fusion.association.mode import VisitModes
from trigpoint.fusion.association.modes import ModeFinder
from trigpoint.fusion.association.visits import visits_of
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.observations import Reading, View
from trigpoint.fusion.reading.best_readings import readings_rms_px
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise
from trigpoint.site.target import Face, Pattern, Target
from trigpoint.testing.views import looking_at
from trigpoint.tools.simulation.sight.seen_corners import seen_faces
from trigpoint.tools.simulation.sight.targets import target_of

EYE = looking_at((0.3, -1.8, 1.5), (0.2, 0.0, 0.65))
QUIET = OdometryNoise(0.001, 0.001, 0.001, 0.001)


def seen_data(
    target: Target, *, way=None, seconds: float = 4.0, most: int | None = None, eye: Pose = EYE
) -> DataSet:
    """What one camera sees of the robot that the map begins with."""
    robot = RobotPlan(way or circle(), target, QUIET)
    plan = Plan({"c1": CameraPlan(eye)}, {"r1": robot}, seconds=seconds, picture_rate=4.0)
    session = make_session(plan)
    return observed(session, most=most)


def frontal(data: DataSet, *, faces: int = 1) -> DataSet:
    """The data with one picture alone, and in it the largest faces alone."""
    views = [
        replace(entry.observation, views=tuple(sorted(entry.observation.views, key=width)[-faces:]))
        for entry in data.entries
    ]
    best = max(range(len(views)), key=lambda i: (len(views[i].views), width(views[i].views[-1])))
    chosen = views[best] if views[best].chosen is None else replace(views[best], chosen=None)
    return replace(data, entries=[Entry(chosen, data.entries[best].map_from_base)])


def width(view) -> float:
    return float(np.ptp(view.pixels[:, 0]))


def found_in(data: DataSet) -> CameraFinding:
    return explain(data, [entry.observation for entry in data.entries]).findings["c1"]


def error(found: CameraFinding, eye: Pose = EYE) -> np.ndarray:
    assert found.is_located, found
    return np.abs(found.alternatives[0].map_from_camera.difference(eye))


@pytest.mark.parametrize("kind", ["charuco", "checkerboard"])
def test_motion_past_the_camera_locates_it(kind: str) -> None:
    data = seen_data(target_of(kind))
    found = found_in(data)
    # Dozens of pictures of 0.15 px at two metres, where a pixel is 4 mm: millimetres.
    assert error(found)[:3].max() < 0.02
    assert error(found)[3:].max() < 0.01


def test_one_frontal_picture_of_one_of_six_look_alikes_is_undetermined_in_words() -> None:
    data = frontal(seen_data(target_of("checkerboard")))
    found = found_in(data)
    assert not found.is_located
    assert "none of them holds all" in found.reason
    assert len(found.alternatives) >= 2
    # One of those that fit alike is where it truly is.
    near = [np.abs(each.map_from_camera.difference(EYE)).max() for each in found.alternatives]
    assert min(near) < 0.1


def test_one_picture_of_two_marked_faces_is_enough() -> None:
    data = frontal(seen_data(target_of("charuco")), faces=2)
    assert len(data.entries[0].observation.views) == 2
    assert error(found_in(data))[:3].max() < 0.05


def test_robot_that_stands_before_the_camera_leaves_look_alikes_open() -> None:
    data = seen_data(target_of("checkerboard"), way=standing(), seconds=2.0)
    one_face = [
        Entry(replace(e.observation, views=e.observation.views[:1]), e.map_from_base)
        for e in data.entries
    ]
    assert one_face
    found = found_in(replace(data, entries=one_face))
    assert not found.is_located


def test_pictures_of_too_few_corners_are_said_so() -> None:
    data = seen_data(target_of("charuco"), seconds=2.0)
    for entry in data.entries:
        views = tuple(
            replace(v, corners=v.corners[:3], pixels=v.pixels[:3]) for v in entry.observation.views
        )
        entry.observation = replace(entry.observation, views=views)
    found = found_in(data)
    assert found.reason == "no picture of it shows enough of a face to place it"


@pytest.mark.long
def test_pictures_that_contradict_each_other_leave_many_places_open() -> None:
    data = seen_data(target_of("charuco"))
    random = np.random.default_rng(0)
    for entry in data.entries:
        views = tuple(
            replace(v, pixels=v.pixels + random.normal(0, 80.0, 2)) for v in entry.observation.views
        )
        entry.observation = replace(entry.observation, views=views)
    found = found_in(data)
    assert not found.is_located
    assert len(found.alternatives) > 2


def test_a_few_wild_pictures_do_not_move_the_camera() -> None:
    data, random = seen_data(target_of("charuco")), np.random.default_rng(1)
    for entry in data.entries[::6]:
        views = tuple(
            replace(v, pixels=v.pixels + random.normal(0, 40.0, 2)) for v in entry.observation.views
        )
        entry.observation = replace(entry.observation, views=views)
    assert error(found_in(data))[:3].max() < 0.03


def seen_by_unknown_lens(seed: int, pictures: int, wild_in: int) -> tuple[DataSet, list[Array]]:
    """Pictures of one face by a camera whose lens is estimated, three corners of the first ones
    off by 57 px, and which corners of each these are."""
    random = np.random.default_rng(seed)
    robot = RobotPlan(circle(), target_of("charuco"))
    camera = CameraPlan(EYE, more='intrinsics = "estimate"')
    data = observed(make_session(Plan({"c1": camera}, {"r1": robot}, seconds=4.0)))
    seen = [entry for entry in data.entries if entry.observation.views]
    data.entries = seen[:pictures] if pictures > 1 else frontal(data).entries
    wilds = []
    for number, entry in enumerate(data.entries):
        view = max(entry.observation.views, key=width)
        wild = np.zeros(len(view.corners), dtype=bool)
        if number < wild_in:
            wild[random.choice(len(wild), 3, replace=False)] = True
        away = np.where(wild[:, None], random.choice((-40.0, 40.0), (len(wild), 2)), 0.0)
        views = (replace(view, pixels=view.pixels + away),)
        entry.observation = replace(entry.observation, views=views, chosen=None)
        wilds.append(wild)
    return data, wilds


def modes_of(data: DataSet) -> VisitModes:
    seen = [entry.observation for entry in data.entries]
    (visit,) = visits_of(data, seen)
    return ModeFinder(data, seen, Events()).modes_of(visit)


@pytest.mark.parametrize("seed", range(6))
def test_single_picture_of_an_unknown_lens_is_right_beside_its_wild_corners(seed: int) -> None:
    """What alone tells the lens looks far off for what its wild corners pull."""
    data, (wild,) = seen_by_unknown_lens(seed, 1, 1)
    found = modes_of(data)
    assert found.modes
    for mode in found.modes:
        assert mode.wrong == 0
        np.testing.assert_array_equal(mode.wild[0][0], wild)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("displaced_px", [15.0, 60.0])
def test_displaced_picture_with_wild_corners_is_wrong(seed: int, displaced_px: float) -> None:
    data, _ = seen_by_unknown_lens(seed, 3, 1)
    first = data.entries[0].observation
    (view,) = first.views
    moved = replace(view, pixels=view.pixels + np.array([0.0, displaced_px]))
    data.entries[0].observation = replace(first, views=(moved,))
    best = modes_of(data).modes[0]
    assert [best.readings[n][0] is None for n in range(3)] == [True, False, False]


def test_all_that_one_picture_shows_may_be_wrong_together() -> None:
    """Two faces seen alike elsewhere were as improbable as two wrong ones beside each other: the
    last picture of a drawn session had put its camera 27 cm off."""
    data = frontal(seen_data(target_of("charuco")), faces=2)
    assert len(data.entries[0].observation.views) == 2
    found = modes_of(data)
    assert found.nothing == pytest.approx(found.modes[0].evidence + Events().wrong_limit)


@pytest.mark.parametrize("displaced", [0, 1])
@pytest.mark.parametrize("first", [0, 2, 4])
def test_of_two_pictures_that_contradict_none_is_preferred(first: int, displaced: int) -> None:
    data = seen_data(target_of("charuco"))
    entries = []
    for order, entry in enumerate(data.entries[first : first + 2]):
        view = max(entry.observation.views, key=width)
        shift = np.array([60.0, 24.0]) if order == displaced else np.zeros(2)
        view = replace(view, pixels=view.pixels + shift)
        seen = replace(entry.observation, chosen=None, views=(view,))
        entries.append(Entry(seen, entry.map_from_base))
    assert not found_in(replace(data, entries=entries)).is_located


def test_located_camera_is_never_mirrored() -> None:
    data = seen_data(target_of("checkerboard"))
    found = found_in(data)
    assert found.is_located
    pose = found.alternatives[0].map_from_camera
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    assert pose.translation[2] > 0.5


def board_ahead() -> Target:
    """One checkerboard that looks where the robot drives, and reads from both ends."""
    into, down = np.array([-1.0, 0, 0]), np.array([0, 0, -1.0])
    pose = Pose(np.column_stack([np.cross(down, into), down, into]), np.array([0.2, -0.1, 0.7]))
    shift = tuple(pose.translation.tolist())
    turn = tuple(pose.quaternion.tolist())
    return Target("board", (Face(0, Pattern.CHECKERBOARD, 9, 7, 0.03, shift, turn),))


def test_camera_is_not_put_below_the_floor_that_the_robot_drives_on() -> None:
    eye = looking_at((2.8, 0.3, 1.6), (1.0, 0.0, 0.65))
    data = seen_data(board_ahead(), way=straight(), eye=eye)
    assert error(found_in(data), eye).max() < 0.05


def test_robot_is_not_seen_through_its_own_faces() -> None:
    target = target_of("checkerboard")
    views = []
    for number, face in enumerate(target.faces):
        corners = np.arange(face.corner_count)
        views.append(View(corners, face.corners[:, :2], 0.1, (Reading(number),)))
    hidden = 0
    for azimuth in np.linspace(0, 2 * np.pi, 73):
        eye = looking_at((2 * np.cos(azimuth), 2 * np.sin(azimuth), 1.2), (0.0, 0.0, 0.72))
        _, rms = readings_rms_px(views, target, lens(), eye.inverse().repeated(6))
        seen = np.isfinite(rms)
        for face in seen_faces(target, Pose.identity(), eye, lens(), ()):
            share = len(face.corners) / face.face.corner_count
            # The simulator's sheets reach a centimetre beyond the pattern.
            if abs(share - 0.5) > 0.2:
                assert seen[target.faces.index(face.face)] == (share > 0.5)
                hidden += share < 0.5
    assert hidden > 10


@pytest.mark.parametrize(("sigma_m", "is_below"), [(0.3, False), (0.03, True)])
def test_mode_is_below_the_floor_if_its_height_is_known_well_enough(
    sigma_m: float, is_below: bool
) -> None:
    """Of a distant face the right pose was 0.3 m below, and the other one was taken, 3 m off."""
    (mode, *_) = modes_of(seen_by_unknown_lens(0, 8, 0)[0]).modes
    low = Pose(np.eye(3), np.array([0.0, 0.0, -0.3]))
    information = np.eye(len(mode.information)) / sigma_m**2
    camera = replace(mode.camera, map_from_camera=low)
    assert replace(mode, camera=camera, information=information).is_below(window()) is is_below
