"""Dark quadrilaterals: each once, clockwise, and none where a picture is too crowded."""

import cv2
import numpy as np
import pytest

from trigpoint.edge.image.region import Region
from trigpoint.edge.markers.quads import MOST_PIECES, QuadFinder


def with_squares(*sides: int) -> np.ndarray:
    picture = np.full((480, 640), 200, np.uint8)
    for index, side in enumerate(sides):
        x = 40 + 120 * index
        cv2.rectangle(picture, (x, 100), (x + side - 1, 100 + side - 1), (30,), -1)
    return picture


@pytest.mark.parametrize("side", [8, 16, 40, 90])
def test_square_is_found_once_and_clockwise(side: int) -> None:
    (quad,) = QuadFinder().find(with_squares(side))
    start = int(np.argmin(quad.sum(axis=1)))
    expected = 100 + (side - 1) * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) - [60, 0]
    assert np.roll(quad, -start, axis=0) == pytest.approx(expected, abs=1.5)


def test_what_runs_out_of_the_picture_is_no_quadrilateral() -> None:
    picture = np.full((480, 640), 200, np.uint8)
    picture[:30, :30] = 30
    assert len(QuadFinder().find(picture)) == 0


def test_only_a_region_is_searched_and_its_pixels_are_the_picture_s() -> None:
    (quad,) = QuadFinder().find(with_squares(16, 20), within=Region(150, 80, 300, 150))
    assert quad.min(axis=0) == pytest.approx([160, 100], abs=1.5)
    assert np.ptp(quad, axis=0) == pytest.approx([19, 19], abs=1.5)


def test_time_that_is_up_ends_the_search() -> None:
    assert len(QuadFinder().find(with_squares(16), lambda: True)) == 0


def test_only_the_longest_of_many_pieces_are_looked_at() -> None:
    picture = np.full((1200, 1600), 200, np.uint8)
    places = [(x, y) for y in range(10, 1180, 30) for x in range(10, 1580, 30)]
    for number, (x, y) in enumerate(places):
        side = 18 if number % 40 == 0 else 12
        cv2.rectangle(picture, (x, y), (x + side - 1, y + side - 1), (30,), -1)
    found = QuadFinder().find(picture)
    large = sum(np.ptp(quad[:, 0]) > 15 for quad in found)
    assert len(places) > 2 * MOST_PIECES
    assert large == len(range(0, len(places), 40))
    assert len(found) <= 2 * MOST_PIECES


def test_crowded_picture_is_not_outlined() -> None:
    wall = (np.indices((480, 640)).sum(axis=0) % 2 * 200).astype(np.uint8)
    wall[200:280, 200:280] = 200
    wall[220:260, 220:260] = 30
    noise = np.random.default_rng(0).integers(0, 255, (480, 640)).astype(np.uint8)
    for picture in (wall, noise):
        assert len(QuadFinder().find(picture, within=Region.whole(picture))) == 0
