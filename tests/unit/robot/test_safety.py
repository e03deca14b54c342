"""Which corrections reach a robot: each rule by itself."""

from uuid import UUID

import numpy as np
import pytest

from trigpoint.clock import to_ns
from trigpoint.config import OdometryNoise, RobotConfig
from trigpoint.correction import CorrectionMark
from trigpoint.geometry import Pose
from trigpoint.messages import PoseEstimate
from trigpoint.robot.odometry import Stamped
from trigpoint.robot.safety import Approved, Refusal, Refused, SafetyGate

MAP, OTHER_MAP = UUID(int=1), UUID(int=2)
MAP_FROM_ODOM = Pose.planar(10.0, 5.0, 1.0)
SIGMA, HEADING_SIGMA = 0.01, 0.01
BEGIN_NS = to_ns(1000.0)


class Site:
    """A robot that drives 0.4 m/s along x of its odometry, and a fusion that knows where it is."""

    def __init__(self, noise: OdometryNoise | None = None, *, planar: bool = True) -> None:
        config = RobotConfig(port="x", odometry=noise or OdometryNoise(), planar=planar)
        self.gate = SafetyGate(config)
        self.now_ns, self.sequence = BEGIN_NS, 0
        self.drive(0.5)

    def odom_from_base(self, stamp_ns: int) -> Pose:
        return Pose.planar(0.4 * (stamp_ns - BEGIN_NS) / 1e9, 0.0, 0.0)

    def drive(self, seconds: float) -> None:
        end_ns = self.now_ns + to_ns(seconds)
        while self.now_ns < end_ns:
            self.now_ns += to_ns(0.02)
            pose = self.odom_from_base(self.now_ns)
            self.gate.add_odometry(Stamped(self.now_ns, self.now_ns - to_ns(900.0), pose))

    def correct(
        self,
        off: Pose | None = None,
        *,
        age_s: float = 0.1,
        sigma: float = SIGMA,
        heading_sigma: float = HEADING_SIGMA,
        map_id: UUID = MAP,
        sequence: int | None = None,
        frame: str = "map",
        covariance: np.ndarray | None = None,
    ) -> Approved | Refused:
        """Judge a correction that is off the truth by `off` in the map's axes."""
        stamp_ns = self.now_ns - to_ns(age_s)
        pose = MAP_FROM_ODOM @ self.odom_from_base(stamp_ns)
        if off is not None:
            pose = Pose(off.rotation @ pose.rotation, off.translation + pose.translation)
        if covariance is None:
            covariance = np.diag([sigma**2, sigma**2, 0, 0, 0, heading_sigma**2])
        self.sequence = self.sequence + 1 if sequence is None else sequence
        mark = CorrectionMark(map_id, self.sequence)
        return self.gate.judge(PoseEstimate(stamp_ns, frame, pose, covariance), mark, self.now_ns)


def reason(verdict: Approved | Refused) -> Refusal | None:
    return verdict.reason if isinstance(verdict, Refused) else None


def establishes(verdict: Approved | Refused) -> bool:
    assert isinstance(verdict, Approved)
    return verdict.establishes


@pytest.fixture
def site() -> Site:
    """A site where one correction has established the frame."""
    site = Site()
    assert establishes(site.correct())
    site.drive(0.2)
    return site


def test_first_correction_of_a_map_is_accepted_anywhere() -> None:
    verdict = Site().correct(Pose.planar(300.0, -80.0, 2.0))
    assert establishes(verdict)


def test_consistent_corrections_are_accepted_with_the_firmwares_time(site: Site) -> None:
    for _ in range(20):
        site.drive(0.1)
        verdict = site.correct(Pose.planar(0.01, -0.01, 0.005))
        assert isinstance(verdict, Approved)
        assert not verdict.establishes
        assert verdict.firmware_ns == site.now_ns - to_ns(0.1) - to_ns(900.0)


def test_another_frame_is_refused(site: Site) -> None:
    assert reason(site.correct(frame="r1/odom")) is Refusal.FRAME


def test_old_correction_is_refused(site: Site) -> None:
    site.drive(2.0)
    assert reason(site.correct(age_s=1.1)) is Refusal.OLD
    assert reason(site.correct(age_s=0.9)) is None


def test_correction_from_the_future_is_refused(site: Site) -> None:
    assert reason(site.correct(age_s=-0.2)) is Refusal.FUTURE


def test_moment_without_odometry_is_refused(site: Site) -> None:
    assert reason(site.correct(age_s=-0.01)) is Refusal.NO_ODOMETRY


@pytest.mark.parametrize(
    "covariance",
    [
        np.zeros((6, 6)),
        np.diag([1e-4, -1e-4, 0, 0, 0, 1e-4]),
        np.diag([1e-4, np.nan, 0, 0, 0, 1e-4]),
    ],
)
def test_covariance_that_is_not_positive_is_refused(site: Site, covariance: np.ndarray) -> None:
    assert reason(site.correct(covariance=covariance)) is Refusal.COVARIANCE


def test_uncertain_place_or_heading_is_refused(site: Site) -> None:
    assert reason(site.correct(sigma=0.3)) is Refusal.UNCERTAIN
    assert reason(site.correct(heading_sigma=0.3)) is Refusal.UNCERTAIN


def test_planar_robot_is_not_lifted_or_tilted(site: Site) -> None:
    lifted = Pose(np.eye(3), np.array([0, 0, 0.1]))
    tilted = Pose.from_vector([0, 0, 0, 0.1, 0, 0])
    assert reason(site.correct(lifted)) is Refusal.POSE
    assert reason(site.correct(tilted)) is Refusal.POSE


def test_robot_in_space_may_be_lifted() -> None:
    site = Site(planar=False)
    assert establishes(site.correct(covariance=np.eye(6) * 1e-4))
    site.drive(0.1)
    lifted = Pose(np.eye(3), np.array([0, 0, 0.02]))
    assert reason(site.correct(lifted, covariance=np.eye(6) * 1e-4)) is None
    assert (
        reason(site.correct(Pose(np.eye(3), np.array([0, 0, 0.5])), covariance=np.eye(6) * 1e-4))
        is Refusal.JUMP
    )


def test_number_that_came_before_is_refused(site: Site) -> None:
    assert reason(site.correct(sequence=site.sequence, age_s=0.3)) is Refusal.ORDER


def test_newer_number_with_an_older_stamp_is_accepted(site: Site) -> None:
    assert reason(site.correct(age_s=0.15)) is None
    assert reason(site.correct(age_s=0.25)) is None


def test_fusion_that_numbers_anew_in_the_same_map_is_heard(site: Site) -> None:
    for _ in range(5):
        site.drive(0.1)
        site.correct()
    site.drive(0.1)
    assert reason(site.correct(sequence=0)) is None


def test_jump_beyond_what_the_odometry_allows_is_refused(site: Site) -> None:
    assert reason(site.correct(Pose.planar(0.2, 0.0, 0.0))) is Refusal.JUMP
    assert reason(site.correct(Pose.planar(0.0, 0.0, 0.2))) is Refusal.JUMP
    assert reason(site.correct(Pose.planar(0.02, 0.0, 0.0))) is None


def test_jump_that_a_long_way_allows_is_accepted(site: Site) -> None:
    site.drive(60.0)  # 24 m: the heading's sigma is 20 mrad, so the place's is some 30 cm
    x, y = -0.25 * np.sin(1.0), 0.25 * np.cos(1.0)
    assert reason(site.correct(Pose.planar(x, y, 0.02))) is None
    assert reason(site.correct(Pose.planar(x, y, -0.06))) is Refusal.JUMP


def test_limits_hold_however_uncertain_the_odometry_is() -> None:
    site = Site(OdometryNoise(distance=1.0, lateral=1.0, heading_drive=1.0))
    site.correct()
    site.drive(10.0)
    assert reason(site.correct(Pose.planar(1.2, 0.0, 0.0))) is Refusal.JUMP
    assert reason(site.correct(Pose.planar(0.0, 0.0, 0.6))) is Refusal.JUMP
    assert reason(site.correct(Pose.planar(0.5, 0.0, 0.2))) is None


def test_constant_scale_error_is_allowed_for() -> None:
    off = Pose.planar(0.3 * np.cos(1.0), 0.3 * np.sin(1.0), 0.0)  # along the track
    exact = Site(OdometryNoise())
    scaled = Site(OdometryNoise(distance_scale=0.05))
    for site in (exact, scaled):
        site.correct()
        site.drive(10.0)
    assert reason(exact.correct(off)) is Refusal.JUMP
    assert reason(scaled.correct(off)) is None


def test_single_false_sightings_are_never_believed(site: Site) -> None:
    for k in range(40):
        site.drive(0.1)
        assert reason(site.correct(Pose.planar(0.7, 0.1 * k, 0.0))) is Refusal.JUMP


def test_carried_robot_is_found_again_after_a_run_that_agrees(site: Site) -> None:
    off = Pose.planar(3.0, 2.0, 0.0)
    verdicts = []
    for _ in range(12):
        site.drive(0.12)
        verdicts.append(site.correct(off))
    assert [reason(verdict) for verdict in verdicts[:9]] == [Refusal.JUMP] * 9
    assert establishes(verdicts[9])
    assert not establishes(verdicts[10])


def test_run_that_is_too_short_in_time_is_not_believed(site: Site) -> None:
    off = Pose.planar(3.0, 2.0, 0.0)
    for _ in range(20):
        site.drive(0.02)
        assert reason(site.correct(off, age_s=0.1)) is Refusal.JUMP


def test_true_correction_in_between_ends_a_run(site: Site) -> None:
    for _ in range(6):
        for _ in range(4):
            site.drive(0.2)
            assert reason(site.correct(Pose.planar(3.0, 2.0, 0.0))) is Refusal.JUMP
        assert reason(site.correct()) is None


def test_new_map_replaces_the_old_at_once(site: Site) -> None:
    verdict = site.correct(Pose.planar(50.0, 0.0, 1.0), map_id=OTHER_MAP, sequence=0)
    assert establishes(verdict)


def test_replaced_map_does_not_toss_the_robot_to_and_fro(site: Site) -> None:
    away = Pose.planar(50.0, 0.0, 0.0)
    site.correct(away, map_id=OTHER_MAP)
    for _ in range(30):
        site.drive(0.1)
        assert reason(site.correct(map_id=MAP)) is Refusal.REPLACED_MAP
        assert reason(site.correct(away, map_id=OTHER_MAP)) is None


def test_replaced_map_that_is_alone_for_a_while_is_believed_again(site: Site) -> None:
    site.correct(Pose.planar(50.0, 0.0, 0.0), map_id=OTHER_MAP)
    verdicts = []
    for _ in range(10):
        site.drive(0.12)
        verdicts.append(site.correct(map_id=MAP))
    assert establishes(verdicts[-1])


def test_restarted_firmware_is_told_anew(site: Site) -> None:
    site.gate.restart()
    site.drive(0.5)
    assert establishes(site.correct(Pose.planar(2.0, 0.0, 0.0)))
