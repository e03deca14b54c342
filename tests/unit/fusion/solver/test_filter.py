"""What a batch solution knows, carried on sighting by sighting, against the batch over all."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import Session
from support.fusion.small_problems import EPOCH_NS, first_state, small_data, true_pose

from trigpoint.base.clock import to_ns
from trigpoint.fusion.estimators.robot_alignment import align_before, camera_sigma_px
from trigpoint.fusion.estimators.smoother.smoother import Smoother
from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.fusion.reading.alignment import _Search
from trigpoint.fusion.solver.equations import EXACT
from trigpoint.fusion.solver.filter import Filter, carried_on
from trigpoint.fusion.solver.gaussian import Gaussian
from trigpoint.fusion.solver.levenberg_marquardt import linearise
from trigpoint.geometry import Pose

BATCH = 6  # so many observations are solved together, the others come one by one


def batch_filter(data: DataSet, count: int) -> Filter:
    """The filter after a batch over the first observations, at the fixed point of the guesses."""
    assembled = assemble(data, first_state(data), list(range(count)))
    reduced = linearise(assembled.problem, assembled.start).reduced()
    return Filter.after(assembled.start, assembled.problem, reduced)


@pytest.fixture(scope="module", params=["map held by the first pose", "map held by known cameras"])
def data(request: pytest.FixtureRequest) -> DataSet:
    return small_data(known="known" in request.param, noise_px=0.2)


def stepwise(data: DataSet) -> Filter:
    current = batch_filter(data, BATCH)
    for entry in data.entries[BATCH:]:
        observation, guess = entry.observation, entry.map_from_base
        assert guess is not None
        current = current.advanced(data, observation.robot, observation.stamp_ns, guess)
        current, _ = current.updated(data, observation)
    return current


def test_steps_end_where_the_batch_over_everything_ends(data: DataSet) -> None:
    whole, current = batch_filter(data, len(data.entries)), stepwise(data)
    assert current.stamps_ns == whole.stamps_ns
    covariance = whole.reduced.covariance()
    sigma = np.sqrt(np.diagonal(covariance))
    # The same sums in another order: what is left is rounding over the EXACT first pose.
    apart = (current.known.mean - whole.known.mean) / sigma
    np.testing.assert_allclose(apart, 0.0, atol=1e-4)
    ratio = current.reduced.covariance() / sigma[:, None] / sigma
    np.testing.assert_allclose(ratio, covariance / sigma[:, None] / sigma, atol=1e-4)


def test_order_of_two_robots_steps_does_not_matter(data: DataSet) -> None:
    ends = []
    for order in ((BATCH, BATCH + 1), (BATCH + 1, BATCH)):
        current = batch_filter(data, BATCH)
        for index in order:
            entry = data.entries[index]
            assert entry.map_from_base is not None
            robot, stamp_ns = entry.observation.robot, entry.observation.stamp_ns
            current = current.advanced(data, robot, stamp_ns, entry.map_from_base)
            current, _ = current.updated(data, entry.observation)
        ends.append(current)
    scale = 1 / np.sqrt(np.diagonal(ends[0].reduced.information))
    informations = [f.reduced.information * scale[:, None] * scale for f in ends]
    np.testing.assert_allclose(informations[0], informations[1], atol=1e-7)


def test_earlier_filter_is_left_as_it_was(data: DataSet) -> None:
    before = batch_filter(data, BATCH)
    information = before.reduced.information.copy()
    entry = data.entries[BATCH]
    assert entry.map_from_base is not None
    robot, stamp_ns = entry.observation.robot, entry.observation.stamp_ns
    moved = before.advanced(data, robot, stamp_ns, entry.map_from_base)
    moved.updated(data, entry.observation)
    np.testing.assert_array_equal(before.reduced.information, information)
    assert before.stamps_ns[robot] < moved.stamps_ns[robot]


def test_guess_moves_the_fixed_point_and_not_the_estimate(data: DataSet) -> None:
    before, entry = batch_filter(data, BATCH), data.entries[BATCH]
    assert entry.map_from_base is not None
    robot, stamp_ns = entry.observation.robot, entry.observation.stamp_ns
    tangent, off = data.tracks[robot].tangent, np.zeros(6)
    off[tangent] = 1e-3
    guesses = (entry.map_from_base, entry.map_from_base.disturbed(off))
    found = [before.advanced(data, robot, stamp_ns, guess).robot(data, robot) for guess in guesses]
    # A milliradian off, on the centimetres by which the estimate is not at the fixed point.
    np.testing.assert_allclose(
        found[0].map_from_base.difference(found[1].map_from_base), 0.0, atol=2e-5
    )


def test_robot_ahead_of_its_last_node_is_dead_reckoned_with_what_the_scales_add(
    data: DataSet,
) -> None:
    before, entry = batch_filter(data, BATCH), data.entries[BATCH]
    robot, stamp_ns = entry.observation.robot, entry.observation.stamp_ns
    found = before.robot(data, robot, stamp_ns)
    assert found.stamp_ns == stamp_ns
    plain = carried_on(data, robot, before.robot(data, robot), stamp_ns, before.scales(robot))
    layout, step = before.reduced.layout, before.known.mean
    motion = data.tracks[robot].motion(
        np.array([before.stamps_ns[robot], stamp_ns]), before.scales(robot)
    )
    shift = motion.by_scale[0, :3] @ step[layout.scales[robot]]
    start = before.robot(data, robot).map_from_base
    expected = plain.map_from_base.translation + start.rotation @ shift
    # The scales' step of a percent over a step of decimetres is a millimetre; of that a few
    # hundredths are left, as it turns with the estimate.
    assert np.linalg.norm(shift) > 1e-4
    np.testing.assert_allclose(found.map_from_base.translation, expected, atol=5e-5)
    tangent = data.tracks[robot].tangent
    assert not np.allclose(
        found.covariance[np.ix_(tangent, tangent)],
        plain.covariance[np.ix_(tangent, tangent)],
        rtol=1e-3,
        atol=0,
    )


def test_robot_carried_on_message_by_message_is_that_carried_on_at_once(data: DataSet) -> None:
    before = batch_filter(data, BATCH)
    for robot in data.tracks:
        end_ns = data.tracks[robot].last_ns
        steps = before
        for stamp_ns in np.linspace(before.stamps_ns[robot], end_ns, 6).astype(int)[1:]:
            steps = steps.carried(data, robot, int(stamp_ns))
        found, once = steps.robot(data, robot), before.robot(data, robot, end_ns)
        tangent = data.tracks[robot].tangent
        sigma = np.sqrt(np.diagonal(once.covariance)[tangent])
        apart = found.map_from_base.difference(once.map_from_base)[tangent] / sigma
        # Of second order: the scales' step of a percent, on the way of half a metre.
        np.testing.assert_allclose(apart, 0.0, atol=0.02)
        spread = np.sqrt(np.diagonal(found.covariance)[tangent])
        np.testing.assert_allclose(spread / sigma, 1.0, atol=0.01)
        assert steps.carried(data, robot, end_ns - 1) is steps


def test_surprise_is_the_rise_of_the_least_cost(data: DataSet) -> None:
    current = batch_filter(data, BATCH)
    surprises, corners = [], []
    for entry in data.entries[BATCH:]:
        observation = entry.observation
        assert entry.map_from_base is not None
        current = current.advanced(
            data, observation.robot, observation.stamp_ns, entry.map_from_base
        )
        current, surprise = current.updated(data, observation)
        surprises.append(surprise)
        corners.append(2 * observation.corner_count)
    freedom = sum(corners)
    # χ² of as many degrees of freedom as numbers, whose sigma is √(2·dof); five of them. Odometry
    # without noise makes it a little smaller.
    assert abs(sum(surprises) - freedom) < 5 * np.sqrt(2 * freedom)


def test_wild_sighting_is_a_surprise(data: DataSet) -> None:
    entry = data.entries[BATCH]
    observation = entry.observation
    assert entry.map_from_base is not None
    views = tuple(
        type(view)(view.corners, view.pixels + 15.0, view.sigma, view.readings)
        for view in observation.views
    )
    wild = type(observation)(
        observation.camera, observation.robot, observation.stamp_ns, views, observation.chosen
    )
    moved = batch_filter(data, BATCH).advanced(
        data, observation.robot, observation.stamp_ns, entry.map_from_base
    )
    surprises = [moved.updated(data, seen)[1] for seen in (observation, wild)]
    assert surprises[0] < 3 * 2 * observation.corner_count < surprises[1]


def test_origin_holds_the_first_robot_and_no_other() -> None:
    data = small_data()
    start = Filter.at_origin(data)
    assert start.has_robot("r1")
    assert not start.has_robot("r2")
    assert not start.has_camera("c1")
    found = start.robot(data, "r1")
    assert found.stamp_ns == EPOCH_NS
    np.testing.assert_allclose(found.covariance[0, 0], 1 / EXACT)
    stamp_ns = EPOCH_NS + to_ns(1.0)
    later = start.robot(data, "r1", stamp_ns)
    np.testing.assert_allclose(
        later.map_from_base.difference(true_pose(data, "r1", stamp_ns)), 0.0, atol=1e-9
    )
    assert later.covariance[0, 0] > 1e-6
    assert np.abs(later.covariance[[2, 3, 4]]).max() < 1e-12


def test_known_cameras_are_there_from_the_start_with_their_joint_covariance() -> None:
    data = small_data(known=True)
    start = Filter.at_origin(data)
    assert not start.has_robot("r1")
    found = start.reduced.covariance()
    expected = np.linalg.inv(data.known.information)
    sigma = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        found / sigma[:, None] / sigma, expected / sigma[:, None] / sigma, atol=1e-9
    )


def test_estimate_carried_on_twice_is_that_carried_on_once() -> None:
    data = small_data()
    for robot in data.tracks:
        stamps = [EPOCH_NS + to_ns(seconds) for seconds in (1.0, 1.7, 2.55)]
        begin = Filter.at_origin(data).robot(data, "r1", stamps[0])
        begin = type(begin)(stamps[0], true_pose(data, robot, stamps[0]), begin.covariance)
        once = carried_on(data, robot, begin, stamps[2], np.zeros(2))
        half = carried_on(data, robot, begin, stamps[1], np.zeros(2))
        twice = carried_on(data, robot, half, stamps[2], np.zeros(2))
        np.testing.assert_allclose(
            once.map_from_base.difference(twice.map_from_base), 0.0, atol=1e-12
        )
        # The second starts on a message, so no increment is cut.
        np.testing.assert_allclose(once.covariance, twice.covariance, rtol=1e-6, atol=1e-12)
        assert carried_on(data, robot, once, stamps[0], np.zeros(2)) is once


def test_camera_sigma_grows_with_its_turn_and_falls_with_distance(data: DataSet) -> None:
    current = batch_filter(data, len(data.entries))
    covariance = current.known.covariance_of(current.layout.pose["c1"])
    lens = current.state.cameras["c1"].lens
    near, far = (camera_sigma_px(lens, covariance, distance) for distance in (1.0, 4.0))
    turn_px = lens.fx * np.sqrt(np.diagonal(covariance)[3:].max())
    assert near > far >= turn_px
    assert isinstance(current.state.cameras["c1"].map_from_camera, Pose)


def shaken(current: Filter, data: DataSet) -> Filter:
    """The same, but that it is not known by a metre and 0.02 rad where the map as a whole is."""
    together, step = np.zeros((current.layout.size, 3)), current.known.mean
    places = []
    for name, columns in current.layout.pose.items():
        pose = current.state.cameras[name].map_from_camera.disturbed(step[columns])
        places.append((columns, pose, range(6)))
    for robot, columns in current.layout.last.items():
        pose = current.robot(data, robot).map_from_base
        places.append((columns, pose, data.tracks[robot].tangent))
    for columns, pose, tangent in places:
        turned = np.cross([0.0, 0.0, 1.0], pose.translation)
        moves = np.zeros((6, 3))
        moves[0, 0] = moves[1, 1] = moves[5, 2] = 1.0
        moves[:3, 2] = turned
        together[columns] = moves[list(tangent)]
    known = current.known
    covariance = known.covariance + together @ np.diag([1.0, 1.0, 0.02**2]) @ together.T
    return replace(current, source=Gaussian.of(known.mean, covariance))


def test_where_a_camera_has_a_robot_is_known_however_little_of_the_map_is(data: DataSet) -> None:
    current, entry = batch_filter(data, BATCH), data.entries[BATCH]
    robot, camera = entry.observation.robot, entry.observation.camera
    wide = shaken(current, data)
    for stamp_ns in (current.stamps_ns[robot], entry.observation.stamp_ns):
        found, expected = (at.before(data, robot, camera, stamp_ns) for at in (wide, current))
        sigma = np.sqrt(np.diagonal(expected))
        np.testing.assert_allclose((found - expected) / sigma[:, None] / sigma, 0.0, atol=0.02)
        assert wide.robot(data, robot, stamp_ns).covariance[0, 0] > 1.0


def test_where_a_camera_has_a_robot_follows_both_disturbances(data: DataSet) -> None:
    """At the last node, against finite differences of where the camera takes the robot along."""
    current, entry = batch_filter(data, BATCH), data.entries[BATCH]
    robot, camera = entry.observation.robot, entry.observation.camera
    place = current.robot(data, robot)
    step = current.known.mean[current.layout.pose[camera]]
    eye = current.state.cameras[camera].map_from_camera.disturbed(step)
    base = place.map_from_base
    by_camera = np.stack(
        [
            base.difference(eye.disturbed(step) @ eye.inverse() @ base) / 1e-6
            for step in 1e-6 * np.eye(6)
        ],
        axis=1,
    )
    by_robot = np.eye(6)[:, data.tracks[robot].tangent]
    columns = np.concatenate([current.layout.last[robot], current.layout.pose[camera]])
    jacobian = np.concatenate([by_robot, by_camera], axis=1)
    expected = jacobian @ current.known.covariance[np.ix_(columns, columns)] @ jacobian.T
    sigma = np.sqrt(np.diagonal(expected))
    found = current.before(data, robot, camera, place.stamp_ns)
    np.testing.assert_allclose((found - expected) / sigma[:, None] / sigma, 0.0, atol=1e-4)


def test_sighting_is_read_where_the_camera_has_the_robot(
    charuco: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a map that is known too little as a whole to tell where the robot may be."""
    pipeline = Pipeline(charuco.inputs)
    for node, message in charuco.messages[: len(charuco.messages) // 2]:
        pipeline.push(node, message)
        pipeline.advance()
    smoother = pipeline._estimator
    assert isinstance(smoother, Smoother)
    current, entry = smoother.current.known, smoother.data.entries[-1]
    assert current is not None
    assert entry.map_from_base is not None
    wide = shaken(current, smoother.data)
    predicted = wide.robot(smoother.data, "r1")
    monkeypatch.setattr(_Search, "everywhere", lambda _: pytest.fail("it looked everywhere"))
    unread = replace(entry.observation, chosen=None, outliers=())
    found = align_before(smoother.data, wide, unread, predicted)
    assert found is not None
    assert found.readings == entry.observation.chosen
    apart = found.map_from_base.difference(entry.map_from_base)
    np.testing.assert_allclose(apart, 0.0, atol=0.02)
