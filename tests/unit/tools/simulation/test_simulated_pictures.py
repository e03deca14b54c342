"""Rendered pictures, held against the projected truth."""

import copy
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from trigpoint.geometry import CameraModel
from trigpoint.geometry.camera import LensModel
from trigpoint.tools.simulation.drawing.lens_grid import directions_on_grid
from trigpoint.tools.simulation.drawing.rendering import CameraRenderer
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

[robots.r2]
waypoints = [[1.0, 0.6], [-1.0, 0.6]]
target = "checkerboard"
"""
IN_VIEW = {"c1": 62.0, "c2": 13.9, "c3": 41.4, "c4": 34.5, "c5": 27.2, "c6": 54.8}


@pytest.fixture(scope="module")
def world() -> World:
    return load_world("lab", seed=1, target="checkerboard")


@pytest.fixture(scope="module")
def renderer(world: World) -> CameraRenderer:
    return CameraRenderer(world, "c2")


def corner_errors(world: World, renderer: CameraRenderer, times: np.ndarray) -> np.ndarray:
    """What cornerSubPix finds from the true corners on, minus the truth; pixels."""
    errors = []
    for t_s in times:
        picture = renderer.picture_at(float(t_s))
        for face in world.seen("c2", "r1", float(t_s)):
            if len(face.corners) == face.face.corner_count:
                start = face.pixels.astype(np.float32).reshape(-1, 1, 2)
                rule = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-4)
                found = cv2.cornerSubPix(picture, start.copy(), (3, 3), (-1, -1), rule)
                errors.append(found.reshape(-1, 2) - face.pixels)
    return np.vstack(errors)


def test_corners_of_a_moving_robot_are_drawn_where_they_are(
    world: World, renderer: CameraRenderer
) -> None:
    errors = corner_errors(world, renderer, np.arange(12.5, 15.5, 0.2))
    assert len(errors) > 1000
    assert np.all(np.abs(errors.mean(axis=0)) < 0.02)
    assert np.all(np.sqrt((errors**2).mean(axis=0)) < 0.05)


def test_pictures_do_not_depend_on_what_was_drawn_before(
    world: World, renderer: CameraRenderer
) -> None:
    first, second = renderer.picture(67), renderer.picture(70)
    assert np.array_equal(renderer.picture(67), first)
    fresh = CameraRenderer(load_world("lab", seed=1, target="checkerboard"), "c2")
    assert np.array_equal(fresh.picture(70), second)


def test_another_seed_or_picture_has_other_noise(world: World, renderer: CameraRenderer) -> None:
    empty = renderer.picture(1)
    assert not np.array_equal(empty, renderer.picture(2))
    other = CameraRenderer(load_world("lab", seed=2, target="checkerboard"), "c2").picture(1)
    assert not np.array_equal(empty, other)
    clean = renderer.picture_at(0.2).astype(float)
    assert np.std(empty - clean) == pytest.approx(2.0, abs=0.1)
    assert abs(np.mean(empty - clean)) < 0.05


def test_without_noise_the_picture_is_the_clean_one(world: World) -> None:
    quiet = CameraRenderer(world, "c5", noise=False)
    t_s = float(world.cameras["c5"].time_of(136))
    assert np.array_equal(quiet.picture(136), quiet.picture_at(t_s))


@pytest.mark.parametrize("camera", sorted(IN_VIEW))
def test_every_camera_shows_both_empty_rooms_and_the_robot(world: World, camera: str) -> None:
    renderer = CameraRenderer(world, camera, noise=False)
    size = (world.cameras[camera].model.height, world.cameras[camera].model.width)
    empty, busy = renderer.picture_at(IN_VIEW["c6" if camera == "c4" else "c4"]), None
    busy = renderer.picture_at(IN_VIEW[camera])
    assert empty.shape == busy.shape == size
    assert empty.dtype == np.uint8
    assert empty.std() > 5  # floor, walls, furniture: no plain grey
    changed = (empty != busy).mean()
    assert 0.02 < changed < 0.5


def test_a_robot_behind_a_wall_is_not_drawn(world: World, renderer: CameraRenderer) -> None:
    behind_the_cupboards = 54.8  # before c6, on the other side
    assert np.array_equal(renderer.picture_at(behind_the_cupboards), renderer.picture_at(34.5))


def test_a_moving_robot_is_blurred_along_its_way(world: World) -> None:
    camera = world.cameras["c2"]
    renderer = CameraRenderer(world, "c2", noise=False)
    moving = renderer.picture_at(13.9)
    sharp = CameraRenderer(world, "c2", noise=False)
    object.__setattr__(sharp, "_instants", lambda robot, t_s: robot.map_from_base(np.array([t_s])))
    still = sharp.picture_at(13.9)
    assert camera.exposure_s > 0
    slope = [np.abs(np.diff(picture.astype(float), axis=1)).max() for picture in (moving, still)]
    assert slope[0] < 0.9 * slope[1]


@pytest.mark.parametrize(
    "model",
    [
        CameraModel(640, 480, 540, 541, 322, 238, (-0.22, 0.06, 0.001, -0.001, -0.01)),
        CameraModel(320, 240, 200, 200, 160, 119, (0.02, -0.01, 0, 0), LensModel.EQUIDISTANT),
    ],
)
def test_directions_on_a_grid_are_those_of_the_lens(model: CameraModel) -> None:
    u, v = np.arange(0.0, model.width, 13), np.arange(0.0, model.height, 17)
    directions = directions_on_grid(model, u, v)
    rays = np.concatenate([directions, np.ones((*directions.shape[:2], 1))], axis=-1)
    back = model.project(rays)
    assert np.abs(back - np.stack(np.meshgrid(u, v), axis=-1)).max() < 1e-6


def test_the_nearer_robot_is_drawn_over_the_farther_one(tmp_path: Path) -> None:
    file = tmp_path / "two.toml"
    file.write_text(TWO_ROBOTS, encoding="utf-8")
    world = load_world(str(file), seed=0)
    alone = load_world(str(file), seed=0)
    del alone.robots["r2"]
    both = CameraRenderer(world, "c1").picture_at(3.9)
    near = CameraRenderer(alone, "c1").picture_at(3.9)
    changed = both != near
    assert changed.any()
    corners = np.vstack([face.pixels for face in world.seen("c1", "r1", 3.9)]).round().astype(int)
    assert not changed[corners[:, 1], corners[:, 0]].any()


def rolling(world: World, line_delay_s: float) -> World:
    """The same world with rolling shutters."""
    other = copy.copy(world)
    other.cameras = {n: replace(c, line_delay_s=line_delay_s) for n, c in world.cameras.items()}
    return other


@pytest.mark.parametrize("line_delay_s", [60e-6, -60e-6])
def test_a_rolling_shutter_draws_corners_where_their_rows_see_them(
    world: World, line_delay_s: float
) -> None:
    rolls = rolling(world, line_delay_s)
    errors = corner_errors(rolls, CameraRenderer(rolls, "c2", noise=False), np.arange(13, 15, 0.25))
    assert len(errors) > 300
    assert np.all(np.abs(errors.mean(axis=0)) < 0.02)
    assert np.all(np.sqrt((errors**2).mean(axis=0)) < 0.05)


def test_a_rolling_shutter_sees_a_corner_as_its_row_is_exposed(world: World) -> None:
    rolls, t_s = rolling(world, 60e-6), 13.9
    (seen, *_), (still, *_) = (w.seen("c2", "r1", t_s) for w in (rolls, world))
    eye, corner = rolls.cameras["c2"], 5
    at_s = t_s + 60e-6 * (seen.pixels[corner, 1] - (eye.model.height - 1) / 2)
    as_exposed = next(f for f in world.seen("c2", "r1", float(at_s)) if f.face == seen.face)
    np.testing.assert_allclose(seen.pixels[corner], as_exposed.pixels[corner], atol=1e-6)
    assert np.abs(seen.pixels - still.pixels).max() > 0.3


def test_a_standing_robot_looks_the_same_to_a_rolling_shutter(world: World) -> None:
    rolls, t_s = rolling(world, 60e-6), 2.0
    still = CameraRenderer(world, "c1").picture_at(t_s)
    assert np.array_equal(CameraRenderer(rolls, "c1").picture_at(t_s), still)
