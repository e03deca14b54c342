"""Memory is used again only where it fits, and no picture shows in the next one's results."""

import numpy as np
from support.pictures.boards import checkerboard, picture_of, placed, plain_picture, target_of

from trigpoint.edge.detector import detector_for
from trigpoint.edge.image.workspace import Workspace


def test_array_is_the_same_one_while_it_fits() -> None:
    space = Workspace()
    first = space.array("smooth", (4, 5))
    assert space.array("smooth", (4, 5)) is first
    assert space.array("bend", (4, 5)) is not first
    assert space.array("smooth", (5, 4)).shape == (5, 4)
    assert space.array("smooth", (5, 4), np.uint8).dtype == np.uint8


def test_array_of_a_part_lies_in_the_memory_of_the_whole() -> None:
    space = Workspace()
    whole = space.array("smooth", (40, 50))
    part = space.array("smooth", (7, 9))
    assert part.shape == (7, 9)
    assert np.shares_memory(whole, part)
    assert np.shares_memory(whole, space.array("smooth", (50, 40)))
    assert space.array("smooth", (60, 50)).shape == (60, 50)


def test_what_was_seen_before_changes_nothing() -> None:
    face = checkerboard()
    picture = picture_of([placed(face, turn_deg=10)], noise=2.0)
    detector = detector_for([target_of(face)])
    (first,) = detector.detect(picture)
    assert detector.detect(plain_picture(noise=2.0)) == ()
    assert detector.detect(picture[:200, :300]) == ()
    (again,) = detector.detect(picture)
    assert np.array_equal(first.pixels, again.pixels)
