"""A target file that is not the one in the picture: nothing is published, and what to write said."""

import numpy as np
import pytest
from boards import aprilgrid, charuco, picture_of, placed, target_of
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from trigpoint.edge.detector import detector_for
from trigpoint.target import Face, Numbering

WRONG = [
    # the board, and what the file has of it
    (charuco(5, 4, legacy=True), {"legacy": False}),
    (charuco(8, 6), {"legacy": True}),
    (charuco(5, 8), {"columns": 8, "rows": 5}),
    (charuco(6, 5), {"columns": 6, "rows": 4}),
    (charuco(5, 4), {"dictionary": "DICT_6X6_250"}),
    (replace(charuco(6, 8), dictionary="DICT_6X6_250"), {"dictionary": "DICT_4X4_250"}),
    (aprilgrid(4, 3), {"columns": 3, "rows": 4}),
    (aprilgrid(4, 3), {"numbering": Numbering.KALIBR, "tags_turned": False}),
]


@pytest.mark.parametrize(("true", "described"), WRONG)
def test_board_that_the_picture_contradicts_is_not_found(
    true: Face, described: dict[str, object]
) -> None:
    detector = detector_for([target_of(replace(true, **described))])
    for turn_deg in (0, 25, 200):
        view = placed(true, distance=0.9, turn_deg=turn_deg, yaw_deg=20)
        assert detector.detect(picture_of([view])) == ()


@settings(max_examples=12, deadline=None)
@given(
    st.sampled_from([charuco(5, 4), charuco(8, 6, legacy=True), aprilgrid(4, 3)]),
    st.floats(0.5, 1.4),
    st.floats(0, 360),
    st.floats(-40, 40),
    st.integers(0, 9),
)
def test_board_as_described_is_never_contradicted(
    face: Face, distance: float, turn_deg: float, tilt_deg: float, seed: int
) -> None:
    view = placed(face, distance=distance, turn_deg=turn_deg, tilt_deg=tilt_deg)
    picture = picture_of([view], noise=2.0, seed=seed)
    picture[:, : 100 + 20 * seed] = np.uint8(90)  # something stands before it
    detector = detector_for([target_of(face)])
    detector.detect(picture)
    assert detector.misdescribed == ()
