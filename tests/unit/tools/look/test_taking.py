"""A lens from what is seen, worked out beside the camera."""

from collections.abc import Iterator

import numpy as np
import pytest
from support.builders import eventually
from support.pictures.boards import target_of
from support.pictures.lens_views import BOARD, PINHOLE, SIZE, board_views

from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.lens.calibration_views import View
from trigpoint.site.target import NOWHERE, Face, Pattern
from trigpoint.tools.look.taking import FEWEST, LensTaking

TARGET = target_of(Face(0, Pattern.CHECKERBOARD, 9, 7, 0.03, *NOWHERE))


@pytest.fixture
def taking() -> Iterator[LensTaking]:
    made = LensTaking([TARGET])
    yield made
    made.close()


def offer(taking: LensTaking, views: list[View]) -> None:
    ids = np.arange(len(BOARD), dtype=np.uint16)
    for view in views:
        taking.offer([FaceSighting("box", 0, ids, view.pixels.astype(np.float32), 0.1)], SIZE)


def test_a_lens_is_taken_beside_the_camera_once_views_tell_it(taking: LensTaking) -> None:
    views = board_views(40, 5)
    offer(taking, views[: FEWEST - 1])
    assert not taking.step()
    assert not taking.is_working
    offer(taking, views)
    assert not taking.step()
    assert taking.is_working
    assert eventually(taking.step)
    assert taking.good is taking.found
    assert taking.good is not None
    found, sigma = taking.good.camera.parameters[:4], taking.good.known.sigma[:4]
    assert np.all(np.abs(found - PINHOLE.parameters[:4]) < 5 * sigma)
    assert not taking.is_working


def test_it_is_not_worked_out_again_where_nothing_is_new(taking: LensTaking) -> None:
    offer(taking, board_views(12, 6))
    taking.step()
    assert eventually(taking.step)
    for _ in range(3):
        offer(taking, board_views(12, 6))
        assert not taking.step()
    assert len(taking.views) == 12
    assert not taking.is_working


def test_at_the_end_all_views_are_used(taking: LensTaking) -> None:
    offer(taking, board_views(FEWEST, 7))
    taking.step()
    offer(taking, board_views(14, 8))
    taking.finish()
    assert taking.found is not None
    assert len(taking.found.used) + len(taking.found.rejected) == FEWEST + 14
    assert taking.best is taking.found


def test_a_board_that_was_never_tilted_gives_no_lens_and_says_why(taking: LensTaking) -> None:
    offer(taking, board_views(14, 9, tilt_deg=2.0))
    taking.finish()
    assert taking.best is None
    assert "focal length" in taking.missing


def test_too_few_views_are_said(taking: LensTaking) -> None:
    offer(taking, board_views(2, 1))
    taking.finish()
    assert taking.best is None
    assert taking.missing == "2 different views are too few for a lens"
