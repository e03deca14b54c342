"""What `target check` finds."""

import numpy as np
import pytest

from trigpoint.geometry import Pose
from trigpoint.site.target import Face, Numbering, Pattern, Target
from trigpoint.tools.simulation.sight.targets import target_of
from trigpoint.tools.target.check import check_target, intersects


def face(number: int, pose: Pose | None = None, **more: object) -> Face:
    pose = pose or Pose.planar(10.0 * number, 0, 0)
    keys: dict[str, object] = {"pattern": Pattern.CHECKERBOARD, "columns": 6, "rows": 4} | more
    x, y, z = (float(value) for value in pose.translation)
    i, j, k, w = (float(value) for value in pose.quaternion)
    return Face(id=number, square=0.05, translation=(x, y, z), quaternion=(i, j, k, w), **keys)  # pyright: ignore[reportArgumentType] - the keys are the test's own


def charuco(number: int, **more: object) -> Face:
    keys: dict[str, object] = {
        "pattern": Pattern.CHARUCO, "marker": 0.03, "dictionary": "DICT_4X4_50",
    }  # fmt: skip
    return face(number, None, **(keys | more))


def problems(*faces: Face) -> str:
    return "\n".join(check_target(Target("t", faces)).problems)


def notes(*faces: Face) -> str:
    return "\n".join(check_target(Target("t", faces)).notes)


@pytest.mark.parametrize("choice", ["charuco", "checkerboard"])
def test_simulated_targets_are_sound(choice: str) -> None:
    assert check_target(target_of(choice)).problems == ()


def test_markers_beyond_the_dictionary_are_a_problem() -> None:
    assert problems(charuco(0, first_marker=30)) == ""
    assert "needs markers 40 to 51, but DICT_4X4_50 has 50" in problems(charuco(0, first_marker=40))


def test_unknown_dictionary_is_a_problem() -> None:
    assert "face 0: the dictionary «DICT_9X9_3»" in problems(charuco(0, dictionary="DICT_9X9_3"))
    assert "did you mean «DICT_4X4_50»?" in problems(charuco(0, dictionary="4x4_50"))


def test_keys_of_another_pattern_are_a_problem() -> None:
    assert "legacy means nothing for checkerboard" in problems(face(0, None, legacy=True))
    assert problems(charuco(0, legacy=True)) == ""
    for key, value in (("corner_squares", True), ("numbering", Numbering.KALIBR)):
        assert f"{key} means nothing for charuco" in problems(charuco(0, **{key: value}))


def test_inverted_is_a_key_of_checkerboards_and_charuco_boards() -> None:
    assert problems(face(0, None, inverted=True)) == problems(charuco(0, inverted=True)) == ""


def test_faces_that_look_alike_are_noted() -> None:
    assert "faces 0 and 1 look alike: they are sighted as face -1" in notes(
        face(0, rows=5), face(1, rows=5)
    )
    assert notes(face(0, rows=5), face(1, columns=7, rows=4)) == ""


def test_half_turn_is_noted() -> None:
    assert notes(face(0)).startswith("face 0 reads the same from both ends")
    assert notes(face(0, rows=5)) == ""


LYING = Pose.planar(0, 0, 0)
UPRIGHT = Pose.from_vector([0.05, 0.05, -0.05, np.pi / 2, 0, 0])


@pytest.mark.parametrize(
    ("second", "meets"),
    [
        (LYING, True),
        (Pose.planar(0.1, 0.0, 0.0), True),
        (Pose.planar(0.31, 0.0, 0.0), False),
        (Pose.planar(0.3, 0.0, 0.0), False),  # side by side
        (Pose.planar(0.22, 0.0, np.pi / 4), True),
        (Pose.from_vector([0.0, 0, 0.006, 0, 0, 0]), False),  # back to back
        (UPRIGHT, True),
        (Pose.planar(0, 0, 0) @ Pose.from_vector([0.05, 0.05, 0.06, np.pi / 2, 0, 0]), False),
        (Pose.planar(1.0, 0, 0) @ UPRIGHT, False),
    ],
)
def test_faces_that_run_through_each_other_are_found(second: Pose, meets: bool) -> None:
    first, other = face(0, LYING), face(1, second)
    assert intersects(first, other) is meets
    assert intersects(other, first) is meets
    assert ("run through each other" in problems(first, other)) is meets
