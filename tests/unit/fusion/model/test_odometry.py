"""Motion between any two moments, and its covariance by the contract's noise model."""

from functools import reduce
from operator import matmul

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.motion import Motion
from trigpoint.fusion.model.odometry import Added, OdometryTrack
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise

PERIOD_NS = to_ns(0.05)
NO_SCALES = np.zeros(2)
NOISE = OdometryNoise()
SPATIAL_NOISE = OdometryNoise(vertical=0.003, tilt=0.002, tilt_turn=0.004)
# What the track adds so that information stays finite, see odometry_track.
FLOOR = 1e-13


def way(count: int, *, planar: bool, seed: int = 3) -> Pose:
    """A winding way of `count` messages with steps of a few centimetres and degrees."""
    random = np.random.default_rng(seed)
    steps = random.normal(0.0, [0.01, 0.004, 0.004, 0.02, 0.02, 0.05], (count - 1, 6))
    steps[:, 0] += 0.02
    if planar:
        steps[:, 2:5] = 0.0
    poses = [Pose.identity()]
    for step in steps:
        poses.append(poses[-1] @ Pose.from_vector(step))
    return Pose.stack(poses)


def track_of(poses: Pose, *, planar: bool, noise: OdometryNoise = NOISE) -> OdometryTrack:
    track = OdometryTrack(noise, planar=planar, slip=0.0)
    for index in range(len(poses)):
        assert track.add(index * PERIOD_NS, poses[index]) is Added.TAKEN
    return track


def moments(*messages: float) -> np.ndarray:
    """Stamps of messages by number, and of what lies between them."""
    return np.array([round(number * PERIOD_NS) for number in messages], dtype=np.int64)


def assert_same(first: Pose, second: Pose, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(first.difference(second), 0.0, atol=tolerance)


@pytest.mark.parametrize("planar", [True, False])
def test_motion_between_messages_is_what_they_report(planar: bool) -> None:
    poses = way(40, planar=planar)
    motion = track_of(poses, planar=planar).motion(moments(0, 7, 8, 39), NO_SCALES)
    for index, (start, end) in enumerate([(0, 7), (7, 8), (8, 39)]):
        assert_same(motion.earlier_from_later[index], poses[start].inverse() @ poses[end])


@pytest.mark.parametrize("planar", [True, False])
@given(
    numbers=st.lists(st.floats(0.0, 39.0), min_size=2, max_size=8, unique=True),
    scales=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)),
)
def test_parts_of_an_interval_compose_to_the_whole(
    planar: bool, numbers: list[float], scales: tuple[float, float]
) -> None:
    track = track_of(way(40, planar=planar), planar=planar)
    stamps = np.unique(moments(*sorted(numbers)))
    if len(stamps) < 2:
        return
    parts = track.motion(stamps, np.array(scales)).earlier_from_later
    whole = track.motion(stamps[[0, -1]], np.array(scales)).earlier_from_later
    assert_same(reduce(matmul, (parts[i] for i in range(len(parts)))), whole[0], 1e-10)


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize(
    # Between messages the parts of one increment, of 39, have middles of their own: up to half its
    # turn of 0.1 rad from the whole's, so the two agree to 0.05 / 39 of a variance.
    ("number", "tolerance"),
    [(1, 1e-9), (20, 1e-9), (38, 1e-9), (0.5, 2e-3), (17.3, 2e-3), (38.9, 2e-3)],
)
def test_covariances_of_two_parts_add_up_to_the_wholes(
    planar: bool, number: float, tolerance: float
) -> None:
    track = track_of(way(40, planar=planar), planar=planar, noise=SPATIAL_NOISE)
    stamps = moments(0, number, 39)
    parts, whole = track.motion(stamps, NO_SCALES), track.motion(stamps[[0, 2]], NO_SCALES)
    first, second = parts.earlier_from_later[0], parts.earlier_from_later[1]
    carried = carry(first.rotation @ second.translation)
    turn = np.kron(np.eye(2), first.rotation)
    expected = carried @ parts.covariance[0] @ carried.T + turn @ parts.covariance[1] @ turn.T
    root = np.linalg.inv(np.linalg.cholesky(expected))
    # The floor is added to each part, and is at most 1e-13 of (0.5 mm)².
    whitened = root @ whole.covariance[0] @ root.T
    np.testing.assert_allclose(whitened, np.eye(6), atol=tolerance + 1e-6)


def carry(arm: Array) -> Array:
    """A disturbance of the start of a step moves its end by this: t' = t + δt + δθ × arm."""
    matrix = np.eye(6)
    matrix[:3, 3:] = -so3.hat(arm)
    return matrix


def noise_factor(twist: Array, noise: OdometryNoise) -> Array:
    """Root (6, 6) of the covariance of a step by the contract, section 2."""
    length, turned = np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])
    along = np.sqrt(length) * np.diag([noise.distance, noise.lateral, noise.vertical])
    tilt = np.sqrt(noise.tilt**2 * length + noise.tilt_turn**2 * turned)
    heading = np.sqrt(noise.heading_drive**2 * length + noise.heading_turn**2 * turned)
    root = np.zeros((6, 6))
    root[:3, :3] = so3.exp(0.5 * twist[3:]) @ along
    root[[3, 4, 5], [3, 4, 5]] = [tilt, tilt, heading]
    return root


def twists_between(poses: Pose, start: float, end: float) -> list[Array]:
    """The twist of every message's increment, or the part of it that lies between two numbers."""
    found = []
    for index in range(int(start), int(np.ceil(end))):
        step = poses[index].inverse() @ poses[index + 1]
        turn = so3.log(step.rotation)
        twist = np.concatenate([np.linalg.solve(so3.left_jacobian(turn), step.translation), turn])
        found.append(twist * (min(end, index + 1) - max(start, index)))
    return found


def exponential(twist: Array) -> Pose:
    return Pose(so3.exp(twist[3:]), so3.left_jacobian(twist[3:]) @ twist[:3])


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize(("start", "end"), [(0, 30), (3.3, 25.75), (4.2, 4.9), (4.5, 5.5)])
def test_covariance_is_that_of_a_recursion_step_by_step(
    planar: bool, start: float, end: float
) -> None:
    poses = way(40, planar=planar)
    track = track_of(poses, planar=planar, noise=SPATIAL_NOISE)
    covariance, frame = np.zeros((6, 6)), np.eye(3)
    for twist in twists_between(poses, start, end):
        step = exponential(twist)
        moved = carry(frame @ step.translation)
        root = np.kron(np.eye(2), frame) @ noise_factor(twist, SPATIAL_NOISE)
        covariance = moved @ covariance @ moved.T + root @ root.T
        frame = frame @ step.rotation
    found = track.motion(moments(start, end), NO_SCALES).covariance[0]
    np.testing.assert_allclose(found, covariance, rtol=1e-9, atol=2 * FLOOR)


@pytest.mark.parametrize("planar", [True, False])
def test_covariance_is_the_spread_of_many_drives_by_the_contracts_noise(planar: bool) -> None:
    poses = way(40, planar=planar)
    noise = NOISE if planar else SPATIAL_NOISE
    track = track_of(poses, planar=planar, noise=noise)
    start, end, count = 2.4, 37.7, 4000
    random = np.random.default_rng(5)
    drives = Pose(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
    for twist in twists_between(poses, start, end):
        shaken = random.standard_normal((count, 6)) @ noise_factor(twist, noise).T
        drives = drives @ exponential(twist).disturbed(shaken)
    motion = track.motion(moments(start, end), NO_SCALES)
    errors = drives.difference(motion.earlier_from_later[0])[:, track.tangent]
    predicted = motion.covariance[0][np.ix_(track.tangent, track.tangent)]
    # Whitened by the prediction, a sample variance has a standard deviation of √(2/4000) = 2.2 %
    # and a correlation of 1.6 %; five of these, and 1 % for what is not linear.
    root = np.linalg.cholesky(predicted)
    spread = np.cov(np.linalg.solve(root, errors.T))
    np.testing.assert_allclose(np.diagonal(spread), 1.0, atol=5 * 0.022 + 0.01)
    off_diagonal = spread - np.diag(np.diagonal(spread))
    np.testing.assert_allclose(off_diagonal, 0.0, atol=5 * 0.016 + 0.01)


@pytest.mark.parametrize("planar", [True, False])
def test_scale_errors_move_the_motion_as_finite_differences_say(planar: bool) -> None:
    track, stamps = track_of(way(40, planar=planar), planar=planar), moments(1.3, 20, 38.6)
    scales, step = np.array([0.04, -0.03]), 1e-5
    motion = track.motion(stamps, scales)
    for column in range(2):
        change = np.eye(2)[column] * step
        upper = track.motion(stamps, scales + change).earlier_from_later
        lower = track.motion(stamps, scales - change).earlier_from_later
        slope = upper.difference(lower) / (2 * step)
        # The centred difference is exact to the square of the step, over metres and radians.
        np.testing.assert_allclose(motion.by_scale[..., column], slope, atol=1e-8)
        rescaled = motion.earlier_from_later.disturbed(motion.by_scale @ change)
        np.testing.assert_allclose(rescaled.difference(upper), 0.0, atol=1e-8)


def test_slip_adds_to_a_turn_on_the_spot_alone() -> None:
    noise, turn, slip = OdometryNoise(0, 0, 0, 0), 0.3, 0.001
    track = OdometryTrack(noise, planar=True, slip=slip)
    for index, heading in enumerate([0.0, turn]):
        track.add(index * PERIOD_NS, Pose.planar(0.0, 0.0, heading))
    covariance = track.motion(moments(0, 1), NO_SCALES).covariance[0]
    expected = [slip**2 * turn] * 2
    np.testing.assert_allclose(np.diagonal(covariance)[:2], expected, atol=2 * FLOOR)


def test_robot_that_stands_is_still_and_one_that_creeps_is_not() -> None:
    track = track_of(Pose.planar([0, 0, 0, 1e-5, 1e-5], 0.0, 0.0), planar=True)
    still = track.motion(moments(0, 1.5, 2, 3, 4), NO_SCALES).is_still
    assert still.tolist() == [True, True, False, True]


@pytest.mark.parametrize("stamp_ns", [PERIOD_NS, 0])
def test_stale_message_is_refused_and_changes_nothing(stamp_ns: int) -> None:
    track = track_of(way(2, planar=True), planar=True)
    before = track.motion(moments(0, 1), NO_SCALES).earlier_from_later
    assert track.add(stamp_ns, Pose.planar(3.0, 0.0, 0.0)) is Added.STALE
    assert (len(track), track.last_ns) == (2, PERIOD_NS)
    assert_same(track.motion(moments(0, 1), NO_SCALES).earlier_from_later, before)


@pytest.mark.parametrize(
    "landed", [Pose.planar(2.0, 0.0, 0.0), Pose.planar(0.0, 0.0, 2.0), Pose.planar(-5.0, 1.0, 1.0)]
)
def test_jump_says_nothing_of_where_the_robot_is(landed: Pose) -> None:
    track = track_of(Pose.planar([-0.02, 0.0], 0.0, 0.0), planar=True)
    assert track.add(2 * PERIOD_NS, landed) is Added.JUMP
    track.add(3 * PERIOD_NS, landed @ Pose.planar(0.02, 0.0, 0.0))
    motion = track.motion(moments(0, 1, 2, 3), NO_SCALES)
    assert [is_wide(motion, row) for row in range(3)] == [False, True, False]
    assert not motion.is_still[1]
    assert_same(motion.earlier_from_later[2], Pose.planar(0.02, 0.0, 0.0))
    across = track.motion(moments(0.5, 2.5), NO_SCALES)
    assert is_wide(across, 0)


@pytest.mark.parametrize(("fastest", "outcome"), [(10.0, Added.TAKEN), (3.0, Added.JUMP)])
def test_a_robot_may_drive_as_fast_as_its_site_file_says(fastest: float, outcome: Added) -> None:
    track = OdometryTrack(NOISE, planar=True, fastest=(fastest, 6.0))
    track.add(0, Pose.identity())
    assert track.add(to_ns(0.5), Pose.planar(4.0, 0.0, 0.0)) is outcome


def is_wide(motion: Motion, row: int) -> bool:
    """Whether nothing useful is known of a motion: a sigma of a room and of a turn at least."""
    sigmas = np.sqrt(np.diagonal(motion.covariance[row])[[0, 1, 5]])
    return bool(np.all(sigmas > [10.0, 10.0, 3.0]))


def with_gap(gap_s: float, *, share: float) -> tuple[OdometryTrack, Added]:
    """A robot at 0.4 m/s whose odometry is away; it comes `share` of the way it drove before."""
    track = OdometryTrack(NOISE, planar=True)
    for index in range(21):
        track.add(index * PERIOD_NS, Pose.planar(0.02 * index, 0.0, 0.0))
    end = Pose.planar(0.4 + share * 0.4 * gap_s, 0.0, 0.0)
    return track, track.add(20 * PERIOD_NS + to_ns(gap_s), end)


def test_gap_on_the_way_is_as_uncertain_as_bends_that_nobody_saw() -> None:
    track, added = with_gap(2.0, share=1.0)
    assert added is Added.TAKEN
    ends = np.array([20 * PERIOD_NS, track.last_ns])
    motion = track.motion(ends, NO_SCALES)
    np.testing.assert_allclose(motion.earlier_from_later.translation[0], [0.8, 0.0, 0.0], atol=1e-9)
    # 0.8 m at the tightest bends of 0.5 m radius are 1.6 rad.
    turned = NOISE.heading_drive**2 * 0.8 + NOISE.heading_turn**2 * 1.6
    assert motion.covariance[0, 5, 5] == pytest.approx(turned, rel=1e-6)


def test_moment_within_a_gap_is_known_as_such() -> None:
    track, _ = with_gap(2.0, share=1.0)
    assert track.is_in_gap(20 * PERIOD_NS + to_ns(1.0))
    assert not track.is_in_gap(20 * PERIOD_NS)
    assert not track.is_in_gap(track.last_ns)
    assert not track.is_in_gap(round(10.5 * PERIOD_NS))


def test_gap_after_which_the_robot_came_less_far_leaves_the_motion_unknown() -> None:
    track, added = with_gap(19.0, share=0.0)
    assert added is Added.JUMP
    motion = track.motion(np.array([20 * PERIOD_NS, track.last_ns]), NO_SCALES)
    assert np.sqrt(motion.covariance[0, 0, 0]) > 10.0


def test_planar_track_takes_the_plane_of_a_tilted_report() -> None:
    track = OdometryTrack(NOISE, planar=True)
    tilted = Pose(so3.about_z(0.3) @ so3.exp([0.02, 0.01, 0.0]), np.array([1.0, 2.0, 0.3]))
    track.add(0, tilted)
    assert_same(track.odom_from_base[0], Pose.planar(1.0, 2.0, tilted.heading))


def test_robot_is_carried_along_its_way_and_its_twist_is_that_of_the_increment() -> None:
    track = track_of(way(30, planar=False), planar=False)
    scales = np.array([0.1, -0.05])
    start_ns = np.array([3.2, 7.0, 12.5, 20.0]) * PERIOD_NS
    start_ns = start_ns.astype(np.int64)
    seconds = np.array([1.9, -2.4, 0.0, 0.3]) * PERIOD_NS / 1e9
    moved, twist = track.carried(start_ns, seconds, np.zeros(2))
    later, _ = track.carried(start_ns, seconds + 1e-6, np.zeros(2))
    speed = (moved.inverse() @ later).difference(Pose.identity()) / 1e-6
    np.testing.assert_allclose(twist, speed, atol=1e-4)
    for index, (start, lead) in enumerate(zip(start_ns, seconds, strict=True)):
        ends = np.array(sorted([start, start + round(lead * 1e9)]))
        if ends[0] == ends[1]:
            continue
        between = track.motion(ends, np.zeros(2)).earlier_from_later[0]
        expected = between if lead > 0 else between.inverse()
        assert np.abs(moved[index].difference(expected)).max() < 1e-9
    scaled, _ = track.carried(start_ns[:1], seconds[:1], scales)
    ends = start_ns[0] + np.array([0, round(seconds[0] * 1e9)])
    expected = track.motion(ends, scales).earlier_from_later[0]
    # A way scaled as a whole bends a little differently.
    assert np.abs(scaled[0].difference(expected)).max() < 1e-4


def test_robot_goes_on_as_it_did_beyond_the_odometrys_ends_and_across_a_jump() -> None:
    x = np.array([0.0, 0.02, 0.04, 7.04, 7.07])
    track, poses = OdometryTrack(NOISE, planar=True), Pose.planar(x, 0.0, 0.0)
    added = [track.add(index * PERIOD_NS, poses[index]) for index in range(len(poses))]
    assert added.count(Added.JUMP) == 1
    last = track.last_ns
    stamps_ns = np.array([0, last, PERIOD_NS * 3 // 2])
    seconds = np.array([-1.0, 1.0, 1.0]) * PERIOD_NS / 1e9
    moved, _ = track.carried(stamps_ns, seconds, np.zeros(2))
    np.testing.assert_allclose(moved.translation[:, 0], [-0.02, 0.03, 0.02], atol=1e-12)


def test_twist_about_a_moment_goes_over_from_one_message_to_the_next() -> None:
    """A camera that is triggered with the odometry sees the robot just where its twist jumps."""
    track = track_of(way(9, planar=False), planar=False)
    around = 4 + np.array([-2.0, -0.5, 0.0, 0.5, 2.0]) * to_ns(2e-3) / PERIOD_NS
    found = track.twists_about(moments(*around))
    _, (before, _, after) = track.carried(moments(3.5, 4, 4.5), np.zeros(3), NO_SCALES)
    np.testing.assert_allclose(found[[0, -1]], [before, after], atol=1e-6)
    for share, twist in zip((0.25, 0.5, 0.75), found[1:4], strict=True):
        np.testing.assert_allclose(twist, before + share * (after - before), atol=2e-3)


def test_twist_about_a_moment_says_nothing_of_a_jump_beside_it() -> None:
    poses = way(9, planar=False)
    far = Pose(poses.rotation, poses.translation + np.where(np.arange(9)[:, None] > 4, 50.0, 0.0))
    track = track_of(poses[:5], planar=False)
    assert track.add(5 * PERIOD_NS, far[5]) is Added.JUMP
    assert track.add(6 * PERIOD_NS, far[6]) is Added.TAKEN
    beside = track.twists_about(moments(4 - 1e-3, 6 - 1e-3))
    assert np.abs(beside).max() < 5.0


def test_track_covers_its_first_to_its_last_message() -> None:
    track = OdometryTrack(NOISE, planar=True)
    assert not track.covers(0)
    track = track_of(way(3, planar=True), planar=True)
    covered = [
        track.covers(stamp) for stamp in (-1, 0, PERIOD_NS, 2 * PERIOD_NS, 2 * PERIOD_NS + 1)
    ]
    assert covered == [False, True, True, True, False]


def test_track_of_many_messages_keeps_them_all() -> None:
    x = np.linspace(0.0, 30.0, 3000)
    track = track_of(Pose.planar(x, 0.0, 0.0), planar=True)
    np.testing.assert_array_equal(track.odom_from_base.translation[:, 0], x)
    motion = track.motion(moments(0, 2999), NO_SCALES)
    # 30 m straight on: rounding of 3000 steps stays below a nanometre.
    assert_same(motion.earlier_from_later[0], Pose.planar(30.0, 0.0, 0.0), 1e-9)


def test_skid_scatters_along_the_track_by_what_was_turned() -> None:
    steps = Pose.planar(np.array([0.1, 0.0]), np.zeros(2), np.array([0.0, 0.4]))
    poses = Pose.stack([Pose.identity(), steps[0], steps[0] @ steps[1]])
    track = track_of(poses, planar=True)
    by_skid = track.noisy(track.noise, slip=0.0, skid=0.03)
    stamps = moments(1, 2)
    plain, skidding = (t.motion(stamps, NO_SCALES).covariance[0] for t in (track, by_skid))
    along = np.array([np.cos(0.2), np.sin(0.2)])  # half-way through the turn
    added = (skidding - plain)[:2, :2]
    np.testing.assert_allclose(added, 0.03**2 * 0.4 * np.outer(along, along), atol=1e-12)
    np.testing.assert_allclose(skidding[5, 5], plain[5, 5])


@pytest.mark.parametrize("planar", [True, False])
def test_motion_is_the_same_where_what_lies_before_it_is_forgotten(planar: bool) -> None:
    poses = way(60, planar=planar)
    whole, short = (track_of(poses, planar=planar) for _ in range(2))
    for track in (whole, short):
        track.break_between(int(track.stamps_ns[10]), int(track.stamps_ns[12]))
        track.break_between(int(track.stamps_ns[50]), int(track.stamps_ns[52]))
    copied = short.mended()
    stamps_ns = whole.stamps_ns.copy()
    short.forget_before(int(stamps_ns[40]) + 5)
    assert short.first_ns == stamps_ns[40]
    assert len(short) == 20
    assert short.jump_steps == whole.jump_steps[1:]
    wanted = moments(40.3, 43.0, 49.5)
    mine, other = (track.motion(wanted, np.zeros(2)) for track in (short, whole))
    assert_same(mine.earlier_from_later, other.earlier_from_later)
    np.testing.assert_allclose(mine.covariance, other.covariance, atol=1e-18)
    assert len(copied) == 60  # a copy keeps what it had
    assert copied.first_ns == stamps_ns[0]
