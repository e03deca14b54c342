"""A lens from views: is it right, are its sigmas true, and what is taken and left out."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from lens_views import BOARD, FISHEYE, PINHOLE, SIZE, board_views

from trigpoint.edge.lens.calibration import calibrate
from trigpoint.edge.lens.calibration_choice import Candidate, choose
from trigpoint.edge.lens.calibration_fit import fit, place
from trigpoint.edge.lens.calibration_information import (
    knowledge,
    most_informative,
    view_information,
)
from trigpoint.edge.lens.calibration_text import advice, calibration_record, calibration_text
from trigpoint.edge.lens.calibration_views import View
from trigpoint.errors import InputError
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import exp


def worst_pixel_error(found: CameraModel, true: CameraModel) -> float:
    """How far apart two lenses put what lies within the picture's middle two thirds, pixels."""
    u, v = np.meshgrid(np.linspace(107, 533, 15), np.linspace(80, 400, 11))
    directions = true.directions(np.stack([u, v], axis=-1).reshape(-1, 2))
    points = np.column_stack([directions, np.ones(len(directions))])
    return float(np.linalg.norm(found.project(points) - true.project(points), axis=-1).max())


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
def test_lens_and_its_model_are_found(camera: CameraModel) -> None:
    found = calibrate(board_views(16, 1, camera=camera), SIZE)
    assert found.camera.model is camera.model
    difference = np.abs(found.camera.parameters - camera.parameters)
    assert np.all(difference < 4 * found.known.sigma)
    assert found.known.noise_px == pytest.approx(0.1, rel=0.1)
    assert found.known.disagreement < 1.4
    assert not found.rejected


@pytest.mark.parametrize(("camera", "count"), [(PINHOLE, 12), (PINHOLE, 24), (FISHEYE, 15)])
def test_sigmas_are_true(camera: CameraModel, count: int) -> None:
    errors = []
    for seed in range(16):
        views = board_views(count, 100 + seed, camera=camera)
        found = fit(camera.model, views, SIZE)
        assert found is not None
        difference = found.camera.parameters - camera.parameters
        errors.append(difference / knowledge(found, views).sigma)
    assert 0.75 < np.sqrt(np.mean(np.square(errors))) < 1.25


def test_sigmas_are_opencvs_where_views_agree() -> None:
    views = board_views(20, 3)
    found = fit(LensModel.PLUMB_BOB, views, SIZE)
    assert found is not None
    points = [view.points.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    theirs = cv2.calibrateCameraExtended(points, pixels, SIZE, np.eye(3), np.zeros(5))[5]
    known = knowledge(found, views)
    own = known.sigma / known.disagreement
    np.testing.assert_allclose(own, theirs.reshape(-1)[:9], rtol=0.02)


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
        found = fit(LensModel.PLUMB_BOB, views, SIZE)
        assert found is not None
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


def test_informative_views_are_taken_from_many_that_are_alike() -> None:
    random = np.random.default_rng(6)
    telling = board_views(20, 6)
    frontal = board_views(1, 7, tilt_deg=2.0, near=0.7)[0]
    alike = [
        View(f"same{i}", BOARD, frontal.pixels + random.normal(0, 0.1, BOARD[:, :2].shape), 0.1)
        for i in range(60)
    ]
    found = calibrate([*alike, *telling], SIZE)
    taken = [view.name for view in found.used]
    assert sum(name.startswith("v") for name in taken) >= 18
    assert found.spare >= 40
    assert worst_pixel_error(found.camera, PINHOLE) < 2.0


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
    with pytest.raises(InputError, match=r"3 views.*needs 4.*add pictures"):
        calibrate(board_views(3, 1), SIZE)


def test_frontal_views_leave_the_lens_open_and_it_says_so() -> None:
    found = calibrate(board_views(8, 10, tilt_deg=0.0), SIZE)
    assert found.known.sigma[0] > 0.01 * found.camera.fx
    assert advice(found)


def test_text_and_record_say_the_same() -> None:
    found = calibrate(board_views(12, 11), SIZE)
    text, record = calibration_text(found), calibration_record(found)
    assert "12 views used, 0 rejected" in text
    assert f"model {found.camera.model.value}" in text
    intrinsics = record["intrinsics"]
    assert isinstance(intrinsics, dict)
    assert intrinsics["k"] == found.camera.matrix.reshape(-1).tolist()
    assert intrinsics["sigma"]["fy"] == found.known.sigma[1]
    assert record["used"] == [view.name for view in found.used]
