"""Dark quadrilaterals: each once, clockwise, and none where a picture is too crowded."""

import cv2
import numpy as np
import pytest

from trigpoint.edge.image.region import Region
from trigpoint.edge.markers import quads as quads_module
from trigpoint.edge.markers.quads import MOST_RUNS, QuadFinder, dark_runs


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


def test_only_the_longest_of_many_pieces_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quads_module, "MOST_PIECES", 2)
    found = QuadFinder().find(with_squares(10, 20, 30, 40))
    assert sorted(np.ptp(quad, axis=0)[0] for quad in found) == pytest.approx([29, 39], abs=2)


def test_crowded_picture_is_not_outlined(monkeypatch: pytest.MonkeyPatch) -> None:
    outlined: list[int] = []

    def counted(dark: np.ndarray, _: float) -> list[np.ndarray]:
        outlined.append(dark_runs(dark, np.zeros_like(dark)))
        return []

    monkeypatch.setattr(quads_module, "_outer_contours", counted)
    noise = np.random.default_rng(0).integers(0, 255, (480, 640)).astype(np.uint8)
    wall = (np.indices((480, 640)).sum(axis=0) % 2 * 200).astype(np.uint8)
    for picture in (noise, wall, with_squares(16)):
        QuadFinder().find(picture)
    assert all(runs <= MOST_RUNS for runs in outlined)
    assert 2 <= len(outlined) < 6
