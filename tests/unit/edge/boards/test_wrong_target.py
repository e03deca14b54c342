"""A target file that is not the one in the picture: nothing is found, and what to write is said."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from support.pictures.boards import (
    aprilgrid,
    charuco,
    checkerboard,
    picture_of,
    placed,
    target_of,
    true_pixels,
)
from support.wrong_inputs.targets import shots

from trigpoint.edge.detector import detector_for
from trigpoint.edge.markers.misdescribed import MisdescribedBoards
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.tracker import TargetTracker
from trigpoint.site.target import NOWHERE, Face, Numbering, Pattern

WRONG = [
    # the board, what the file has of it, and what is said
    (charuco(5, 4, legacy=True), {"legacy": False}, "write legacy = true"),
    (charuco(8, 6), {"legacy": True}, "write legacy = false"),
    (charuco(5, 8), {"columns": 8, "rows": 5}, "write columns = 5 and rows = 8"),
    (charuco(5, 7), {"columns": 7, "rows": 5}, "so it is not used; write columns = 5 and rows = 7"),
    (charuco(6, 5), {"columns": 6, "rows": 4}, "a board with columns = 6, rows = 5 or more, so"),
    (charuco(5, 2), {"columns": 4}, "compare columns, rows"),
    (charuco(9, 6), {"columns": 7, "rows": 5}, "a board with columns = 9, rows = 6 or more, so"),
    (charuco(7, 5), {"columns": 8}, "a board with columns = 7, rows = 5 or more, so"),
    (charuco(7, 5), {"first_marker": 20}, "a board with first_marker = 0, so"),
    (charuco(7, 5), {"marker": 0.03}, "a board with marker = 0.045 or so, so"),
    (charuco(5, 4), {"inverted": True}, "write inverted = false"),
    (charuco(5, 4), {"dictionary": "DICT_6X6_250"}, 'write dictionary = "DICT_4X4_250"'),
    (
        replace(charuco(6, 8), dictionary="DICT_6X6_250"),
        {"dictionary": "DICT_4X4_250"},
        'write dictionary = "DICT_6X6_250"',
    ),
    (
        replace(charuco(6, 4, legacy=True), dictionary="DICT_5X5_100"),
        {"dictionary": "DICT_4X4_50", "legacy": False},
        'write dictionary = "DICT_5X5_50" and legacy = true',
    ),
    (
        replace(charuco(7, 5), dictionary="DICT_5X5_100"),
        {"dictionary": "DICT_4X4_50", "columns": 5, "rows": 7},
        'write dictionary = "DICT_5X5_50" and columns = 7 and rows = 5',
    ),
    (aprilgrid(4, 3), {"columns": 3, "rows": 4}, "write columns = 4 and rows = 3"),
    (aprilgrid(4, 3), {"numbering": Numbering.KALIBR}, 'write numbering = "top-left"'),
    (aprilgrid(4, 3), {"border_bits": 2}, "write border_bits = 1"),
    (checkerboard(10, 7), {"columns": 9, "rows": 6}, "write columns = 10 and rows = 7"),
    (checkerboard(10, 7), {"columns": 9}, "write columns = 10 and rows = 7"),
    (checkerboard(9, 7), {"rows": 6}, "write columns = 9 and rows = 7"),
    (checkerboard(7, 9), {"columns": 6, "rows": 8}, "write columns = 7 and rows = 9"),
]


@pytest.mark.parametrize(("true", "described", "remedy"), WRONG)
def test_board_that_the_picture_contradicts_is_not_found_and_said_at_once(
    true: Face, described: dict[str, object], remedy: str
) -> None:
    detector = detector_for([target_of(replace(true, **described))])
    for turn_deg in (0, 25, 200):
        view = placed(true, distance=0.9, turn_deg=turn_deg, yaw_deg=20)
        assert detector.detect(picture_of([view])) == ()
    [line] = detector.misdescribed
    assert remedy in line
    assert line.endswith(remedy) or "; compare" in line


@pytest.mark.parametrize("distance", [2.2, 2.6])
def test_board_of_small_markers_is_said_too(distance: float) -> None:
    """Of a dozen pixels: who looks for squares that touch tags does not see them."""
    true = charuco(5, 4)
    picture = picture_of([placed(true, distance=distance, turn_deg=10, yaw_deg=15)])
    assert detector_for([target_of(true)]).detect(picture)
    detector = detector_for([target_of(replace(true, dictionary="DICT_5X5_250"))])
    assert detector.detect(picture) == ()
    [line] = detector.misdescribed
    assert line.endswith('write dictionary = "DICT_4X4_250"')


@pytest.mark.parametrize(
    ("described", "remedy"),
    [
        ({"columns": 4, "rows": 5}, "write columns = 5 and rows = 4"),
        ({"numbering": Numbering.TOP_LEFT}, 'write numbering = "kalibr"'),
        (
            {"border_bits": 1, "dictionary": "DICT_APRILTAG_25h9"},
            'write dictionary = "DICT_APRILTAG_36h11" and border_bits = 2',
        ),
        ({"marker": 0.05}, "a board with marker = 0.06 or so, so"),
    ],
)
def test_grid_as_kalibr_prints_it_is_said(described: dict[str, object], remedy: str) -> None:
    """Its tags stand on their heads, and touch black squares."""
    true = replace(aprilgrid(5, 4, border_bits=2), numbering=Numbering.KALIBR)
    detector = detector_for([target_of(replace(true, **described))])
    for picture in shots(true, np.random.default_rng(1), 2):
        assert detector.detect(picture) == ()
    [line] = detector.misdescribed
    assert remedy in line


KALIBR = replace(aprilgrid(6, 5, border_bits=2), numbering=Numbering.KALIBR)


@pytest.mark.parametrize(
    ("true", "described", "said"),
    [
        (
            KALIBR,
            charuco(5, 7),
            ["columns = 6", 'pattern = "aprilgrid"', "36h11", "border_bits = 2"],
        ),
        (charuco(8, 6, legacy=True), KALIBR, ["columns = 8", 'pattern = "charuco"', "DICT_4X4"]),
        (
            replace(charuco(7, 10, legacy=True), dictionary="DICT_5X5_100"),
            charuco(6, 5),
            ["columns = 7, rows = 10 or more", "DICT_5X5", "legacy = true"],
        ),
        (
            aprilgrid(5, 4),
            replace(KALIBR, dictionary="DICT_APRILTAG_25h9", columns=3),
            ["columns = 5, rows = 4 or more", "36h11", "border_bits = 1", '"top-left"'],
        ),
    ],
    ids=["a grid", "a ChArUco board", "larger, of other markers", "all of a grid"],
)
def test_board_that_differs_in_all_is_said_whole(
    true: Face, described: Face, said: list[str]
) -> None:
    """Also where the pictures are mirrored."""
    pictures = shots(true, np.random.default_rng(2), 2)
    for is_mirrored in (False, True):
        detector = detector_for([target_of(described)])
        for picture in pictures:
            assert detector.detect(np.fliplr(picture).copy() if is_mirrored else picture) == ()
        [line] = detector.misdescribed
        assert [words for words in said if words not in line] == []
        assert ("mirrored board" in line) is is_mirrored


@pytest.mark.parametrize("hidden", [0, 2])
def test_rows_of_the_sites_other_pattern_may_be_hidden(hidden: int) -> None:
    board = charuco(5, 7, first=30)
    uppermost = replace(KALIBR, id=1, rows=5 - hidden, first_marker=6 * hidden)
    detector = detector_for([target_of(board, replace(KALIBR, id=1))])
    for picture in shots(uppermost, np.random.default_rng(2), 2):
        assert detector.detect(picture)
    assert detector.misdescribed == ()


def test_markers_that_chance_reads_at_an_edge_are_no_board_where_the_board_goes_on() -> None:
    true = Face(0, Pattern.CHARUCO, 7, 5, 0.04, *NOWHERE, marker=0.03, dictionary="DICT_5X5_100")
    described = replace(true, columns=5, rows=7, dictionary="DICT_4X4_50")
    for picture in shots(true, np.random.default_rng(119), 4):
        assert detector_for([target_of(described)]).detect(picture) == ()


@pytest.mark.parametrize("other", ["", "DICT_5X5_1000"])
@pytest.mark.parametrize("face", [charuco(6, 8), aprilgrid(6, 4)], ids=lambda f: f.pattern.value)
def test_mirrored_pictures_are_called_mirrored(face: Face, other: str) -> None:
    described = replace(face, dictionary=other or face.dictionary)
    detector = detector_for([target_of(described)])
    for turn_deg in (0, 200):
        view = placed(face, distance=1.0, turn_deg=turn_deg)
        assert detector.detect(np.fliplr(picture_of([view])).copy()) == ()
    [line] = detector.misdescribed
    assert "mirrored" in line
    assert ("and write dictionary" in line) is bool(other)


def test_checkerboard_of_other_colours_may_be_one_in_mirrored_pictures() -> None:
    face = checkerboard(8, 6)
    detector = detector_for([target_of(face)])
    for picture in shots(face, np.random.default_rng(3), 3):
        assert detector.detect(picture[:, ::-1]) == ()
    [line] = detector.misdescribed
    assert "unless the print is as the file has it: then the pictures are mirrored" in line


def test_size_of_another_board_is_taken_back_when_the_described_one_is_seen() -> None:
    face = charuco(7, 5)
    detector = detector_for([target_of(face)])
    assert detector.detect(picture_of([placed(charuco(9, 6), distance=1.0)])) == ()
    assert "columns = 9" in detector.misdescribed[0]
    assert detector.detect(picture_of([placed(face, distance=0.9)]))
    assert detector.misdescribed == ()
    assert detector.detect(picture_of([placed(charuco(9, 6), distance=1.0)])) == ()
    assert detector.misdescribed == ()


def test_board_of_a_later_face_is_said_of_that_face_and_stays_so_when_the_first_is_seen() -> None:
    first, printed = charuco(5, 7), charuco(8, 6, number=1, first=20)
    detector = detector_for([target_of(first, replace(printed, columns=5, rows=7))])
    random = np.random.default_rng(1)
    said = list[tuple[str, ...]]()
    for face in (printed, first, printed):
        assert bool(detector.detect(shots(face, random, 1)[0])) is (face is first)
        said.append(detector.misdescribed)
    assert said[1:] == said[:-1]
    [line] = said[0]
    assert line.startswith("face 1 ")
    assert "with columns = 8, rows = 6 or more, so" in line


def test_board_is_said_of_another_face_when_the_one_it_was_said_of_is_seen() -> None:
    seen = charuco(8, 6)
    looks = [Appearance(face, "box", face.id) for face in (charuco(5, 7), charuco(7, 9, number=1))]
    boards = MisdescribedBoards(looks, [look.face for look in looks])
    boards.look(shots(seen, np.random.default_rng(1), 1)[0], set())
    [(said_of, _)] = boards.lines.items()
    boards.confirm(said_of)
    [(heir, line)] = boards.lines.items()
    assert {said_of, heir} == set(looks)
    assert line.startswith(f"{heir.words}: the pictures show a board with columns = 8")


def test_board_that_drives_in_is_dropped_when_the_part_that_disagrees_comes_into_view() -> None:
    face = charuco(8, 6, legacy=True)
    tracker = TargetTracker([target_of(replace(face, legacy=False))])
    found = ()
    for index in range(14):
        view = placed(face, distance=0.9, x=0.75 - 0.055 * index)
        found = tracker.detect(picture_of([view]), index * 50_000_000)
    assert found == ()
    [line] = tracker.misdescribed
    assert "write legacy = true" in line


@pytest.mark.parametrize("legacy", [True, False])
def test_part_of_a_board_is_not_taken_for_one_of_the_other_layout(*, legacy: bool) -> None:
    """Its last column, the only one whose markers differ, is out of the picture: of the other
    layout it is one that ends a column early."""
    face = charuco(5, 4, legacy=legacy)
    right, wrong = (detector_for([target_of(each)]) for each in (face, _other_layout(face)))
    seen = 0
    for x in np.linspace(0.18, 0.26, 9):
        for distance, tilt in ((0.45, 0.0), (0.5, 25.0), (0.6, -30.0)):
            view = placed(face, distance=distance, x=float(x) * distance / 0.45, tilt_deg=tilt)
            picture = picture_of([view], noise=2.0)
            seen += len(right.detect(picture))
            assert wrong.detect(picture) == ()
    assert seen > 20


@pytest.mark.parametrize("legacy", [True, False])
def test_two_rows_of_a_part_tell_its_layout(*, legacy: bool) -> None:
    """Of the column in which it would go on, a dark square and a marker are not there."""
    face = charuco(7, 4, legacy=legacy)
    right, wrong = (detector_for([target_of(each)]) for each in (face, _other_layout(face)))
    for turn_deg in (0.0, 8.0, -8.0):
        view = placed(face, distance=0.8, turn_deg=turn_deg)
        inner = true_pixels(view).reshape(3, 6, 2)
        x = inner[:, 4 if legacy else 1, 0].mean()
        y = inner[1:, 0 if legacy else -1, 1].mean()
        beside = np.s_[: round(x)] if legacy else np.s_[round(x) :]
        part = picture_of([view], noise=2.0)[: round(y), beside]
        assert right.detect(part)
        assert wrong.detect(part) == ()


def test_another_checkerboard_is_said_until_the_files_own_is_seen() -> None:
    own, other = checkerboard(9, 6), checkerboard(10, 7)
    detector = detector_for([target_of(own)])
    assert detector.detect(picture_of([placed(other)])) == ()
    assert detector.misdescribed
    assert detector.detect(picture_of([placed(own)]))
    assert detector.misdescribed == ()


def test_where_one_face_is_of_another_layout_the_others_are_not_believed_at_once() -> None:
    """Faces are printed together: a part of another one that fits the file as well waits until it
    was seen so several times."""
    first, second = charuco(5, 4, legacy=True), charuco(5, 4, number=1, first=10)
    detector = detector_for([target_of(replace(first, legacy=False), second)])
    before, after = picture_of([placed(first)]), picture_of([placed(second)])
    assert detector_for([target_of(first, second)]).detect(after)
    assert detector.detect(before) == ()
    assert [len(detector.detect(after)) for _ in range(4)] == [0, 0, 1, 1]


def _other_layout(face: Face) -> Face:
    return replace(face, legacy=not face.legacy)


def test_followed_board_that_is_contradicted_now_and_then_is_found_again() -> None:
    face = charuco(7, 5)
    tracker = TargetTracker([target_of(face)])
    own, other = (picture_of([placed(seen, distance=1.0)]) for seen in (face, charuco(9, 6)))
    faces = [len(tracker.detect(own, index * 50_000_000)) for index in range(40)]
    faces += [len(tracker.detect(other, index * 50_000_000)) for index in range(40, 43)]
    faces += [len(tracker.detect(own, 43 * 50_000_000))]
    assert faces == [1] * 40 + [0] * 3 + [1]
    assert tracker.misdescribed == ()


def test_board_that_another_robot_carries_too_is_found_beside_one_that_is_contradicted() -> None:
    face = replace(charuco(5, 2), columns=4)
    detector = detector_for([target_of(face), target_of(face, name="crate")])
    sound = placed(face, distance=0.8, x=-0.2)
    picture = picture_of([sound, placed(charuco(5, 2), distance=0.8, x=0.2, tilt_deg=10)])
    for _ in range(5):
        [sighting] = detector.detect(picture)
        assert sighting.pixels[:, 0].max() < 320
    assert detector.misdescribed == ()


def test_rest_of_a_board_that_is_contradicted_is_not_found() -> None:
    """Something hides a part of it."""
    true = charuco(9, 6)
    view = placed(true, distance=1.5804, x=-0.11526, y=0.03271, turn_deg=233.549, tilt_deg=-23.922)
    picture = picture_of([view], noise=3.0, seed=90)
    picture[289:438, 265:369] = 90
    assert detector_for([target_of(replace(true, first_marker=1))]).detect(picture) == ()


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
