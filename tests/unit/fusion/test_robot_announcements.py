"""What is said of robots, and how often."""

from uuid import UUID

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.correction import decode_mark
from trigpoint.contract.messages import PoseArray, Transforms
from trigpoint.contract.topics import Topic
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.output import Output
from trigpoint.fusion.robot_announcements import RobotAnnouncements
from trigpoint.fusion.solver.filter import RobotEstimate
from trigpoint.geometry import Pose

MAP = UUID(int=7)
ODOM_FROM_BASE = Pose.planar(1.0, 2.0, 0.3)


def at(seconds: float) -> RobotEstimate:
    return RobotEstimate(to_ns(seconds), Pose.planar(4.0, -1.0, 1.2), np.eye(6))


def seen(seconds: float) -> Observation:
    return Observation("c1", "r1", to_ns(seconds), (), None)


def of_topic(outputs: list[Output], topic: Topic) -> list[Output]:
    return [output for output in outputs if output.topic is topic]


def corrected(news: RobotAnnouncements, seconds: list[float]) -> list[Output]:
    return [output for s in seconds for output in news.correction(MAP, seen(s), at(s))]


def sequence(outputs: list[Output]) -> list[int]:
    marks = [decode_mark(output.attachment) for output in outputs]
    assert all(mark.map_id == MAP for mark in marks)
    return [mark.sequence for mark in marks]


def no_samples(_robot: str) -> None:
    return None


def test_every_pose_is_said_and_transforms_ten_times_a_second() -> None:
    news = RobotAnnouncements(10.0)
    said = [o for i in range(50) for o in news.place("r1", at(i / 50), ODOM_FROM_BASE, no_samples)]
    assert len(of_topic(said, topics.ROBOT_POSE)) == 50
    transforms = of_topic(said, topics.TF)
    assert len(transforms) == 10
    message = transforms[0].message
    assert isinstance(message, Transforms)
    map_from_odom, odom_from_base = (one.pose for one in message.transforms)
    joined = map_from_odom @ odom_from_base
    np.testing.assert_allclose(joined.difference(at(0.0).map_from_base), 0.0, atol=1e-12)


def test_particles_are_asked_for_and_said_twice_a_second() -> None:
    news, asked = RobotAnnouncements(10.0), []

    def particles(robot: str) -> Pose:
        asked.append(robot)
        return Pose.identity().repeated(3)

    said = [o for i in range(50) for o in news.place("r1", at(i / 50), ODOM_FROM_BASE, particles)]
    messages = [output.message for output in of_topic(said, topics.PARTICLES)]
    assert asked == ["r1", "r1"]
    assert all(isinstance(message, PoseArray) for message in messages)
    assert len(messages) == 2


def test_corrections_are_numbered_and_no_more_than_the_rate_allows() -> None:
    found = corrected(RobotAnnouncements(10.0), [i / 50 for i in range(500)])
    assert 100 <= len(found) <= 101  # the second may come half a period early
    assert sequence(found) == list(range(1, len(found) + 1))


def test_pictures_at_just_the_rate_are_not_halved_by_their_jitter() -> None:
    jitter = np.random.default_rng(2).uniform(-0.04, 0.04, 100)
    times = (0.1 * np.arange(100) + jitter).tolist()
    assert len(corrected(RobotAnnouncements(10.0), times)) > 95


def test_after_a_restart_numbers_are_beyond_all_that_may_have_been_sent() -> None:
    news = RobotAnnouncements(10.0)
    news.skip_corrections(["r1"])
    assert sequence(corrected(news, [0.0]))[0] > 1000


def test_what_nothing_has_measured_is_no_correction() -> None:
    """A robot that stands where the map begins is there by definition, without any error."""
    news = RobotAnnouncements(10.0)
    begun = RobotEstimate(to_ns(1.0), Pose.identity(), np.zeros((6, 6)))
    assert not list(news.correction(MAP, seen(1.0), begun))
    assert sequence(corrected(news, [1.1])) == [1]
