"""Faces that the target file has elsewhere than they are: what their rejected sightings say."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from support.builders import make_site

from trigpoint.fusion.estimators.rejected_faces import rejected_faces
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, Reading, Verdict, View

PIXELS = np.zeros((4, 2))


def seen(face: int, verdict: Verdict, camera: str, *, is_alike: bool = False) -> Any:
    readings = (Reading(face), *([Reading(face + 1)] if is_alike else []))
    view = View(np.arange(4), PIXELS, 0.1, readings)
    observation = Observation(camera, "r1", 1, (view,), None, verdict, (np.zeros(4, bool),))
    return SimpleNamespace(observation=observation)


def said(
    counts: dict[int, tuple[int, int]], *, cameras: int = 2, is_alike: bool = False
) -> tuple[str, ...]:
    """Of faces that were seen so often, and rejected so often, by so many cameras in turn."""
    entries = [
        seen(
            face,
            Verdict.REJECTED if number < bad else Verdict.ACCEPTED,
            f"c{number % cameras}",
            is_alike=is_alike,
        )
        for face, (count, bad) in counts.items()
        for number in range(count)
    ]
    faces = [SimpleNamespace(id=10 + index) for index in range(8)]
    targets = {"r1": SimpleNamespace(faces=faces)}
    data = SimpleNamespace(entries=entries, site=make_site(), targets=targets)
    return rejected_faces(cast(DataSet, data))


def test_exchanged_faces_are_named() -> None:
    first, second = said({0: (14, 13), 1: (15, 15), 2: (80, 3), 3: (60, 5)})
    assert "13 of 14 sightings of face 10 of r1" in first
    assert "15 of 15 sightings of face 11 of r1" in second


def test_print_of_another_size_is_the_whole_targets() -> None:
    [line] = said({0: (39, 36), 1: (79, 40), 2: (120, 50)})
    assert "126 of 238 sightings of r1 contradict the rest; measure the squares" in line


@pytest.mark.parametrize(
    "counts",
    [
        {0: (2, 2), 1: (50, 2)},  # too few
        {0: (20, 4), 1: (50, 8)},  # as wrong sightings come
        {0: (8, 5), 1: (50, 2)},  # as in one bad visit
        {},
    ],
)
def test_wrong_sightings_alone_are_nothing_to_tell(counts: dict[int, tuple[int, int]]) -> None:
    assert said(counts) == ()


def test_faces_that_look_alike_are_not_told_apart_by_guess() -> None:
    assert said({0: (20, 20), 2: (20, 0)}, is_alike=True) == ()


@pytest.mark.parametrize(
    "bad", [{0: (15, 15), 1: (80, 3)}, {0: (39, 36), 1: (79, 40), 2: (120, 50)}]
)
def test_what_one_camera_contradicts_says_nothing_of_the_target(
    bad: dict[int, tuple[int, int]],
) -> None:
    assert said(bad, cameras=1) == ()
    assert said(bad)
