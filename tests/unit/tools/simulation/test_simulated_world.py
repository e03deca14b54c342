"""The world: frames, determinism, who sees what."""

from pathlib import Path

import numpy as np
import pytest

from trigpoint.base.errors import InputError
from trigpoint.geometry import Pose
from trigpoint.site.target import parse_target
from trigpoint.tools.shapes.text import target_text
from trigpoint.tools.simulation.sight.seen_corners import Wall, hidden_by_walls, seen_faces
from trigpoint.tools.simulation.sight.targets import target_of
from trigpoint.tools.simulation.world import World, load_world

TWO_ROBOTS = """
site = "hall"
hold_first = 1.0

[cameras.c1]
position = [0.0, -1.4, 1.5]
yaw = 90.0
pitch = 28.0

[robots.r1]
waypoints = [[-1.0, 0.0], [1.0, 0.0]]
odometry_start = [2.0, 1.0, 0.5]

[robots.r2]
waypoints = [[1.0, 0.6], [-1.0, 0.6]]
odometry_start = [-3.0, 0.0, -1.0]
"""


@pytest.fixture(scope="module")
def lab() -> World:
    return load_world("lab", seed=1)


def write(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_the_map_is_the_first_robots_odometry_frame(tmp_path: Path) -> None:
    world = load_world(write(tmp_path / "w.toml", TWO_ROBOTS), seed=3)
    for_r1, for_r2 = (world.odometry(robot).poses[0] for robot in ("r1", "r2"))
    truth = world.map_from_base("r1", 0.0)
    assert np.allclose(truth.translation, [2.0, 1.0, 0.0])
    assert truth.heading == pytest.approx(0.5)
    assert np.allclose(truth.difference(for_r1), 0)
    assert np.allclose(for_r2.translation, [-3.0, 0.0, 0.0])
    apart = world.map_from_base("r2", 0.0).translation - truth.translation
    assert np.linalg.norm(apart) == pytest.approx(np.hypot(2.0, 0.6))


def test_robots_with_the_same_pattern_are_not_named_in_sightings(tmp_path: Path) -> None:
    world = load_world(write(tmp_path / "w.toml", TWO_ROBOTS), seed=3)
    faces = [face for t_s in np.arange(0, 7, 0.2) for face in world.sightings("c1", float(t_s))]
    assert faces
    assert {face.target for face in faces} == {""}


def test_a_robot_hides_part_of_the_one_behind_it(tmp_path: Path) -> None:
    level = TWO_ROBOTS.replace("-1.4, 1.5]", "-1.4, 0.8]").replace("28.0", "4.0")
    both = load_world(write(tmp_path / "w.toml", level), seed=3)
    alone = level.split("[robots.r1]")[0] + "[robots.r2]" + level.split("[robots.r2]")[1]
    free = load_world(write(tmp_path / "alone.toml", alone), seed=3)
    times = np.arange(2.0, 6.0, 0.1)
    counts = [
        sum(len(face.corners) for t_s in times for face in world.seen("c1", "r2", float(t_s)))
        for world in (both, free)
    ]
    assert 0 < counts[0] < counts[1]


def test_truth_does_not_depend_on_the_seed_but_odometry_does(lab: World) -> None:
    other = load_world("lab", seed=2)
    t_s = np.linspace(0, lab.duration_s, 50)
    assert np.array_equal(
        lab.map_from_base("r1", t_s).translation, other.map_from_base("r1", t_s).translation
    )
    ends = [world.odometry("r1").poses[-1].translation for world in (lab, other)]
    assert np.linalg.norm(ends[0] - ends[1]) > 1e-3


def test_one_time_and_many_times_give_the_same_poses(lab: World) -> None:
    t_s = np.array([1.0, 20.123, 47.5])
    many = lab.map_from_base("r1", t_s)
    for i, one in enumerate(t_s):
        assert np.array_equal(lab.map_from_base("r1", float(one)).translation, many.translation[i])


def test_the_same_seed_gives_the_same_sightings_in_any_order(lab: World) -> None:
    again = load_world("lab", seed=1)
    later = again.sightings("c2", 15.0)
    first = again.sightings("c1", 2.0)
    for ours, theirs in ((lab.sightings("c1", 2.0), first), (lab.sightings("c2", 15.0), later)):
        assert ours
        assert len(ours) == len(theirs)
        for a, b in zip(ours, theirs, strict=True):
            assert a.face == b.face
            assert np.array_equal(a.corners, b.corners)
            assert np.array_equal(a.pixels, b.pixels)
    assert not np.array_equal(
        load_world("lab", seed=2).sightings("c1", 2.0)[0].pixels, lab.sightings("c1", 2.0)[0].pixels
    )


def test_the_robot_stands_first_and_last_and_never_in_between(lab: World) -> None:
    t_s = np.arange(0, lab.duration_s, 0.05)
    speed = np.linalg.norm(np.diff(lab.map_from_base("r1", t_s).translation, axis=0), axis=1) / 0.05
    assert np.all(speed[t_s[:-1] < 5.9] == 0)
    assert np.all(speed[t_s[:-1] > lab.duration_s - 1.9] == 0)
    assert np.all(speed[(t_s[:-1] > 7.1) & (t_s[:-1] < lab.duration_s - 3.1)] > 0.39)


def test_no_two_cameras_of_the_lab_see_the_same_place_at_the_targets_height(lab: World) -> None:
    plan_x, plan_y = np.meshgrid(np.arange(0.0, 10.0, 0.05), np.arange(0.0, 4.0, 0.05))
    for height in (0.55, 0.72, 0.9):
        plan = np.column_stack([plan_x.ravel(), plan_y.ravel(), np.full(plan_x.size, height)])
        points = lab.map_from_plan @ plan
        viewers = np.zeros(len(points), dtype=int)
        for camera in lab.cameras.values():
            seen = camera.model.sees(camera.map_from_camera.inverse() @ points)
            for wall in lab.walls:
                seen &= ~hidden_by_walls(camera.map_from_camera.translation, points, (wall,))
            assert seen.any()
            viewers += seen
        assert viewers.max() == 1


@pytest.mark.parametrize("target", ["charuco", "checkerboard"])
def test_every_camera_meets_the_robot_and_two_meet_it_again(target: str) -> None:
    world = load_world("lab", seed=1, target=target)
    passes = {}
    for name, camera in world.cameras.items():
        every = 4  # pictures; far less than the three seconds that are told apart
        times = camera.time_of(np.arange(0, int(world.duration_s * camera.rate), every))
        hits = np.array([t_s for t_s in times if world.sightings(name, float(t_s))])
        assert len(hits) * (every / camera.rate) >= 3.0
        passes[name] = 1 + int(np.sum(np.diff(hits) > 3.0))
    assert sorted(passes.values()) == [1, 1, 1, 1, 2, 2]


def test_the_back_of_a_sheet_and_what_it_hides_are_not_seen(lab: World) -> None:
    target, model = target_of("charuco"), lab.cameras["c1"].model
    from_east = Pose(np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]], float), np.array([1.5, 0, 0.72]))
    seen = {
        face.face.id: face for face in seen_faces(target, Pose.identity(), from_east, model, ())
    }
    # A level look along -x sees the sides of the vanes that are turned to +x.
    normals = {face.id: -face.base_from_face.rotation[:, 2] for face in target.faces}
    assert set(seen) == {i for i, normal in normals.items() if normal[0] > 0.3}
    beside = Wall(np.array([0.8, 0.1]), np.array([0.8, 2.0]), 2.0)
    left = seen_faces(target, Pose.identity(), from_east, model, (beside,))
    all_corners = sum(len(face.corners) for face in seen.values())
    assert 0 < sum(len(face.corners) for face in left) < all_corners


def test_a_vane_hides_the_one_behind_it(lab: World) -> None:
    target, model = target_of("charuco"), lab.cameras["c1"].model
    eye = Pose(np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]], float), np.array([1.5, 0, 0.72]))
    hidden_somewhere = False
    for heading in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        base = Pose.planar(0, 0, heading)
        for face in seen_faces(target, base, eye, model, ()):
            alone = type(target)("alone", (face.face,))
            free = seen_faces(alone, base, eye, model, ())[0]
            hidden_somewhere |= len(face.corners) < len(free.corners)
            assert set(face.corners) <= set(free.corners)
    assert hidden_somewhere


def test_pixels_of_sightings_scatter_by_the_sigma_that_they_state(lab: World) -> None:
    squares = []
    for t_s in np.arange(0.0, 5.0, 0.05):
        truth = {face.face.id: face for face in lab.seen("c1", "r1", float(t_s))}
        found = lab.sightings("c1", float(t_s))
        squares += [((f.pixels - truth[f.face].pixels) / f.sigma) ** 2 for f in found]
    values = np.concatenate([square.ravel() for square in squares])
    assert abs(values.mean() - 1) < 5 * np.sqrt(2 / len(values))


def test_checkerboards_are_sighted_whole_unnamed_and_from_either_end() -> None:
    world = load_world("lab", seed=1, target="checkerboard")
    ends = set()
    for t_s in np.arange(0.0, 5.0, 0.2):
        truth = world.seen("c1", "r1", float(t_s))
        for face in world.sightings("c1", float(t_s)):
            assert face.face == -1
            assert len(face.corners) == 48
            gaps = [
                (float(np.abs(face.pixels - order).max()), end)
                for seen in truth
                if len(seen.pixels) == 48
                for end, order in enumerate((seen.pixels, seen.pixels[::-1]))
            ]
            gap, end = min(gaps)
            assert gap < 6 * face.sigma
            ends.add(end)
    assert ends == {0, 1}


@pytest.mark.parametrize("choice", ["charuco", "checkerboard"])
def test_a_target_file_reads_back_as_the_target(choice: str) -> None:
    target = target_of(choice)
    assert parse_target(target_text(target)) == target
    assert len(target.faces) == 6
    tops = [(face.base_from_face @ face.corners)[:, 2].max() for face in target.faces]
    assert max(tops) < 1.0


def test_named_worlds_load_and_unknown_ones_are_named() -> None:
    for name in ("lab", "drive", "loop", "dance"):
        assert len(load_world(name, seed=0).cameras) == 6
    assert load_world("dance", seed=0).duration_s == pytest.approx(300, abs=30)
    with pytest.raises(InputError, match=r"no world «moon»; name lab, drive"):
        load_world("moon", seed=0)
    with pytest.raises(InputError, match="no target «ball»"):
        load_world("lab", seed=0, target="ball")
    with pytest.raises(InputError, match=r"no camera «c9» .* it has c1, c2"):
        load_world("lab", seed=0).camera("c9")


def test_mistakes_in_a_world_file_are_told_with_their_place(tmp_path: Path) -> None:
    file = write(tmp_path / "w.toml", TWO_ROBOTS.replace("pitch", "pich"))
    with pytest.raises(InputError, match=r"w.toml:8: cameras.c1.pich .*«pitch»"):
        load_world(file, seed=0)
    with pytest.raises(InputError, match="no such world file"):
        load_world(str(tmp_path / "none.toml"), seed=0)
    spot = TWO_ROBOTS.replace("[1.0, 0.0]]", "[1.0, 0.0], [-1.0, 0.0]]")
    with pytest.raises(InputError, match="turns back on the spot"):
        load_world(write(tmp_path / "spot.toml", spot), seed=0)
    with pytest.raises(InputError, match="needs a site, a camera and a robot"):
        load_world(write(tmp_path / "empty.toml", 'site = "x"\n'), seed=0)
