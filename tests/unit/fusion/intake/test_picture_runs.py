"""What is left of a run of pictures once a robot was told from it."""

from typing import Any

from trigpoint.fusion.association.robots import Picture
from trigpoint.fusion.intake.picture_runs import lasting


def some(numbers: list[int], face: str) -> list[Picture]:
    """Pictures of these numbers with one face each, which only its name tells apart."""
    view: Any = None
    return [Picture(number, ({face: view},)) for number in numbers]


def test_a_stretch_left_beside_a_robot_that_was_told_is_looked_at_again() -> None:
    run = some(list(range(60)), "told")
    singles, stretch = some([3, 4, 17, 51], "single"), some(list(range(30, 40)), "lasting")
    assert lasting(run, singles + stretch) == stretch


def test_what_is_left_of_single_pictures_is_not_a_stretch() -> None:
    run, left = some(list(range(200)), "told"), some([*range(0, 200, 7), 15, 16], "single")
    assert lasting(run, left) == []


def test_faces_left_of_one_picture_are_looked_at_together() -> None:
    run = some(list(range(20)), "told")
    one, other = some(list(range(5, 12)), "one"), some(list(range(5, 12)), "other")
    found = lasting(run, one + other)
    assert [len(picture.faces) for picture in found] == [2] * 7
