"""A fixed map: corrections as good as with learning, from a past that is not kept."""

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from support.fusion.drives import Plan, Session, make_session, pictures_of
from support.fusion.fixed_maps import (
    corrections,
    errors,
    fixed_network,
    held_bytes,
    truth_of,
)

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus, Message
from trigpoint.contract.nudge import NUDGED, Nudge
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.fixed import map as fixed_map
from trigpoint.fusion.fixed.network import FixedNetwork
from trigpoint.fusion.intake import message_intake
from trigpoint.fusion.model.known_cameras import Creep
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.geometry import Pose
from trigpoint.map.network import encode_network

SEED = 7
# Where what the boards look like does not matter.
of_marked_boards = pytest.mark.parametrize("session", ["charuco"], indirect=True)
# A correction in a million is further off by chance, in three dimensions.
FAR = 30.7


@pytest.fixture(scope="module")
def plan(session: Session) -> Plan:
    """Another drive of the same robot past the same cameras."""
    return replace(session.plan, seed=SEED, picture_rate=2.0, seconds=26.0)


@pytest.fixture(scope="module")
def drive(plan: Plan) -> Session:
    return make_session(plan)


@pytest.fixture(scope="module")
def fixed(results: Results) -> FixedNetwork:
    return fixed_network(results)


def moved(plan: Plan, camera: str, by_m: float) -> Plan:
    """The plan with a camera pushed along x."""
    eye = plan.cameras[camera]
    pose = eye.map_from_camera.disturbed(np.array([by_m, 0, 0, 0, 0, 0]))
    return replace(plan, cameras=plan.cameras | {camera: replace(eye, map_from_camera=pose)})


@of_marked_boards
def test_robots_go_on_with_the_noise_that_was_learnt(
    drive: Session, results: Results, fixed: FixedNetwork
) -> None:
    inputs = fixed.inputs(drive.inputs)
    stated, concluded = inputs.data_set().conclusions().noise["r1"], inputs.data_set().conclusions()
    learnt = replace(stated[0], distance=3 * stated[0].distance), 2 * stated[1], 0.02
    held = FixedNetwork.of(results, inputs.site, replace(concluded, noise={"r1": learnt}))
    data = inputs.data_set()
    fixed_map.FixedMap(data, held, lambda: None)
    assert data.conclusions().noise["r1"] == learnt


def test_corrections_are_honest_and_as_good_as_with_learning(
    drive: Session, fixed: FixedNetwork
) -> None:
    held = [m for _, m in corrections(Pipeline(drive.inputs, fixed=fixed), drive.messages)]
    learning = Pipeline(replace(drive.inputs, known=fixed.known))
    learnt = [m for _, m in corrections(learning, drive.messages)]
    apart, chi2 = errors(held, truth_of(drive))
    assert len(held) > 0.9 * len(learnt) > 25
    assert chi2.max() < FAR
    assert 0.4 < chi2.mean() / 3 < 2.0
    own, theirs = (
        np.sqrt(np.mean(e**2, axis=0)) for e in (apart, errors(learnt, truth_of(drive))[0])
    )
    # Learning gets better on the way; what stays is the error of the network that both began with.
    variances = np.diagonal(fixed.covariance).reshape(-1, 6)[:, [0, 1, 5]].max(axis=0)
    assert np.all(own < 2 * np.sqrt(theirs**2 + variances))


@of_marked_boards
def test_network_stays_to_the_byte(drive: Session, fixed: FixedNetwork) -> None:
    before, covariance = encode_network(fixed.network), fixed.covariance.copy()
    pipeline = Pipeline(drive.inputs, fixed=fixed)
    corrections(pipeline, drive.messages)
    pipeline.finish()
    results = pipeline.results()
    assert encode_network(results.network) == before
    np.testing.assert_array_equal(results.covariance, covariance)
    assert str(pipeline.map_id) == fixed.network.map_id
    assert pipeline.reports.is_final


@pytest.mark.parametrize("by_m", [0.2, 1.0])
def test_camera_that_was_moved_makes_no_wrong_correction_and_is_said(
    plan: Plan, fixed: FixedNetwork, by_m: float
) -> None:
    session = make_session(moved(plan, "c2", by_m))
    pipeline = Pipeline(session.inputs, fixed=fixed)
    told = corrections(pipeline, session.messages)
    assert errors([m for _, m in told], truth_of(session))[1].max() < FAR
    assert len(told) > 15  # by the two others
    assert pipeline.left_out["against_the_map"] > 3
    assert "camera c2 sees r1 elsewhere" in pipeline.problems["against_the_map c2"].text


@of_marked_boards
def test_each_camera_that_contradicts_the_map_is_named(drive: Session, fixed: FixedNetwork) -> None:
    pipeline = Pipeline(drive.inputs, fixed=fixed)
    first_ns = drive.messages[0][1].stamp_ns  # pyright: ignore
    for camera in ("c2", "c3"):
        nudge = Nudge(camera, first_ns - to_ns(1.0), first_ns)
        status = DiagnosticStatus(0, f"edge/{camera}", "", "host", {NUDGED: nudge.value})
        pipeline.push("", Diagnostics(first_ns, (status,)))
    corrections(pipeline, drive.messages)
    for camera in ("c2", "c3"):
        said = pipeline.problems[f"against_the_map {camera}"].text
        assert f"camera {camera} noticed that it was moved" in said


@of_marked_boards
def test_camera_that_says_that_it_was_moved_makes_no_correction(
    drive: Session, fixed: FixedNetwork
) -> None:
    pipeline = Pipeline(drive.inputs, fixed=fixed)
    messages, half = drive.messages, len(drive.messages) // 2
    before = {camera for camera, _ in corrections(pipeline, messages[:half])}
    now_ns = messages[half][1].stamp_ns  # pyright: ignore
    nudge = Nudge("c2", now_ns - to_ns(1.0), now_ns)
    status = DiagnosticStatus(0, "edge/c2", "", "host", {NUDGED: nudge.value})
    pipeline.push("", Diagnostics(now_ns, (status,)))
    after = {camera for camera, _ in corrections(pipeline, messages[half:])}
    assert "c2" in before
    assert after
    assert "c2" not in after
    assert "camera c2 noticed that it was moved" in pipeline.problems["against_the_map c2"].text
    assert list(pipeline.nudges.open) == ["c2"]
    assert "until the map is learnt anew" in pipeline.nudges.open["c2"]


def test_robot_that_began_before_a_moved_camera_is_found_out_by_the_others(
    plan: Plan, fixed: FixedNetwork
) -> None:
    """With one camera against one nobody is believed; with two against it, the two are."""
    session = make_session(moved(replace(plan, seconds=40.0), "c1", 0.2))
    pipeline = Pipeline(session.inputs, fixed=fixed)
    messages = session.messages
    second = to_ns(5.5)  # c2 has contradicted by then
    start_ns = messages[0][1].stamp_ns
    until = next(i for i, (_, m) in enumerate(messages) if m.stamp_ns - start_ns > second)
    corrections(pipeline, messages[:until])
    told = [m for _, m in corrections(pipeline, messages[until:])]
    assert errors(told, truth_of(session))[1].max() < FAR
    assert len(told) > 10
    assert "camera c1 sees r1 elsewhere" in pipeline.problems["against_the_map c1"].text


def test_lifted_robot_is_corrected_again_once_two_cameras_agree(
    plan: Plan, fixed: FixedNetwork
) -> None:
    session = make_session(replace(plan, seconds=32.0))
    cut, elsewhere = round(13.0 / 0.025), Pose.planar(0.3, 0.1, 0.3)
    before = truth_of(session)
    poses = [before[index] for index in range(len(before))]
    truth = Pose.stack([*poses[:cut], *(elsewhere @ pose for pose in poses[cut:])])
    seen = [(m.stamp_ns, 1, n, m) for n, m in pictures_of(session.plan, {"r1": truth})]
    drove = [(m.stamp_ns, 0, n, m) for n, m in session.messages if n == "r1"]
    ordered = sorted([*drove, *seen], key=lambda item: item[:3])
    messages: list[tuple[str, Message]] = [(node, message) for *_, node, message in ordered]
    told = [m for _, m in corrections(Pipeline(session.inputs, fixed=fixed), messages)]
    assert errors(told, truth)[1].max() < FAR
    lifted_ns = messages[0][1].stamp_ns + to_ns(13.0)  # pyright: ignore
    assert sum(m.stamp_ns > lifted_ns for m in told) > 10


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds that are reached within seconds, as the real ones are within minutes."""
    monkeypatch.setattr(fixed_map, "MOST_ODOMETRY", 128)
    monkeypatch.setattr(message_intake, "_REMEMBERED", 8)


@of_marked_boards
@pytest.mark.usefixtures("few")
def test_ten_times_the_sightings_take_no_more_memory(plan: Plan, fixed: FixedNetwork) -> None:
    session = make_session(replace(plan, seconds=120.0))
    pipeline = Pipeline(session.inputs, fixed=fixed)
    tenth = len(session.messages) // 10
    sizes, counts = [], []
    for part in range(10):
        told = corrections(pipeline, session.messages[part * tenth : (part + 1) * tenth])
        counts.append(len(told))
        sizes.append(held_bytes([pipeline._intake, pipeline._estimator, pipeline._data]))
    assert min(counts) > 4
    assert max(sizes[1:]) < 1.05 * sizes[0]
    assert len(pipeline._data.tracks["r1"]) <= 128


@of_marked_boards
@pytest.mark.usefixtures("few")
def test_corrections_are_the_same_where_the_past_is_dropped_early(
    drive: Session, fixed: FixedNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    dropped = corrections(Pipeline(drive.inputs, fixed=fixed), drive.messages)
    monkeypatch.setattr(fixed_map, "MOST_ODOMETRY", 1 << 20)
    kept = corrections(Pipeline(drive.inputs, fixed=fixed), drive.messages)
    assert [m.stamp_ns for _, m in dropped] == [m.stamp_ns for _, m in kept]
    for (_, mine), (_, other) in zip(dropped, kept, strict=True):
        sigmas = np.sqrt(np.diagonal(other.covariance)[[0, 1, 5]])
        apart = mine.pose.difference(other.pose)[[0, 1, 5]]
        assert np.abs(apart / sigmas).max() < 0.05


@of_marked_boards
def test_sightings_of_a_camera_that_the_map_does_not_have_are_counted(
    drive: Session, results: Results
) -> None:
    cameras = dict(results.network.cameras)
    cameras["c3"] = structs.replace(
        cameras["c3"], status="unseen", map_from_camera=None, covariance=None
    )
    without = replace(
        results,
        network=structs.replace(results.network, cameras=cameras),
        covariance=results.covariance[:12, :12],
    )
    pipeline = Pipeline(drive.inputs, fixed=fixed_network(without))
    told = corrections(pipeline, drive.messages)
    assert told
    assert "c3" not in {node for node, _ in told if node != "r1"}
    assert pipeline.left_out["not_in_the_map"] > 10


@of_marked_boards
def test_corrections_widen_as_the_cameras_creep(drive: Session, fixed: FixedNetwork) -> None:
    """After a year, with nothing learnt: by as much as a camera may have crept."""
    creep = Creep(2e-4, 2e-4)
    year_ns = 365 * 86_400 * 10**9
    until_ns = drive.messages[0][1].stamp_ns - year_ns  # pyright: ignore
    known = replace(fixed.known, until_ns=until_ns, creep=dict.fromkeys(fixed.known.poses, creep))
    sigmas = []
    for each in (fixed, replace(fixed, known=known)):
        pipeline = Pipeline(drive.inputs, fixed=each)
        told = [m for _, m in corrections(pipeline, drive.messages)]
        sigmas.append(np.sqrt([np.trace(m.covariance[:2, :2]) for m in told]))
        cameras = pipeline._estimator.cameras()
    crept_m = 2e-4 * np.sqrt(365)
    assert sigmas[1].min() > crept_m
    assert sigmas[0].min() < 0.5 * crept_m
    before, after = fixed.estimates(fixed.known), cameras
    added = after["c1"].covariance - before["c1"].covariance
    np.testing.assert_allclose(np.diagonal(added), 365 * 2e-4**2, rtol=1e-3)
