"""Where the faces beside those that are followed can be."""

import numpy as np

from trigpoint.edge.image.region import Region, regions_around

SHAPE = (480, 640)


def square(x: float, y: float, side: float) -> np.ndarray:
    return np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]])


def test_region_reaches_as_far_about_a_face_as_it_is_large() -> None:
    assert regions_around([square(200, 150, 50)], SHAPE) == [Region(150, 100, 300, 250)]


def test_region_ends_with_the_picture() -> None:
    assert regions_around([square(-10, 440, 100)], SHAPE) == [Region(0, 340, 190, 480)]


def test_regions_that_meet_are_one_also_by_way_of_a_third() -> None:
    left, right, between = square(100, 200, 40), square(300, 200, 40), square(200, 200, 60)
    assert len(regions_around([left, right], SHAPE)) == 2
    assert regions_around([left, right, between], SHAPE) == [Region(60, 140, 380, 320)]


def test_part_is_that_of_the_picture() -> None:
    picture = np.arange(480 * 640).reshape(SHAPE)
    region = Region(30, 20, 70, 45)
    part = region.of(picture)
    assert part.shape == (25, 40)
    x, y = region.corner.astype(int)
    assert part[0, 0] == picture[y, x]
    assert np.shares_memory(part, picture)
