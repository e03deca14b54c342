"""Which corrections reach a robot: each rule by itself."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.site.gate_drive import MAP, OTHER_MAP, Site, off_by, placed, reason

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.robot.gate.safety import Approved, Refusal
from trigpoint.robot.gate.sent_covariance import as_sent
from trigpoint.site.config import OdometryNoise


@pytest.fixture
def site() -> Site:
    return placed()


def test_consistent_corrections_are_accepted_with_the_firmwares_time(site: Site) -> None:
    for _ in range(20):
        site.drive(0.1)
        verdict = site.correct(Pose.planar(0.01, -0.01, 0.005))
        assert isinstance(verdict, Approved)
        assert not verdict.establishes
        assert verdict.firmware_ns == site.now_ns - to_ns(0.1) - to_ns(900.0)


# ---- by itself


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


def test_place_outside_of_any_building_is_refused(site: Site) -> None:
    assert reason(site.correct(Pose.planar(1e300, 0, 0))) is Refusal.POSE


def with_entry(row: int, column: int, value: float) -> np.ndarray:
    covariance = np.diag([1e-4, 1e-4, 0, 0, 0, 1e-4])
    covariance[row, column] = value
    return covariance


@pytest.mark.parametrize(
    "covariance",
    [
        np.zeros((6, 6)),
        with_entry(1, 1, -1e-4),
        with_entry(1, 1, np.nan),
        with_entry(0, 0, np.inf),
        with_entry(0, 0, 1e-200),  # an exact zero in single precision
        with_entry(5, 5, 1e-11),  # a sigma of 3 µrad
        with_entry(0, 1, 1.1e-4),  # only the upper triangle is sent: not positive
        with_entry(1, 0, 0.9e-4),  # the lower one is not sent: another matrix than was meant
        np.diag([1e-4, 1e-4, 0, 0, 0, 1e-4]) + 0.9999999e-4 * np.eye(6)[[1, 0, 2, 3, 4, 5]],
    ],
)
def test_covariance_that_is_none_as_it_is_sent_is_refused(
    site: Site, covariance: np.ndarray
) -> None:
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
    site = placed(planar=False)
    covariance = np.eye(6) * 1e-4
    lifted = Pose(np.eye(3), np.array([0, 0, 0.02]))
    assert reason(site.correct(lifted, covariance=covariance)) is None
    site.drive(0.1)
    higher = Pose(np.eye(3), np.array([0, 0, 0.5]))
    assert reason(site.correct(higher, covariance=covariance)) is Refusal.JUMP


def test_what_is_told_is_what_single_precision_holds(site: Site) -> None:
    verdict = site.correct()
    assert isinstance(verdict, Approved)
    np.testing.assert_array_equal(verdict.covariance, as_sent(verdict.covariance))


# ---- in order


def test_repeated_correction_is_refused(site: Site) -> None:
    correction = site.truth()
    assert reason(site.judge(correction)) is None
    assert reason(site.judge(correction)) is Refusal.ORDER


def test_correction_of_a_moment_before_the_last_applied_one_is_refused(site: Site) -> None:
    assert reason(site.correct(age_s=0.05)) is None
    assert reason(site.correct(age_s=0.06)) is Refusal.ORDER


def test_fusion_that_numbers_anew_in_the_same_map_is_heard(site: Site) -> None:
    site.sequence = -1
    assert reason(site.correct()) is None


def test_two_senders_are_both_refused_until_one_is_silent(site: Site) -> None:
    verdict = site.correct(sender="other")
    assert reason(verdict) is Refusal.SENDERS
    assert "«fusion» and «other»" in getattr(verdict, "text", "")
    site.drive(0.1)
    assert reason(site.correct()) is Refusal.SENDERS
    site.drive(2.1)
    assert reason(site.correct()) is None


# ---- beside what is known


def test_jump_beyond_what_the_odometry_allows_is_refused(site: Site) -> None:
    assert reason(site.correct(Pose.planar(0.2, 0.0, 0.0))) is Refusal.JUMP
    site.drive(0.1)
    assert reason(site.correct(Pose.planar(0.0, 0.0, 0.2))) is Refusal.JUMP
    site.drive(0.1)
    assert reason(site.correct(Pose.planar(0.02, 0.0, 0.0))) is None


def test_jump_that_a_long_way_allows_is_accepted(site: Site) -> None:
    site.drive(60.0)  # 24 m: the heading's sigma is 20 mrad, so the place's is some 30 cm
    x, y = -0.25 * np.sin(1.0), 0.25 * np.cos(1.0)
    assert reason(site.correct(Pose.planar(x, y, -0.1))) is Refusal.JUMP
    site.drive(0.1)
    assert reason(site.correct(Pose.planar(x, y, 0.02))) is None


def test_limits_hold_however_uncertain_the_odometry_is() -> None:
    site = placed(OdometryNoise(distance=1.0, lateral=1.0, heading_drive=1.0))
    site.drive(10.0)
    assert reason(site.correct(Pose.planar(1.2, 0.0, 0.0))) is Refusal.JUMP
    site.drive(0.1)
    assert reason(site.correct(Pose.planar(0.0, 0.0, 0.6))) is Refusal.JUMP
    site.drive(0.1)
    assert reason(site.correct(Pose.planar(0.5, 0.0, 0.2))) is None


def test_constant_scale_error_is_allowed_for() -> None:
    off = Pose.planar(0.3 * np.cos(1.0), 0.3 * np.sin(1.0), 0.0)  # along the track
    exact, scaled = placed(OdometryNoise()), placed(OdometryNoise(distance_scale=0.05))
    for site in (exact, scaled):
        site.drive(10.0)
    assert reason(exact.correct(off)) is Refusal.JUMP
    assert reason(scaled.correct(off)) is None


def test_correction_is_never_taken_over_whole(site: Site) -> None:
    verdict = site.correct(Pose.planar(0.05, 0.0, 0.0))
    assert 0.015 < off_by(verdict, site) < 0.035
    site.drive(0.1)
    sure = site.correct(Pose.planar(0.05, 0.0, 0.0), sigma=0.05)
    assert off_by(sure, site) < 0.035


def test_fused_uncertainty_is_never_below_what_one_correction_gives(site: Site) -> None:
    """Corrections share a map and sightings: a hundred of them are not ten times as good."""
    verdict = site.judge(site.truth())
    for _ in range(100):
        site.drive(0.1)
        verdict = site.judge(site.truth())
    assert isinstance(verdict, Approved)
    assert np.sqrt(verdict.covariance[0, 0]) > 0.99 * 0.01


def test_large_steps_that_each_fit_a_claimed_uncertainty_do_not_walk_the_robot(site: Site) -> None:
    """With sigma 0.19 m a step of 0.9 m is no wonder; thirty of them in one direction are."""
    furthest = 0.0
    for k in range(1, 31):
        site.drive(0.1)
        verdict = site.correct(Pose.planar(0.9 * k, 0.0, 0.0), sigma=0.19)
        if isinstance(verdict, Approved):
            furthest = max(furthest, off_by(verdict, site))
    assert furthest < 1.0


@pytest.mark.parametrize(("speed", "within_s"), [(0.01, 15.0), (0.03, 6.0), (0.1, 3.0)])
def test_slow_pull_is_noticed_in_a_stated_time(speed: float, within_s: float) -> None:
    """decisions/0304 states these times for sigma 1 cm; the robot drives along its odometry."""
    site = placed()
    begin_ns = site.now_ns
    while True:
        site.drive(0.1)
        pulled_s = (site.now_ns - begin_ns) / 1e9
        assert pulled_s < within_s, "the pull was not noticed"
        # Along the track: what the odometry knows best.
        way = speed * pulled_s
        pull = Pose.planar(way * np.cos(1.0), way * np.sin(1.0), 0.0)
        if reason(site.correct(pull)) is Refusal.PULL:
            break


# ---- placing anew


def test_one_correction_of_an_unknown_map_places_nobody() -> None:
    site = Site()
    assert reason(site.correct(Pose.planar(5.0, 0.0, 0.0), map_id=OTHER_MAP)) is Refusal.WAITING
    assert site.place()  # the true ones are not held up by it


def test_robot_is_placed_by_corrections_from_several_places_and_fusions_word() -> None:
    site = Site()
    verdicts = []
    for _ in range(12):
        site.drive(0.12)
        verdicts.append(site.judge(site.truth()))
    assert [reason(verdict) for verdict in verdicts[:9]] == [Refusal.WAITING] * 9
    established = verdicts[9]
    assert isinstance(established, Approved)
    assert established.establishes
    assert "10 corrections in a row agree" in established.why


def test_standing_robot_is_not_placed_and_it_is_said_why() -> None:
    site = Site()
    site.path = lambda _t_s: Pose.identity()
    site.drive(1.0)
    for _ in range(50):
        site.drive(0.1)
        assert reason(site.judge(site.truth())) is Refusal.WAITING
    assert "all from one place: drive or turn the robot by 0.25 m or rad" in site.gate.state


def test_turning_robot_is_placed() -> None:
    site = Site()
    site.path = lambda t_s: Pose.planar(0.0, 0.0, 0.3 * t_s)
    site.drive(1.0)
    assert site.place()


def test_map_that_fusion_does_not_call_its_own_places_nobody() -> None:
    site = Site()
    site.fusion_map = OTHER_MAP
    for _ in range(50):
        site.drive(0.1)
        assert reason(site.judge(site.truth())) is Refusal.WAITING
    assert f"fusion says that its map is {OTHER_MAP}" in site.gate.state
    site.fusion_map = None
    site.gate.hear([], site.now_ns)
    assert "fusion does not answer" in site.gate.state
    site.gate.hear([MAP, OTHER_MAP], site.now_ns)
    assert "fusion says that its map is" in site.gate.state


def test_fusions_earlier_word_does_not_count(site: Site) -> None:
    """It is asked again whenever corrections want to place the robot anew."""
    site.gate.hear([OTHER_MAP], site.now_ns)
    site.fusion_map = None
    for _ in range(30):
        site.drive(0.1)
        assert reason(site.correct(map_id=OTHER_MAP)) is Refusal.OTHER_MAP


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
    assert "doubted" not in site.gate.state
    for verdict, establishes in zip(verdicts[9:], (True, False, False), strict=True):
        assert isinstance(verdict, Approved)
        assert verdict.establishes is establishes


def test_run_that_is_too_short_in_time_is_not_believed(site: Site) -> None:
    off = Pose.planar(3.0, 2.0, 0.0)
    for _ in range(20):
        site.drive(0.02)
        assert reason(site.correct(off, age_s=0.02)) is Refusal.JUMP


def test_repeated_correction_makes_no_run(site: Site) -> None:
    site.drive(0.5)
    correction = replace(site.truth(), pose=Pose.planar(3.0, 2.0, 0.0))
    assert reason(site.judge(correction)) is Refusal.JUMP
    for _ in range(10):
        assert reason(site.judge(correction)) is Refusal.ORDER


def test_true_correction_in_between_ends_a_run(site: Site) -> None:
    for _ in range(6):
        for _ in range(4):
            site.drive(0.2)
            assert reason(site.correct(Pose.planar(3.0, 2.0, 0.0))) is Refusal.JUMP
        site.drive(0.1)
        assert reason(site.correct()) is None


def test_new_map_needs_fusions_word_and_a_run(site: Site) -> None:
    away = Pose.planar(50.0, 0.0, 0.0)
    for _ in range(20):
        site.drive(0.12)
        assert reason(site.correct(away, map_id=OTHER_MAP)) is Refusal.OTHER_MAP
    assert "fusion says that its map is" in site.gate.state
    site.fusion_map = OTHER_MAP
    site.drive(0.12)
    verdict = site.correct(away, map_id=OTHER_MAP)
    assert isinstance(verdict, Approved)
    assert verdict.establishes


def test_two_maps_that_fight_do_not_toss_the_robot_to_and_fro(site: Site) -> None:
    away = Pose.planar(50.0, 0.0, 0.0)
    for _ in range(30):
        site.drive(0.1)
        assert reason(site.correct(away, map_id=OTHER_MAP)) is Refusal.OTHER_MAP
        site.drive(0.1)
        assert reason(site.correct()) is None


def test_restarted_firmware_is_placed_anew(site: Site) -> None:
    site.gate.restart()
    assert not site.gate.is_placed
    site.drive(0.5)
    assert reason(site.correct()) is Refusal.WAITING
    assert site.place()


def test_uncertainty_grows_without_corrections(site: Site) -> None:
    believed = []
    for _ in range(3):
        site.drive(20.0)
        found = site.gate.believed()
        assert found is not None
        at, pose, covariance = found
        assert at.stamp_ns == site.now_ns
        assert off_by(Approved(at, pose, covariance, False), site, age_s=0.0) < 0.01
        believed.append(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    assert believed[0] > 0.03
    assert believed == sorted(believed)
