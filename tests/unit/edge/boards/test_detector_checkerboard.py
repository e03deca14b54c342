"""Checkerboards: where their corners are, in which order, and whose they are."""

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from support.pictures.boards import (
    Placed,
    checkerboard,
    cluttered_picture,
    picture_of,
    placed,
    plain_picture,
    target_of,
    true_pixels,
    worst_error,
)

from trigpoint.edge.detector import detector_for
from trigpoint.geometry import CameraModel

ODD, EVEN = checkerboard(8, 5, number=1), checkerboard(9, 7)


@pytest.mark.parametrize("turn_deg", [0, 40, 135, 180, 270])
def test_board_without_half_turn_is_numbered_truly(turn_deg: float) -> None:
    view = placed(ODD, turn_deg=turn_deg, tilt_deg=25, yaw_deg=-20)
    (face,) = detector_for([target_of(ODD)]).detect(picture_of([view]))
    assert face.corners.tolist() == list(range(28))
    assert worst_error(face.pixels, face.corners, view) < 0.2


@pytest.mark.parametrize("turn_deg", [0, 75, 180, 250])
def test_board_with_half_turn_is_never_mirrored(turn_deg: float) -> None:
    view = placed(EVEN, turn_deg=turn_deg, tilt_deg=-20, yaw_deg=30)
    (face,) = detector_for([target_of(EVEN)]).detect(picture_of([view]))
    turned = (EVEN.corner_count - 1 - face.corners.astype(int)).astype(np.uint16)
    errors = [worst_error(face.pixels, ids, view) for ids in (face.corners, turned)]
    assert min(errors) < 0.2
    assert len(face.corners) == EVEN.corner_count


def test_upright_board_is_numbered_from_the_top_left() -> None:
    view = placed(EVEN, turn_deg=8)
    (face,) = detector_for([target_of(EVEN)]).detect(picture_of([view]))
    assert worst_error(face.pixels, face.corners, view) < 0.2


def test_several_identical_boards_are_each_found_and_not_told_apart() -> None:
    faces = [checkerboard(number=number) for number in range(3)]
    views = [
        placed(faces[0], distance=1.0, x=-0.25, y=-0.15, yaw_deg=30),
        placed(faces[1], distance=1.1, x=0.25, y=-0.15, yaw_deg=-30),
        placed(faces[2], distance=0.9, y=0.2, turn_deg=90),
    ]
    found = detector_for([target_of(*faces, name="star")]).detect(picture_of(views))
    assert [(face.target, face.face) for face in found] == [("star", -1)] * 3
    for view in views:
        middle = true_pixels(view).mean(axis=0)
        nearest = min(np.linalg.norm(face.pixels.mean(axis=0) - middle) for face in found)
        assert nearest < 3


def test_board_that_is_alone_names_target_and_face() -> None:
    faces = [checkerboard(8, 5, number=4), checkerboard(9, 6, number=7)]
    found = detector_for([target_of(*faces)]).detect(picture_of([placed(faces[1], turn_deg=20)]))
    assert [(face.target, face.face) for face in found] == [("box", 7)]


def test_pattern_of_two_robots_names_no_target() -> None:
    robots = [target_of(EVEN, name="one"), target_of(EVEN, name="two")]
    (face,) = detector_for(robots).detect(picture_of([placed(EVEN)]))
    assert (face.target, face.face) == ("", 0)


def test_strong_lens_does_not_cost_corners() -> None:
    camera = CameraModel(640, 480, 400.0, 400.0, 320.0, 240.0, (-0.32, 0.1, 0, 0, 0))
    view = placed(EVEN, distance=0.28, tilt_deg=15)
    (face,) = detector_for([target_of(EVEN)]).detect(picture_of([view], camera=camera))
    assert len(face.corners) == EVEN.corner_count
    truth = true_pixels(view, camera)
    error = min(np.abs(face.pixels - order).max() for order in (truth, truth[::-1]))
    assert error < 0.3


def test_hidden_corners_are_left_out_and_the_others_keep_their_numbers() -> None:
    view = placed(ODD, tilt_deg=20)
    picture = picture_of([view])
    hidden = true_pixels(view)[[9, 12]]
    for x, y in hidden:
        cv2.circle(picture, (round(x), round(y)), 9, 100, -1)
    (face,) = detector_for([target_of(ODD)]).detect(picture)
    assert 20 <= len(face.corners) <= 26
    assert {9, 12}.isdisjoint(face.corners.tolist())
    assert worst_error(face.pixels, face.corners, view) < 0.3


def test_board_that_is_cut_off_by_the_picture_is_not_guessed() -> None:
    view = placed(EVEN, x=-0.45)
    assert detector_for([target_of(EVEN)]).detect(picture_of([view])) == ()


def test_board_of_other_colours_is_not_taken_for_ours() -> None:
    picture = 255 - picture_of([placed(EVEN)])
    assert detector_for([target_of(EVEN)]).detect(picture) == ()


def test_board_of_another_size_is_not_taken_for_ours() -> None:
    picture = picture_of([placed(checkerboard(7, 5))])
    assert detector_for([target_of(EVEN)]).detect(picture) == ()


@pytest.mark.parametrize(("blur_px", "noise"), [(1.5, 3.0), (2.5, 2.0), (0.5, 12.0)])
def test_blurred_and_noisy_board_is_found(blur_px: float, noise: float) -> None:
    view = placed(ODD, tilt_deg=30, yaw_deg=15)
    picture = picture_of([view], blur_px=blur_px, noise=noise)
    (face,) = detector_for([target_of(ODD)]).detect(picture)
    assert len(face.corners) > 24
    assert worst_error(face.pixels, face.corners, view) < 0.8


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_found_in_clutter(seed: int) -> None:
    assert detector_for([target_of(EVEN, ODD)]).detect(cluttered_picture(seed)) == ()


@pytest.mark.parametrize("level", [2.0, 110.0])
@pytest.mark.parametrize("noise", [0.0, 4.0, 40.0])
def test_nothing_is_found_in_noise(level: float, noise: float) -> None:
    picture = plain_picture(level=level, noise=noise)
    assert detector_for([target_of(EVEN, ODD)]).detect(picture) == ()


def test_tiles_without_end_are_no_board() -> None:
    y, x = np.mgrid[0:480, 0:640]
    picture = np.where((x // 16 + y // 16) % 2, 220, 30).astype(np.uint8)
    assert detector_for([target_of(EVEN)]).detect(picture) == ()


def test_colour_picture_gives_the_same_as_grey() -> None:
    picture = picture_of([placed(ODD)])
    detector = detector_for([target_of(ODD)])
    (grey,) = detector.detect(picture)
    (colour,) = detector.detect(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    assert np.array_equal(grey.pixels, colour.pixels)


EXCHANGED = [
    # a board, what the file has of it, and what is said
    ((8, 6), (6, 8), False, "write columns = 8 and rows = 6"),
    ((8, 6), (8, 6), True, "or inverted = false"),
    ((9, 7), (9, 7), True, "write inverted = false"),
]


@pytest.mark.parametrize(("true", "described", "inverted", "remedy"), EXCHANGED)
def test_board_of_the_other_colours_is_named_once_and_not_guessed(
    true: tuple[int, int], described: tuple[int, int], inverted: bool, remedy: str
) -> None:
    wrong = replace(checkerboard(*described), inverted=inverted)
    detector = detector_for([target_of(wrong)])
    for turn_deg in (0, 30, 60):
        view = placed(checkerboard(*true), turn_deg=turn_deg, yaw_deg=20)
        assert detector.detect(picture_of([view])) == ()
    [line] = detector.misdescribed
    assert remedy in line


@pytest.mark.parametrize(
    ("size", "turn_deg"), [((9, 7), 70), ((9, 7), 180), ((8, 6), 0), ((8, 6), 290), ((9, 6), 70)]
)
def test_inverted_board_is_found_as_the_negative_of_one(
    size: tuple[int, int], turn_deg: float
) -> None:
    plain = checkerboard(*size)
    inverted = replace(plain, inverted=True)
    picture = picture_of([placed(plain, turn_deg=turn_deg, tilt_deg=20)])
    (face,) = detector_for([target_of(inverted)]).detect(255 - picture)
    (other,) = detector_for([target_of(plain)]).detect(picture)
    np.testing.assert_array_equal(face.corners, other.corners)
    np.testing.assert_allclose(face.pixels, other.pixels, atol=0.02)


def test_board_that_a_half_turn_inverts_is_numbered_from_its_white_end() -> None:
    """Of 9 × 6 squares two corners are white: from there the others are counted backwards."""
    board = checkerboard(9, 6)
    picture = picture_of([placed(board, turn_deg=10)])
    (face,) = detector_for([target_of(replace(board, inverted=True))]).detect(picture)
    (other,) = detector_for([target_of(board)]).detect(picture)
    np.testing.assert_allclose(face.pixels[::-1], other.pixels, atol=0.05)


def test_board_that_is_described_as_it_is_makes_nobody_wonder() -> None:
    for size in ((9, 7), (8, 6), (9, 6), (6, 8)):
        detector = detector_for([target_of(checkerboard(*size))])
        for columns, rows in ((11, 7), (8, 6), (9, 6)):
            detector.detect(picture_of([placed(checkerboard(columns, rows))]))
        assert bool(detector.misdescribed) is (size == (6, 8))
    both = [checkerboard(8, 6), checkerboard(6, 8, number=1)]
    detector = detector_for([target_of(*both)])
    assert len(detector.detect(picture_of([placed(both[0])]))) == 1
    assert detector.misdescribed == ()


FOCAL_PX, MIDDLE_PX = 200.0, np.array([322.0, 238.0])
"""Of an equidistant lens that has 180 degrees in a circle of 628 pixels."""


@pytest.fixture(scope="module")
def rays() -> np.ndarray:
    """A ray for each fourth of a pixel, (1920, 2560, 3) float32."""
    fine = 4
    u, v = np.meshgrid(*((np.arange(fine * n) + 0.5) / fine - 0.5 for n in (640, 480)))
    place = (np.stack([u, v], axis=-1) - MIDDLE_PX) / FOCAL_PX
    angle = np.linalg.norm(place, axis=-1, keepdims=True)
    across = np.sinc(angle / np.pi) * place
    return np.concatenate([across, np.cos(angle)], axis=-1).astype(np.float32)


def through_a_fisheye(rays: np.ndarray, view: Placed) -> np.ndarray:
    """The picture of a board alone, (480, 640) uint8."""
    face, camera_from_face = view
    plane = camera_from_face.rotation.T
    origin = plane @ camera_from_face.translation
    rays = rays @ plane.T.astype(np.float32)
    reach = origin[2] / rays[..., 2]
    spot = np.floor((reach[..., None] * rays - origin)[..., :2] / face.square).astype(int)
    on = (spot >= -2) & (spot < (face.columns, face.rows))
    inside = (spot >= -1) & (spot < (face.columns - 1, face.rows - 1))
    dark = inside.all(axis=-1) & (spot.sum(axis=-1) % 2 == 0) & (reach > 0)
    light = np.where(dark, 30.0, np.where(on.all(axis=-1) & (reach > 0), 215.0, 110.0))
    return cv2.resize(light, (640, 480), interpolation=cv2.INTER_AREA).astype(np.uint8)


def fisheye_pixels(view: Placed) -> np.ndarray:
    """Where its corners are, (n, 2)."""
    face, camera_from_face = view
    points = face.corners @ camera_from_face.rotation.T + camera_from_face.translation
    across = np.linalg.norm(points[:, :2], axis=1)
    angle = np.arctan2(across, points[:, 2])
    return MIDDLE_PX + FOCAL_PX * (angle / across)[:, None] * points[:, :2]


@pytest.mark.parametrize(("distance", "x", "yaw_deg"), [(0.1, 0.0, 10), (0.15, 0.25, 40)])
def test_fisheye_costs_no_corner(
    rays: np.ndarray, distance: float, x: float, yaw_deg: float
) -> None:
    """Over most of the picture, and towards its rim."""
    view = placed(EVEN, distance=distance, x=x, yaw_deg=yaw_deg, tilt_deg=8)
    (face,) = detector_for([target_of(EVEN)]).detect(through_a_fisheye(rays, view))
    assert len(face.corners) == EVEN.corner_count
    truth = fisheye_pixels(view)
    assert min(np.abs(face.pixels - order).max() for order in (truth, truth[::-1])) < 0.15


@pytest.mark.parametrize(
    ("distance", "x", "yaw_deg", "cut"), [(0.12, 0.1, 20, 200), (0.15, 0.15, 25, 120)]
)
def test_lens_need_not_be_centred(
    rays: np.ndarray, distance: float, x: float, yaw_deg: float, cut: int
) -> None:
    """As where a part of a sensor is read, or a picture was cut."""
    view = placed(EVEN, distance=distance, x=x, yaw_deg=yaw_deg, tilt_deg=8)
    picture = np.ascontiguousarray(through_a_fisheye(rays, view)[:, cut:])
    (face,) = detector_for([target_of(EVEN)]).detect(picture)
    assert len(face.corners) == EVEN.corner_count
    truth = fisheye_pixels(view) - (cut, 0)
    assert min(np.abs(face.pixels - order).max() for order in (truth, truth[::-1])) < 0.15


def test_edge_of_strong_light_costs_no_corner() -> None:
    """Beyond a line through a corner, twice the light falls, and white is cut off."""
    view = placed(EVEN, distance=0.5, tilt_deg=20, yaw_deg=15)
    truth = true_pixels(view)
    y, x = np.mgrid[:480, :640]
    is_lit = (x - truth[30, 0]) * 0.8 + (y - truth[30, 1]) * 0.6 > 0
    light = picture_of([view]) * np.where(is_lit, 2.2, 1.0)
    picture = np.clip(light, 0, 255).astype(np.uint8)
    (face,) = detector_for([target_of(EVEN)]).detect(picture)
    assert len(face.corners) == EVEN.corner_count
    off = min(np.sqrt(np.mean((face.pixels - order) ** 2)) for order in (truth, truth[::-1]))
    assert off < 0.08
