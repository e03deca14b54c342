"""A lens from views: is it right, are its sigmas true, and what is taken and left out."""

import re
from functools import cache
from itertools import pairwise

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from support.pictures.lens_views import BOARD, FISHEYE, PINHOLE, SIZE, board_views

from trigpoint.base.errors import OperationError
from trigpoint.edge.lens.calibration import Calibration, calibrate
from trigpoint.edge.lens.calibration_choice import Candidate, choose
from trigpoint.edge.lens.calibration_fit import Fit, fit, place
from trigpoint.edge.lens.calibration_information import most_informative, view_information
from trigpoint.edge.lens.calibration_knowledge import knowledge
from trigpoint.edge.lens.calibration_looks import looks_of
from trigpoint.edge.lens.calibration_text import calibration_record, calibration_text
from trigpoint.edge.lens.calibration_views import View
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import exp


def worst_pixel_error(found: CameraModel, true: CameraModel) -> float:
    """How far apart two lenses put what lies within the picture's middle two thirds, pixels."""
    u, v = np.meshgrid(np.linspace(107, 533, 15), np.linspace(80, 400, 11))
    directions = true.directions(np.stack([u, v], axis=-1).reshape(-1, 2))
    points = np.column_stack([directions, np.ones(len(directions))])
    return float(np.linalg.norm(found.project(points) - true.project(points), axis=-1).max())


def fitted(camera: CameraModel, views: list[View]) -> Fit:
    """The fit of a lens's model that begins at the lens itself, which saves the search."""
    placed = [one for view in views if (one := place(camera, view))]
    start = Fit(
        camera, tuple(one.camera_from_face for one in placed), tuple(one.error for one in placed)
    )
    found = fit(camera.model, views, SIZE, start=start)
    assert found is not None
    return found


@cache
def found_of(camera: CameraModel) -> Calibration:
    """What sixteen views tell of a lens."""
    return calibrate(board_views(16, 1, camera=camera), SIZE)


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
def test_lens_and_its_model_are_found(camera: CameraModel) -> None:
    found = found_of(camera)
    assert found.camera.model is camera.model
    difference = np.abs(found.camera.parameters - camera.parameters)
    assert np.all(difference < 4 * found.known.sigma)
    assert found.known.noise_px == pytest.approx(0.1, rel=0.1)
    assert found.known.disagreement < 1.4
    assert not found.rejected
    assert not found.doubts


@pytest.mark.parametrize(("camera", "count"), [(PINHOLE, 12), (FISHEYE, 15)])
def test_sigmas_are_true(camera: CameraModel, count: int) -> None:
    errors = []
    for seed in range(16):
        views = board_views(count, 100 + seed, camera=camera)
        found = fitted(camera, views)
        difference = found.camera.parameters - camera.parameters
        errors.append(difference / knowledge(found, views).sigma)
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.25  # of few views rather too large


def test_fit_is_opencvs_where_that_finds_it() -> None:
    views = board_views(20, 3)
    found = fit(LensModel.PLUMB_BOB, views, SIZE)
    assert found is not None
    points = [view.points.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    _, matrix, distortion, *_, theirs, _, _ = cv2.calibrateCameraExtended(
        points, pixels, SIZE, np.eye(3), np.zeros(5)
    )
    sigma = theirs.reshape(-1)[:9]
    camera = np.concatenate([matrix[[0, 1, 0, 1], [0, 1, 2, 2]], distortion.reshape(-1)])
    assert np.all(np.abs(found.camera.parameters - camera) < 0.3 * sigma)
    # Ours also hold for what boards and lenses do beside the corners' scatter.
    known = knowledge(found, views)
    assert np.all(known.sigma > 0.95 * sigma)
    assert np.all(known.sigma < 2.0 * sigma)


@pytest.mark.parametrize("half_angle_deg", [20, 88])
def test_any_field_of_view_is_found_from_nothing(half_angle_deg: float) -> None:
    focal = 400 / np.radians(half_angle_deg)
    true = CameraModel(
        *SIZE, focal, 1.004 * focal, 326.0, 236.0, (0.03, -0.01, 0.0, 0.0), LensModel.EQUIDISTANT
    )
    near = 0.6 if half_angle_deg < 30 else 0.3
    found = calibrate(board_views(14, 21, camera=true, near=near), SIZE)
    assert found.fit.rms_px < 0.2
    assert worst_pixel_error(found.camera, true) < 6.0
    assert not found.doubts


def bent(view: View, random: np.random.Generator) -> View:
    """A board that is curved by another millimetre or so in each view."""
    depth = random.normal(0, 0.0015) * np.square((BOARD[:, 0] - 0.105) / 0.105)
    points = BOARD + np.column_stack([0 * depth, 0 * depth, depth])
    pose = place(PINHOLE, view)
    assert pose is not None
    moved = PINHOLE.project(pose.camera_from_face @ points)
    straight = PINHOLE.project(pose.camera_from_face @ BOARD)
    return replace(view, pixels=view.pixels + moved - straight)


def test_bent_board_makes_sigmas_larger_as_it_makes_errors() -> None:
    errors, disagreements = [], []
    for seed in range(10):
        random = np.random.default_rng(seed)
        views = [bent(view, random) for view in board_views(25, 200 + seed)]
        found = fitted(PINHOLE, views)
        known = knowledge(found, views)
        errors.append((found.camera.parameters - PINHOLE.parameters) / known.sigma)
        disagreements.append(known.disagreement)
    assert np.mean(disagreements) > 1.5
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_bad_views_are_rejected_and_spoil_nothing() -> None:
    views = board_views(14, 5)
    random = np.random.default_rng(5)
    for i in (3, 11):
        smeared = views[i].pixels + random.normal(0, 2.0, views[i].pixels.shape)
        views[i] = replace(views[i], pixels=smeared)
    found = calibrate(views, SIZE)
    assert sorted(bad.name for bad in found.rejected) == ["v11", "v3"]
    assert min(bad.rms_px for bad in found.rejected) > 1.5
    assert worst_pixel_error(found.camera, PINHOLE) < 2.0


def noisy(view: View, name: str, seed: int, noise: float = 0.1) -> View:
    """The same view with other noise."""
    random = np.random.default_rng(seed)
    return replace(view, name=name, pixels=view.pixels + random.normal(0, noise, (len(view), 2)))


def test_views_that_are_alike_count_as_one() -> None:
    telling, frontal = board_views(12, 6), board_views(1, 7, tilt_deg=2.0, near=0.7)[0]
    alike = [noisy(frontal, f"same{i}", i) for i in range(8)]
    alone, both = calibrate(telling, SIZE), calibrate([*alike, *telling], SIZE)
    assert both.looks <= 13
    assert len(both.used) == 20
    assert np.all(both.known.sigma[:4] > 0.7 * alone.known.sigma[:4])
    assert worst_pixel_error(both.camera, PINHOLE) < 4.0


def test_of_more_views_than_a_fit_takes_those_that_tell_most_are_used() -> None:
    telling, frontal = board_views(20, 6), board_views(1, 7, tilt_deg=2.0, near=0.7)[0]
    found = calibrate([noisy(frontal, f"same{i}", i) for i in range(60)] + telling, SIZE, most=30)
    taken = [view.name for view in found.used]
    assert sum(name.startswith("v") for name in taken) >= 18
    assert found.spare == 50


def test_copies_of_one_view_determine_nothing() -> None:
    for camera in (PINHOLE, FISHEYE):
        view = board_views(1, 8, camera=camera)[0]
        found = calibrate([noisy(view, str(i), i) for i in range(12)], SIZE)
        assert found.looks == 1
        [doubt] = found.doubts
        assert calibration_record(found)["intrinsics"]["sigma"]["fx"] is None  # pyright: ignore[reportIndexIssue, reportArgumentType, reportCallIssue]
        assert "fx" in calibration_text(found)
        assert "12 views of the board show one view of it" in str(doubt)


def test_view_read_from_the_other_end_is_still_the_same() -> None:
    view = board_views(1, 8)[0]
    middle = (BOARD.max(axis=0) + BOARD.min(axis=0)) / 2
    turned = replace(noisy(view, "turned", 1), points=2 * middle - view.points)
    assert looks_of([view, turned, board_views(2, 8)[1]], SIZE[0]).tolist() == [0, 0, 1]


@pytest.mark.parametrize(("camera", "tilt_deg"), [(PINHOLE, 4.0), (FISHEYE, 0.0)])
def test_a_board_that_was_never_tilted_leaves_the_focal_length_open(
    camera: CameraModel, tilt_deg: float
) -> None:
    found = calibrate(board_views(10, 3, camera=camera, tilt_deg=tilt_deg), SIZE)
    assert "focal length: the board was never tilted" in str(found.doubts[0])
    assert "not determined: focal length" in calibration_text(found)


def test_a_bow_of_the_board_is_no_focal_length() -> None:
    """A board of 0.3 m that is bent by 0.4 mm and hardly tilted: all views agree on what is wrong,
    so only who allows for a bow knows that nothing is known."""
    depth = 0.0004 * np.square((BOARD[:, 0] - 0.105) / 0.105)
    views = []
    for view in board_views(20, 4, tilt_deg=7.0):
        pose = place(PINHOLE, view)
        assert pose is not None
        bow = np.column_stack([0 * depth, 0 * depth, depth])
        pixels = view.pixels + PINHOLE.project(pose.camera_from_face @ (BOARD + bow))
        views.append(replace(view, pixels=pixels - PINHOLE.project(pose.camera_from_face @ BOARD)))
    found = calibrate(views, SIZE)
    off = abs(found.camera.fx - PINHOLE.fx)
    assert found.doubts or off < 3 * found.known.sigma[0]


def test_views_that_no_lens_explains_are_said_to_be_so() -> None:
    shaken = board_views(12, 1, noise=1.5)
    assert "no model explains the views" in str(calibrate(shaken, SIZE).doubts)


def test_greedy_choice_prefers_what_is_not_known_yet() -> None:
    along_x, along_y = np.diag([4.0, 0.1]), np.diag([0.1, 1.0])
    assert most_informative([along_x, along_x, along_y], fewest=2, most=2, gain=0.0) == [0, 2]
    assert most_informative([along_x] * 300, fewest=2, most=300, gain=0.05)[:2] == [0, 1]
    assert len(most_informative([along_x] * 300, fewest=2, most=300, gain=0.05)) < 30


def test_slanted_view_tells_more_of_the_focal_length_than_a_frontal_one() -> None:
    plain = CameraModel(*SIZE, 540.0, 540.0, 320.0, 240.0)

    def information(tilt_deg: float) -> float:
        pose = Pose(exp([np.radians(tilt_deg), 0.0, 0.0]), np.array([-0.1, -0.08, 0.7]))
        view = View("", BOARD, plain.project(pose @ BOARD), 0.1)
        focal = np.array([1.0, 1.0, *np.zeros(7)])
        return float(focal @ view_information(plain, pose, view) @ focal)

    assert 10 * information(1.0) < information(20.0) < information(45.0)


def test_richer_model_must_be_better_beyond_chance() -> None:
    views = board_views(20, 9)
    found = fit(LensModel.PLUMB_BOB, views, SIZE)
    errors = np.random.default_rng(9).uniform(0.9, 1.1, 20)
    plain = Candidate(LensModel.PLUMB_BOB, found, errors)
    lucky = Candidate(LensModel.RATIONAL_POLYNOMIAL, found, errors[::-1] - 1e-3)
    better = Candidate(LensModel.RATIONAL_POLYNOMIAL, found, 0.8 * errors)
    lost = np.where(np.arange(20) == 4, np.inf, 0.8 * errors)
    assert choose([plain, lucky]) is plain
    assert choose([plain, better]) is better
    assert choose([replace(plain, fit=None), lucky]) is lucky
    assert choose([plain, replace(better, held_out=np.full(20, np.inf))]) is plain
    assert choose([plain, replace(better, held_out=lost)]) is plain
    assert choose([replace(plain, fit=None)]) is None


def test_too_few_views_are_refused_with_what_to_do() -> None:
    with pytest.raises(OperationError, match=r"3 views.*needs 4.*add pictures"):
        calibrate(board_views(3, 1), SIZE)


def test_text_and_record_say_the_same() -> None:
    found = found_of(PINHOLE)
    text, record = calibration_text(found), calibration_record(found)
    assert re.search(r"^  fx  [\d.]+ px ± [\d.]+ px$", text, re.MULTILINE)
    assert re.search(r"^  k1  -?[\d.]+ ± [\d.]+$", text, re.MULTILINE)
    assert "16 views used, 16 of them different, 0 rejected" in text
    assert f"model {found.camera.model.value}" in text
    intrinsics = record["intrinsics"]
    assert isinstance(intrinsics, dict)
    assert intrinsics["k"] == found.camera.matrix.reshape(-1).tolist()
    assert intrinsics["sigma"]["fy"] == found.known.sigma[1]
    assert record["used"] == [view.name for view in found.used]


def test_board_shown_on_a_monitor_is_left_out_and_said() -> None:
    """The monitor shows another picture of the same camera, so its lens bends that twice."""
    views = [replace(view, board=("box", 0)) for view in board_views(16, 5)]
    monitor = Pose(exp([0.1, -0.3, 0.05]), np.array([-0.2, -0.1, 0.9]))
    shown = [_on(monitor, other, view.name) for view, other in pairwise(views)]
    found = calibrate([*views, *shown], SIZE)
    assert [bad.name for bad in found.rejected if bad.is_double] == [v.name for v in shown]
    assert found.known.noise_px == pytest.approx(0.1, rel=0.15)
    assert "two places of this picture" in calibration_text(found)


def _on(monitor: Pose, shown: View, name: str) -> View:
    """A view on a monitor of 40 cm."""
    plane = np.column_stack([shown.pixels * (0.4 / SIZE[0]), np.zeros(len(shown.pixels))])
    return replace(shown, name=name, pixels=PINHOLE.project(monitor @ plane))


def test_halves_of_a_set_agree_within_their_sigmas() -> None:
    """With a board that is bent another way in every view, as cardboard in a hand."""
    pulls = []
    for seed in range(6):
        random = np.random.default_rng(seed)
        views = [bent(view, random) for view in board_views(30, 300 + seed)]
        halves = [views[half::2] for half in (0, 1)]
        first, second = (fitted(PINHOLE, half) for half in halves)
        sigmas = [knowledge(*pair).sigma for pair in zip((first, second), halves, strict=True)]
        pulls.append((first.camera.parameters - second.camera.parameters) / np.hypot(*sigmas))
    assert np.mean(np.abs(pulls) < 2) > 0.9
