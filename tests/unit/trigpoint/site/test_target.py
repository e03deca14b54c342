from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec import Struct
from support.builders import TARGET_TEXT, make_target

from trigpoint.base.errors import TargetError
from trigpoint.site.target import Face, Numbering, Pattern, load_target, parse_target


def make_face(**changes: object) -> Face:
    values: dict[str, object] = {
        "id": 0,
        "pattern": Pattern.CHECKERBOARD,
        "columns": 9,
        "rows": 7,
        "square": 0.03,
        "translation": (0.0, 0.0, 0.0),
        "quaternion": (0.0, 0.0, 0.0, 1.0),
    }
    return Face(**values | changes)  # pyright: ignore[reportArgumentType]


MARKED: dict[str, object] = {"marker": 0.02, "dictionary": "DICT_4X4_100"}


def test_checkerboard_corners_are_the_inner_ones_row_by_row() -> None:
    face = make_face()
    corners = face.corners
    assert corners.shape == (48, 3) == (face.corner_count, 3)
    np.testing.assert_allclose(corners[0], [0, 0, 0])
    np.testing.assert_allclose(corners[1], [0.03, 0, 0])
    np.testing.assert_allclose(corners[8], [0, 0.03, 0])


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"square": 30}, "write square = 0.03"),
        ({"square": 114.4, "marker": 88}, "write square = 0.1144 and marker = 0.088"),
        ({"square": 3}, "square = 0.03 if they were centimetres"),
        ({"square": 1.5}, "square = 0.0381 if they were inches"),
        ({"square": 0.00003}, "too small"),
        ({"translation": (12.0, 0, 28.0)}, r"\[0.12, 0, 0.28\] if they were centimetres"),
        ({"translation": (150.0, 0.0, 500.0)}, r"write translation = \[0.15, 0, 0.5\]"),
    ],
)
def test_lengths_in_other_units_are_refused(changes: dict[str, object], remedy: str) -> None:
    with pytest.raises(ValueError, match=remedy):
        make_face(**changes)


def test_charuco_corners_are_opencvs_from_corner_0_on() -> None:
    face = make_face(pattern=Pattern.CHARUCO, columns=5, rows=7, **MARKED)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    board = cv2.aruco.CharucoBoard((5, 7), 0.03, 0.02, dictionary)
    theirs = np.asarray(board.getChessboardCorners()).reshape(-1, 3)
    np.testing.assert_allclose(face.corners, theirs - [0.03, 0.03, 0], atol=1e-7)
    assert face.marker_count == len(board.getIds())


def test_aprilgrid_corners_go_clockwise_round_each_tag() -> None:
    face = make_face(pattern=Pattern.APRILGRID, columns=3, rows=2, **MARKED)
    assert (face.corner_count, face.marker_count) == (24, 6)
    around = np.array([[0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0], [0, 0.02, 0]])
    last_but_one = np.array([0.03, 0.03, 0])
    np.testing.assert_allclose(face.corners[:4], around)
    np.testing.assert_allclose(face.corners[4 * 4 : 4 * 5], around + last_but_one)


def test_kalibrs_tags_are_counted_from_the_bottom_left() -> None:
    face = make_face(
        pattern=Pattern.APRILGRID, columns=3, rows=2, numbering=Numbering.KALIBR, **MARKED
    )
    around = np.array([[0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0], [0, 0.02, 0]])
    np.testing.assert_allclose(face.corners[:4], around)
    np.testing.assert_allclose(face.corners[4:8], around + np.array([0.03, 0, 0]))
    np.testing.assert_allclose(face.corners[12:16], around - np.array([0, 0.03, 0]), atol=1e-12)
    # Their corners are touched by squares as large as what lies between tags.
    np.testing.assert_allclose(face.outline[0], [-0.01, -0.04, 0], atol=1e-12)
    np.testing.assert_allclose(face.outline[2], [0.09, 0.03, 0], atol=1e-12)


@pytest.mark.parametrize("pattern", list(Pattern))
def test_outline_holds_every_corner(pattern: Pattern) -> None:
    face = make_face(pattern=pattern, **({} if pattern is Pattern.CHECKERBOARD else MARKED))
    low, high = face.outline.min(axis=0), face.outline.max(axis=0)
    assert np.all(face.corners >= low)
    assert np.all(face.corners <= high)


@pytest.mark.parametrize(("columns", "rows", "both"), [(9, 7, True), (8, 6, True), (9, 6, False)])
def test_half_turn_is_told_from_the_counts_parity(columns: int, rows: int, both: bool) -> None:
    assert make_face(columns=columns, rows=rows).reads_from_both_ends is both


def test_marked_patterns_never_read_from_both_ends() -> None:
    assert not make_face(pattern=Pattern.CHARUCO, **MARKED).reads_from_both_ends


class Bad(Struct, frozen=True):
    old: str
    new: str
    complaint: str


@pytest.mark.parametrize(
    "bad",
    [
        Bad("columns = 9", "columns = 7", "as many columns as rows"),
        Bad("columns = 9", "columns = 2", "at least 3 columns"),
        Bad("columns = 9", "colums = 9", "did you mean «columns»"),
        Bad("columns = 9", "columns = -1", "faces[0].columns"),
        Bad("quaternion = [0.5, -0.5, 0.5, -0.5]", "quaternion = [1, 1, 0, 0]", "length is 1.4142"),
        Bad("quaternion = [0.5, -0.5, 0.5, -0.5]", "quaternion = [0.5]", "faces[0].quaternion"),
        Bad("marker = 0.03\n", "", "charuco face needs the key «marker»"),
        Bad("marker = 0.03", "marker = 0.05", "(0.05 m) must be smaller than the square"),
        Bad('dictionary = "DICT_4X4_100"', "", "needs the key «dictionary»"),
        Bad("id = 1", "id = 0", "two faces have the id 0"),
        Bad('pattern = "charuco"', 'pattern = "dots"', "faces[1].pattern"),
    ],
)
def test_bad_target_is_refused_with_one_line(bad: Bad) -> None:
    assert bad.old in TARGET_TEXT
    with pytest.raises(TargetError) as caught:
        parse_target(TARGET_TEXT.replace(bad.old, bad.new))
    assert bad.complaint in str(caught.value)
    assert str(caught.value).startswith("target.toml")
    assert "\n" not in str(caught.value)


def test_error_in_the_second_face_names_its_line() -> None:
    text = TARGET_TEXT.replace("square = 0.04", "square = 0.0")
    line = 1 + text.splitlines().index("square = 0.0")
    with pytest.raises(TargetError, match=rf"target\.toml:{line}: faces\[1\]\.square"):
        parse_target(text)


def test_faces_may_not_share_some_of_their_markers() -> None:
    second = TARGET_TEXT[TARGET_TEXT.index("[[faces]]\nid = 1") :]
    third = second.replace("id = 1", "id = 2").replace(
        'dictionary = "DICT_4X4_100"', 'dictionary = "DICT_4X4_100"\nfirst_marker = 10'
    )
    with pytest.raises(TargetError, match="faces 1 and 2 share markers from 10"):
        parse_target(f"{TARGET_TEXT}\n{third}")


def test_target_without_a_face_is_refused() -> None:
    with pytest.raises(TargetError, match="at least one face"):
        parse_target('name = "t"\nfaces = []')


def test_absent_target_file_names_its_path(tmp_path: Path) -> None:
    with pytest.raises(TargetError, match=r"missing\.toml: there is no such target file"):
        load_target(tmp_path / "missing.toml")


def test_faces_that_look_alike_are_told() -> None:
    faces = (make_face(), make_face(id=1), make_face(id=2, columns=8))
    target = make_target().__class__("t", faces)
    alike = target.look_alikes(faces[0].appearance)
    assert [face.id for face in alike] == [0, 1]
    assert target.face(2) is faces[2]
    with pytest.raises(TargetError, match="«t» has no face 7"):
        target.face(7)
