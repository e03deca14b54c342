"""Pictures that no camera should take: nothing is found in them, and the work stays bounded."""

import numpy as np
import pytest
from boards import aprilgrid, charuco, checkerboard, target_of

from benchmarks.empty_pictures import empty_picture
from trigpoint.edge import grid, saddles
from trigpoint.edge import planar_fit as planar_fit_module
from trigpoint.edge.detector import detector_for
from trigpoint.edge.tracker import TargetTracker
from trigpoint.errors import InputError

TARGET = target_of(checkerboard(), charuco(number=1), aprilgrid(number=2))
MOST_FITS = 900


@pytest.mark.parametrize("number", range(24))
def test_nothing_is_found_where_nothing_is(number: int) -> None:
    assert detector_for([TARGET]).detect(empty_picture(number)) == ()


def test_work_is_bounded_whatever_the_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = [0]
    linearised = planar_fit_module._linearised

    def counted(*arguments: object) -> object:
        fits[0] += 1
        return linearised(*arguments)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(planar_fit_module, "_linearised", counted)
    detector = detector_for([TARGET])
    for picture in nasty_pictures():
        fits[0] = 0
        detector.detect(picture)
        assert fits[0] < 12 * MOST_FITS


def test_saddles_are_no_more_than_the_bound() -> None:
    for picture in nasty_pictures():
        found = saddles.find_saddles(saddles.Curvature.of(picture))
        assert len(found) <= saddles.MOST_SADDLES
        assert len(grid.find_grids(found)) <= saddles.MOST_SADDLES // grid.LEAST_CORNERS


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((0, 10), np.uint8),
        np.zeros((10, 0, 3), np.uint8),
        np.zeros((20, 20), np.uint16),
        np.zeros((20, 20, 4), np.uint8),
        np.zeros(20, np.uint8),
    ],
)
def test_what_is_no_picture_is_refused_in_one_line(picture: np.ndarray) -> None:
    with pytest.raises(InputError) as raised:
        TargetTracker([TARGET]).detect(picture, 1)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("shape", [(1, 1), (1, 700), (700, 1), (2, 2), (17, 3, 3)])
def test_smallest_pictures_show_nothing(shape: tuple[int, ...]) -> None:
    assert TargetTracker([TARGET]).detect(np.full(shape, 90, np.uint8), 1) == ()


def nasty_pictures() -> list[np.ndarray]:
    """Chequered walls of every pitch, noise of every strength, one of each of them at once."""
    y, x = np.mgrid[0:480, 0:640]
    random = np.random.default_rng(5)
    walls = [np.where((x // n + y // n) % 2, 220, 30) for n in (2, 3, 5, 8, 13, 24)]
    noises = [np.clip(random.normal(n, n, x.shape), 0, 255) for n in (1, 8, 60)]
    mixed = [np.clip(walls[3] + random.normal(0, 40, x.shape), 0, 255)]
    return [picture.astype(np.uint8) for picture in (*walls, *noises, *mixed)]
