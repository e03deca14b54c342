"""What is wrong in a session is what was asked for, and the oracle knows of it."""

from collections import Counter

import numpy as np
import pytest

from benchmarks.study.disturbance import Disturbance, LensSpread, disturbed, with_ways
from benchmarks.study.in_memory import Simulated, simulated
from trigpoint.contract.messages import Odometry, Sightings
from trigpoint.site.config import OdometryNoise
from trigpoint.tools.simulation.motion.actors import Lift, Move
from trigpoint.tools.simulation.motion.odometry import scattered
from trigpoint.tools.simulation.world import World, load_world


@pytest.fixture(scope="module")
def world() -> World:
    return load_world("loop", seed=7)


@pytest.fixture(scope="module")
def plain(world: World) -> Simulated:
    return simulated(world, Disturbance())


def sightings(session: Simulated) -> list[tuple[str, Sightings]]:
    return [(node, m) for node, m in session.messages if isinstance(m, Sightings)]


def test_motion_scatters_about_the_report_by_the_contracts_variances() -> None:
    noise = OdometryNoise()
    steps = np.tile([0.1, 0.0, 0.2], (4000, 1))
    true = scattered(steps, noise, np.array([0.01, -0.02]), np.random.default_rng(0))
    error = true - steps * [1.01, 1.01, 0.98]
    along = error[:, :2] @ [np.cos(0.1), np.sin(0.1)]
    across = error[:, :2] @ [-np.sin(0.1), np.cos(0.1)]
    expected = [
        noise.distance**2 * 0.1,
        noise.lateral**2 * 0.1,
        noise.heading_drive**2 * 0.1 + noise.heading_turn**2 * 0.2,
    ]
    found = np.var(np.column_stack([along, across, error[:, 2]]), axis=0)
    np.testing.assert_allclose(found, expected, rtol=0.12)  # five sigmas of a variance


def test_a_good_corner_lies_where_the_truth_has_it(plain: Simulated) -> None:
    truth, errors = plain, list[np.ndarray]()
    for (camera, stamp_ns), faces in truth.sighted.items():
        eye = truth.world.cameras[camera]
        base = truth.map_from_base("r1", np.array([stamp_ns]))[0]
        for seen in faces:
            face = truth.world.robots["r1"].carried.face(seen.face)
            optical = (truth.cameras[camera].inverse() @ base @ face.base_from_face) @ face.corners
            expected = eye.model.project(optical)[seen.sighting.corners]
            errors.append((seen.sighting.pixels - expected)[seen.is_good])
    every = np.concatenate(errors)
    assert np.std(every) == pytest.approx(0.15, rel=0.1)
    assert np.abs(every).max() < 0.15 * 6


def test_time_offsets_are_in_the_stamps_and_not_in_the_pictures(
    world: World, plain: Simulated
) -> None:
    late = simulated(world, Disturbance(time_offset_s=0.05))
    for name, camera in late.world.cameras.items():
        mine = [m for node, m in sightings(late) if node == name]
        others = [m for node, m in sightings(plain) if node == name]
        apart = {(a.stamp_ns - b.stamp_ns) / 1e9 for a, b in zip(mine, others, strict=True)}
        assert max(abs(s - camera.time_offset_s) for s in apart) < 1e-6
        assert camera.time_offset_s != 0
        np.testing.assert_array_equal(mine[0].faces[0].pixels, others[0].faces[0].pixels)


def test_lenses_and_faces_are_drawn_about_what_is_told(world: World) -> None:
    spread = LensSpread(0.05, 0.02, 0.05)
    changed = disturbed(world, Disturbance(lens=spread, mount_m=0.003, mount_rad=0.01))
    for name, camera in changed.cameras.items():
        told = world.cameras[name].model
        sigmas = (camera.model.parameters - told.parameters) / spread.sigmas(told)
        assert 0 < np.abs(sigmas).max() < 6
    robot = changed.robots["r1"]
    apart = [
        carried.base_from_face.difference(told.base_from_face)
        for carried, told in zip(robot.carried.faces, robot.target.faces, strict=True)
    ]
    assert 0 < np.abs(apart).max(axis=0)[:3].max() < 0.015
    assert robot.target == world.robots["r1"].target


def test_wrong_sightings_are_as_many_as_asked_and_not_good(world: World) -> None:
    wrong = Disturbance(displaced_share=0.2, wild_share=0.1, misnamed_share=0.3)
    session = simulated(world, wrong)
    faces = [face for seen in session.sighted.values() for face in seen]
    displaced = np.mean([not face.is_good.any() for face in faces])
    misnamed = np.mean([face.sighting.face != face.face for face in faces])
    wild = np.mean(np.concatenate([~f.is_good for f in faces if f.is_good.any()]))
    assert len(faces) > 20
    assert displaced == pytest.approx(0.2, abs=0.2)
    assert misnamed == pytest.approx(0.3, abs=0.25)
    assert wild == pytest.approx(0.1, abs=0.05)


def test_a_moved_camera_hangs_elsewhere_from_then_on(world: World) -> None:
    by = np.array([0.0, 0.15, -0.05, 0.0, 0.0, 0.1])
    changed = disturbed(world, Disturbance(moves={"c2": (Move(30.0, by),)}))
    camera = changed.cameras["c2"]
    before, after = camera.map_from_camera_at(29.9), camera.map_from_camera_at(30.0)
    np.testing.assert_allclose(after.difference(before), by, atol=1e-12)


def test_odometry_shows_nothing_of_a_lift(world: World) -> None:
    changed = with_ways(disturbed(world, Disturbance(lifts={"r1": (Lift(25.0, 7.0),)})))
    stamps_s = np.array([24.99, 25.0])
    jump = changed.map_from_base("r1", stamps_s)
    assert np.linalg.norm(jump[1].translation - jump[0].translation) > 1.0
    log = changed.odometry("r1")
    steps = np.linalg.norm(np.diff(log.poses.translation, axis=0), axis=1)
    assert steps.max() < 0.4 / 50 * 1.1


def test_messages_come_twice_and_late_and_odometry_is_lost(world: World, plain: Simulated) -> None:
    session = simulated(
        world, Disturbance(twice_share=0.3, late_share=0.3, late_s=40.0, gaps_s=((20.0, 22.0),))
    )
    counts = Counter((node, m.stamp_ns) for node, m in sightings(session))
    assert set(counts) == {(node, m.stamp_ns) for node, m in sightings(plain)}
    assert set(counts.values()) == {1, 2}
    stamps_ns = [m.stamp_ns for _, m in sightings(session)]
    assert stamps_ns != sorted(stamps_ns)
    odometry = [m.stamp_ns for _, m in session.messages if isinstance(m, Odometry)]
    assert np.diff(odometry).max() == pytest.approx(2.0e9)


def test_a_camera_takes_no_more_pictures_than_allowed(world: World) -> None:
    session = simulated(world, Disturbance(pictures={"c3": 1, "c4": 0}))
    counts = Counter(node for node, _ in sightings(session))
    assert counts["c3"] == 1
    assert counts["c4"] == 0
    assert counts["c1"] > 1
