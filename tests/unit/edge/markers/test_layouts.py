"""Parts of a board that fit several layouts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from support.pictures.boards import aprilgrid, charuco, picture_of, placed, true_pixels

from trigpoint.edge.detector import detector_for
from trigpoint.edge.markers.layouts import as_well
from trigpoint.edge.markers.other_sizes import layout_of
from trigpoint.site.target import Numbering, Target


@given(columns=st.integers(2, 12), rows=st.integers(2, 12), data=st.data())
def test_a_part_fits_another_layout_where_its_markers_lie_alike_in_both(
    columns: int, rows: int, data: st.DataObject
) -> None:
    face = replace(charuco(), columns=columns, rows=rows, dictionary="DICT_4X4_250")
    markers = st.integers(0, face.marker_count - 1)
    numbers = np.array(sorted(data.draw(st.sets(markers, min_size=1, max_size=6))))
    own, legacy = (layout_of(replace(face, legacy=old))[numbers, 0] for old in (False, True))
    is_alike = np.allclose(own - own[0], legacy - legacy[0])
    if is_alike and rows % 2 == 0:
        assert as_well(face, numbers)
    if len(numbers) == face.marker_count:
        assert as_well(face, numbers) == ""


def test_one_row_of_a_grid_tells_no_numbering() -> None:
    face = aprilgrid()
    row, other = np.arange(face.columns), np.array([0, face.columns])
    assert as_well(face, row) == f'numbering = "{Numbering.KALIBR.value}"'
    assert as_well(face, other) == ""


@pytest.mark.parametrize("legacy", [False, True])
def test_a_part_that_fits_both_layouts_is_used_once_more_was_seen(legacy: bool) -> None:
    """Two markers of a row: a square beside where they are, by the other layout."""
    printed = replace(charuco(), columns=7, rows=4, legacy=legacy)
    view = placed(printed, distance=0.8)
    whole = picture_of([view])
    corners = true_pixels(view).reshape(3, 6, 2)
    below, beside = 0.3 * corners[0, -1] + 0.7 * corners[1, -1], corners[0, -1] + 10
    part = whole[: round(below[1]), : round(beside[0])]  # no marker of other rows or behind these
    for written in (printed, replace(printed, legacy=not legacy)):
        detector = detector_for([Target("t", (written,))])
        for number in range(3):
            assert not detector.detect(part)
            assert any("may as well be with" in line for line in detector.misdescribed) is (
                number == 2
            )
        is_right = written == printed
        assert bool(detector.detect(whole)) is is_right
        assert bool(detector.detect(part)) is is_right
        assert bool(detector.misdescribed) is not is_right
