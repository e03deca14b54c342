"""Boards of the file's dictionary in other numbers: what markers tell, and what they leave open."""

import numpy as np
import pytest
from msgspec.structs import replace

from trigpoint.edge.markers.markers import Markers
from trigpoint.edge.markers.other_boards import Reading
from trigpoint.edge.markers.other_sizes import layout_of, other_size
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.site.target import NOWHERE, Face, Numbering, Pattern

GRID = Face(
    *(0, Pattern.APRILGRID, 6, 6, 0.08, *NOWHERE),
    marker=0.06,
    dictionary="DICT_APRILTAG_36h11",
    numbering=Numbering.KALIBR,
)
AS_DESCRIBED = Reading(Appearance(GRID, "box", 0), GRID, False, ())


def read(true: Face, numbers: list[int]) -> Markers:
    """Some of a board's markers, seen from the front."""
    corners = 100.0 + 1000.0 * layout_of(true)[numbers]
    return Markers(np.array(numbers), corners, np.ones(len(numbers)), np.arange(len(numbers)))


def test_a_wider_board_is_told_by_its_rows() -> None:
    true = replace(GRID, columns=11, rows=4)
    found = other_size(AS_DESCRIBED, read(true, list(range(44))))
    assert found is not None
    assert found.face.columns == 11


@pytest.mark.parametrize(("told", "first"), [((0, 60), 0), ((), 6), ((60,), 6)])
def test_grid_whose_lowest_row_is_hidden_begins_as_the_sites(
    told: tuple[int, ...], first: int
) -> None:
    charuco = replace(GRID, pattern=Pattern.CHARUCO, columns=5, rows=7, first_marker=60)
    reading = Reading(Appearance(charuco, "box", 1), charuco, False, ())
    found = other_size(reading, read(GRID, list(range(6, 36))), told)
    assert found is not None
    assert found.face.first_marker == first
    assert found.is_as(GRID) is (first == 0)


@pytest.mark.parametrize("shown", [[*range(7), 11, 12, 13], [*range(10)]])
def test_rows_that_fit_boards_of_several_widths_tell_nothing_false(shown: list[int]) -> None:
    true = replace(GRID, columns=11, rows=4)
    found = other_size(AS_DESCRIBED, read(true, shown))
    assert found is None or found.face.columns == 11


@pytest.mark.parametrize("legacy", [False, True])
def test_a_board_with_another_first_marker_may_be_one_with_as_many_rows_more(legacy: bool) -> None:
    """Half of a board of twice the rows shows the same, so both are said."""
    told = replace(GRID, pattern=Pattern.CHARUCO, columns=6, rows=4)
    true = replace(told, first_marker=12, legacy=legacy)
    markers = read(true, list(range(12)))
    markers = Markers(markers.numbers + 12, markers.corners, markers.scores, markers.quads)
    found = other_size(Reading(Appearance(told, "box", 0), told, False, ()), markers)
    assert found is not None
    printed = ", legacy = true" if legacy else ""
    assert (
        f"a board with first_marker = 12{printed}, or one with columns = 6, rows = 8 or more"
        f"{printed}, its first rows hidden, so it is not used"
    ) in found.remedy
    lower = read(replace(told, rows=8, legacy=legacy), list(range(12, 24)))
    again = other_size(found.reading, lower)
    assert again is not None
    assert again.remedy == found.remedy


def test_a_board_of_which_the_first_row_is_seen_begins_with_it() -> None:
    told = replace(GRID, pattern=Pattern.CHARUCO, columns=6, rows=4)
    markers = read(replace(told, rows=8), list(range(24)))
    found = other_size(Reading(Appearance(told, "box", 0), told, False, ()), markers)
    assert found is not None
    assert "with columns = 6, rows = 8 or more, so" in found.remedy
