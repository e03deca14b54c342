"""Both recursive filters as estimators: a map from nothing, honest, and what they set aside."""

from collections.abc import Callable
from typing import cast

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import (
    EPOCH_NS,
    CameraPlan,
    Session,
    lab_cameras,
    lab_plan,
    live,
    make_session,
    observed,
    pushed,
)

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import ConfigError
from trigpoint.contract import topics
from trigpoint.contract.messages import Message, Odometry, PoseArray, Sightings
from trigpoint.fusion.estimators.filters.replay import Step, contradictions
from trigpoint.fusion.estimators.registry import check_estimator, make_estimator
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.geometry import Pose
from trigpoint.map.network import encode_network

FILTERS = ["ekf", "particle"]


def by(inputs: Inputs, estimator: str, *, seed: int = 0) -> Inputs:
    """The same inputs for another estimator."""
    fusion = msgspec.structs.replace(inputs.site.fusion, estimator=estimator, seed=seed)
    return replace(inputs, site=msgspec.structs.replace(inputs.site, fusion=fusion))


@pytest.fixture(scope="module")
def drive() -> Session:
    """Once around, past each camera, and past the first one again."""
    return make_session(lab_plan("charuco", picture_rate=1.25))


@pytest.fixture(scope="module", params=FILTERS)
def estimator(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def pipeline(drive: Session, estimator: str) -> Pipeline:
    return pushed(by(drive.inputs, estimator), drive.messages)


@pytest.fixture(scope="module")
def found(pipeline: Pipeline) -> Results:
    return pipeline.results()


def test_known_cameras_are_there_from_the_first_odometry_on_also_at_stamp_0(
    drive: Session, estimator: str
) -> None:
    poses = {name: camera.map_from_camera for name, camera in drive.plan.cameras.items()}
    known = KnownCameras(poses, 1e6 * np.eye(6 * len(poses)))
    filter_ = make_estimator(replace(by(drive.inputs, estimator), known=known).data_set())
    assert filter_.located_count == 0
    filter_.add_odometry("r1", Readings.of([Odometry(0, "r1/odom", "r1/base", Pose.identity())]))
    assert filter_.located_count == len(poses)


def test_every_camera_is_found_where_it_is(drive: Session, found: Results) -> None:
    error = drive.error(found)
    assert list(error.cameras) == ["c1", "c2", "c3"]
    assert max(camera.sigmas for camera in error.cameras.values()) < 4
    assert error.nees is not None
    assert error.nees < 2.2  # 18 degrees of freedom: four sigmas of √(2/18) from 1
    assert sum(camera.rejected for camera in found.network.cameras.values()) == 0


@pytest.fixture(scope="module")
def best(drive: Session) -> Results:
    """What the smoother makes of it."""
    return pushed(by(drive.inputs, "smoother"), drive.messages).results()


def test_it_agrees_with_the_smoother(best: Results, found: Results) -> None:
    for name, record in best.network.cameras.items():
        mine = found.network.cameras[name]
        assert mine.map_from_camera is not None
        assert record.map_from_camera is not None
        apart = mine.map_from_camera.pose.difference(record.map_from_camera.pose)
        sigma = np.sqrt(np.diagonal(record.covariance_matrix))
        # Of the same sightings; linearised once, and by 2,000 particles.
        assert np.abs(apart / sigma).max() < 0.6
        ratio = np.sqrt(np.diagonal(mine.covariance_matrix)) / sigma
        np.testing.assert_allclose(ratio, 1.0, atol=0.25)


def test_way_of_the_robot_is_there_at_every_odometry_message(
    drive: Session, found: Results
) -> None:
    stamps_ns, poses = found.trajectories["r1"]
    odometry = [m.stamp_ns for _, m in drive.messages if isinstance(m, Odometry)]
    assert stamps_ns.tolist() == odometry
    truth = np.array([drive.map_from_base("r1", s).translation for s in odometry])
    # 0.4 m/s with the contract's noise drifts by a few centimetres in a round.
    assert np.linalg.norm(poses.translation - truth, axis=1).max() < 0.1


def test_the_same_seed_gives_the_same_bytes_and_another_one_draws_anew(drive: Session) -> None:
    part = drive.messages[: len(drive.messages) // 3]
    first, again, other = (
        encode_network(pushed(by(drive.inputs, "particle", seed=seed), part).results().network)
        for seed in (0, 0, 1)
    )
    assert first == again
    assert first != other


def test_revisit_shrinks_what_is_not_known_of_the_robot(drive: Session) -> None:
    pipeline = Pipeline(by(drive.inputs, "ekf"))
    sigmas: dict[int, float] = {}
    for node, message in drive.messages:
        pipeline.push(node, message)
        pipeline.advance()
        robot = pipeline._estimator.robot("r1")
        if isinstance(message, Odometry) and robot is not None:
            sigmas[message.stamp_ns] = float(np.sqrt(np.trace(robot.covariance[:3, :3])))
    first = [
        m.stamp_ns for n, m in drive.messages if n == "c1" and isinstance(m, Sightings) and m.faces
    ]
    # The last moment before c1 sees it again, a round later, against the one after.
    again = first[int(np.argmax(np.diff(first))) + 1]
    before = max(stamp for stamp in sigmas if stamp < again)
    after = min(stamp for stamp in sigmas if stamp >= again + to_ns(0.05))
    assert sigmas[after] < 0.7 * sigmas[before]


def test_displaced_pictures_are_rejected_and_counted(drive: Session) -> None:
    random, displaced, seen = np.random.default_rng(3), 0, 0
    messages = []
    for node, message in drive.messages:
        if isinstance(message, Sightings) and message.faces:
            seen += 1
            if seen % 9 == 5:
                angle = random.uniform(0, 2 * np.pi)
                shift = np.float32(15) * np.array([np.cos(angle), np.sin(angle)], np.float32)
                faces = tuple(replace(face, pixels=face.pixels + shift) for face in message.faces)
                displaced += len(faces)
                message = replace(message, faces=faces)
        messages.append((node, message))
    results = pushed(by(drive.inputs, "ekf"), tuple(messages)).results()
    assert displaced >= 3
    # One of the three pictures that first locate c2 is among them, and costs one beside it.
    rejected = sum(camera.rejected for camera in results.network.cameras.values())
    assert displaced <= rejected <= displaced + 1
    assert max(camera.sigmas for camera in drive.error(results).cameras.values()) < 4.5


def test_particles_are_said_for_the_robot_alone_by_the_particle_filter(
    drive: Session, estimator: str
) -> None:
    arrivals: list[tuple[int, str, Message]] = [
        (m.stamp_ns, node, m) for node, m in drive.messages[:200]
    ]
    pipeline, sent = live(by(drive.inputs, estimator), arrivals)
    clouds = [(o.node, cast(PoseArray, o.message)) for _, o in sent if o.topic is topics.PARTICLES]
    if estimator == "ekf":
        assert not clouds
        return
    assert {node for node, _ in clouds} == {"r1"}
    seconds = (arrivals[-1][0] - EPOCH_NS) / 1e9
    assert len(clouds) == pytest.approx(2 * seconds, abs=2)
    robot = pipeline._estimator.robot("r1")
    assert robot is not None
    poses = clouds[-1][1].poses
    assert clouds[-1][1].frame_id == "map"
    sigma = np.sqrt(np.diagonal(robot.covariance)[:2])
    apart = poses.translation.mean(axis=0) - robot.map_from_base.translation
    assert (
        np.linalg.norm(apart) < 0.5 * np.linalg.norm(sigma) + 0.25
    )  # half a second ago at 0.4 m/s


def test_sighting_that_comes_late_enters_in_time_order(drive: Session) -> None:
    inputs = by(drive.inputs, "ekf")
    swapped = list(drive.messages)
    rows = [
        i for i, (n, m) in enumerate(swapped) if n == "c1" and isinstance(m, Sightings) and m.faces
    ]
    first = rows[8]
    swapped.insert(first + 60, swapped.pop(first))
    results = [pushed(inputs, tuple(m)).results() for m in (drive.messages, swapped)]
    in_order, late = (r.network.cameras["c1"] for r in results)
    assert late.sightings == in_order.sightings
    assert late.map_from_camera is not None
    assert in_order.map_from_camera is not None
    apart = late.map_from_camera.pose.difference(in_order.map_from_camera.pose)
    assert np.abs(apart / np.sqrt(np.diagonal(in_order.covariance_matrix))).max() < 0.05


@pytest.mark.parametrize(
    ("change", "asked"),
    [
        (lambda c: replace(c, more='intrinsics = "estimate"'), "the intrinsics of camera c1"),
        (lambda c: replace(c, more="time_offset_sigma = 0.1"), "the time offset of camera c1"),
    ],
)
def test_what_the_particle_filter_does_not_work_out_is_refused_by_name(
    change: Callable[[CameraPlan], CameraPlan], asked: str
) -> None:
    cameras = {name: change(camera) for name, camera in lab_cameras().items()}
    site = make_session(lab_plan(cameras=cameras, seconds=0.5)).inputs.site
    fusion = msgspec.structs.replace(site.fusion, estimator="particle")
    with pytest.raises(ConfigError, match=asked):
        check_estimator(msgspec.structs.replace(site, fusion=fusion))


def test_wheels_far_worse_than_said_do_not_make_a_filter_wrong(drive: Session) -> None:
    inputs = by(drive.inputs, "ekf")
    noise = inputs.site.robots["r1"].odometry
    best = {key: value / 30 for key, value in msgspec.structs.asdict(noise).items()}
    robot = msgspec.structs.replace(inputs.site.robots["r1"], odometry=type(noise)(**best))
    site = msgspec.structs.replace(inputs.site, robots={"r1": robot})
    pipeline = pushed(replace(inputs, site=site), drive.messages)
    cameras = drive.error(pipeline.results()).cameras
    assert list(cameras) == ["c1", "c2", "c3"]
    assert max(camera.sigmas for camera in cameras.values()) < 4
    assert "contradictions" not in pipeline.left_out


def test_many_contradictions_in_a_row_are_said(drive: Session) -> None:
    data = observed(drive, most=12)
    for order, entry in enumerate(data.entries):
        verdict = Verdict.REJECTED if 3 <= order < 9 else Verdict.ACCEPTED
        entry.observation = entry.observation.judged(verdict)
    steps = [Step(e.observation.stamp_ns, i, None, None, None) for i, e in enumerate(data.entries)]
    found = contradictions(data, steps)
    assert {each.what for each in found} >= {"of robot r1"}
    assert "contradict the rest" in found[0].text
    assert contradictions(data, steps[:6]) == []


def test_a_drive_without_contradictions_is_not_said_to_have_some(pipeline: Pipeline) -> None:
    assert "contradictions" not in pipeline.left_out
    assert pipeline.last_problem == ""
