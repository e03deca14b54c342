"""What is said of many cameras: all of them, but never much at once."""

import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.messages import PoseEstimate, Transforms
from trigpoint.fusion.camera_announcements import CameraAnnouncements
from trigpoint.fusion.estimators.interface import CameraEstimate
from trigpoint.fusion.output import Output
from trigpoint.geometry import CameraModel, Pose
from trigpoint.tools.simulation.sight.targets import target_of

LENS = CameraModel.from_field_of_view(640, 480, np.radians(62.0))
LOOKING_DOWN = Pose(np.array([[0, -0.5, 0.9], [-1, 0, 0], [0, -0.9, -0.5]]), np.array([0, 0, 1.5]))


def cameras(count: int, *, first: int = 0) -> dict[str, CameraEstimate]:
    estimate = CameraEstimate(LOOKING_DOWN, np.eye(6), LENS, np.zeros(9), 0.0, 0.0)
    return {f"c{first + index}": estimate for index in range(count)}


def announcements() -> CameraAnnouncements:
    return CameraAnnouncements(target_of("charuco"))


def said(outputs: list[Output]) -> list[str]:
    return [output.node for output in outputs if output.topic is topics.CAMERA_POSE]


def floors(outputs: list[Output]) -> list[str]:
    return [output.node for output in outputs if output.topic is topics.COVERAGE]


def test_every_camera_is_said_once_with_its_transform_a_few_a_turn() -> None:
    news = announcements()
    news.take(5, cameras(20), is_urgent=False)
    turns = [list(news.next(is_quiet=True)) for _ in range(4)]
    assert [name for turn in turns for name in said(turn)] == list(cameras(20))
    assert max(len(said(turn)) for turn in turns) == 8
    for turn in turns[:3]:
        transforms = [output.message for output in turn if output.topic is topics.TF]
        assert len(transforms) == 1
        assert isinstance(transforms[0], Transforms)
        named = [transform.child for transform in transforms[0].transforms]
        assert named == [f"{name}/optical" for name in said(turn)]
    assert said(turns[3]) == []
    messages = [output.message for output in turns[0] if output.topic is topics.CAMERA_POSE]
    assert all(isinstance(message, PoseEstimate) and message.stamp_ns == 5 for message in messages)


def test_new_camera_is_said_before_all_others() -> None:
    news = announcements()
    news.take(0, cameras(20), is_urgent=False)
    list(news.rest())
    news.take(1, cameras(20), is_urgent=False)
    list(news.next(is_quiet=False))
    news.take(2, cameras(20) | cameras(1, first=30), is_urgent=True)
    assert said(list(news.next(is_quiet=False)))[0] == "c30"


def test_camera_that_waits_to_be_said_keeps_its_turn_and_is_said_as_it_is_known_last() -> None:
    news = announcements()
    news.take(0, cameras(20), is_urgent=False)
    list(news.rest())
    news.take(1, cameras(20), is_urgent=False)
    list(news.next(is_quiet=True))
    news.take(2, cameras(20), is_urgent=False)
    outputs = list(news.next(is_quiet=True))
    assert said(outputs) == [f"c{index}" for index in range(8, 16)]
    assert {o.message.stamp_ns for o in outputs if isinstance(o.message, PoseEstimate)} == {2}


def test_one_camera_is_said_in_a_turn_in_which_a_robot_waits() -> None:
    news = announcements()
    news.take(0, cameras(3), is_urgent=False)
    assert [said(list(news.next(is_quiet=False))) for _ in range(4)] == [["c0"], ["c1"], ["c2"], []]


def test_they_are_due_before_a_second_is_over_and_later_where_a_robot_waits() -> None:
    news = announcements()
    assert news.is_due(0, is_quiet=False)
    news.take(0, cameras(1), is_urgent=False)
    for is_quiet, period_ns in ((True, to_ns(0.7)), (False, to_ns(0.9))):
        assert not news.is_due(period_ns - 1, is_quiet=is_quiet)
        assert news.is_due(period_ns, is_quiet=is_quiet)
        assert news.is_due(-1, is_quiet=is_quiet)  # a session that begins anew


def test_floor_is_said_of_one_camera_a_turn_and_only_where_no_robot_waits() -> None:
    news = announcements()
    news.take(0, cameras(3), is_urgent=False)
    assert floors(list(news.next(is_quiet=False))) == []
    quiet = [floors(list(news.next(is_quiet=True))) for _ in range(4)]
    assert quiet == [["c0"], ["c1"], ["c2"], []]


def test_floor_is_said_again_of_a_camera_that_moved() -> None:
    news, known = announcements(), cameras(3)
    news.take(0, known, is_urgent=False)
    assert floors(list(news.rest())) == ["c0", "c1", "c2"]
    tiny, far = np.full(6, 1e-3), np.array([0.1, 0, 0, 0, 0, 0])
    known["c1"] = replace(known["c1"], map_from_camera=LOOKING_DOWN.disturbed(tiny))
    known["c2"] = replace(known["c2"], map_from_camera=LOOKING_DOWN.disturbed(far))
    news.take(1, known, is_urgent=True)
    assert floors(list(news.rest())) == ["c2"]


def static(outputs: list[Output]) -> list[list[int]]:
    """The stamps of each message that names all cameras."""
    messages = [output.message for output in outputs if output.topic is topics.TF_STATIC]
    return [[t.stamp_ns for t in m.transforms] for m in messages if isinstance(m, Transforms)]


def test_all_transforms_together_are_said_once_a_round_and_with_a_camera_that_is_new() -> None:
    news = announcements()
    news.take(0, cameras(20), is_urgent=False)
    turns = [static(list(news.next(is_quiet=True))) for _ in range(4)]
    assert turns == [[[0] * 8], [[0] * 16], [[0] * 20], []]
    news.take(1, cameras(20), is_urgent=False)
    turns = [static(list(news.next(is_quiet=True))) for _ in range(3)]
    assert turns == [[], [], [[1] * 20]]
    news.take(2, cameras(20) | cameras(1, first=30), is_urgent=False)
    assert static(list(news.next(is_quiet=False))) == [[1] * 20 + [2]]


def test_all_transforms_together_are_said_once_a_round_that_never_ends() -> None:
    news = announcements()
    news.take(0, cameras(20), is_urgent=False)
    list(news.rest())
    for stamp in (1, 2, 3):
        news.take(stamp, cameras(20), is_urgent=False)
        said_now = [static(list(news.next(is_quiet=False))) for _ in range(5)]
        assert [len(turn) for turn in said_now] == [int(stamp > 1), 0, 0, 0, 0]


def test_camera_that_is_not_located_any_more_is_not_said() -> None:
    news = announcements()
    news.take(0, cameras(3), is_urgent=True)
    news.take(1, cameras(2), is_urgent=True)
    outputs = list(news.rest())
    assert said(outputs) == floors(outputs) == ["c0", "c1"]
