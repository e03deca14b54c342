"""What the map says a camera sees, against the simulated lab's cameras, corner by corner."""

import numpy as np
import pytest
from msgspec import structs

from trigpoint.fusion.coverage.floor import HEADINGS, standing
from trigpoint.fusion.model.observations import base_from_faces
from trigpoint.fusion.model.projection import projected
from trigpoint.fusion.reading.sight import DETECTED, Eye, Faces, corners_found, information_at
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Numbering, Pattern, Target
from trigpoint.tools.simulation.sight.seen_corners import SeenFace, seen_faces_each
from trigpoint.tools.simulation.sight.targets import target_of
from trigpoint.tools.simulation.world import looking

LEAST_SIDE_PX = 7.0
WIDE = CameraModel(
    1920, 1440, 1100.0, 1105.0, 958.0, 723.0, (0.02, -0.01, 0.002, 0.0), LensModel.EQUIDISTANT
)
BARREL = CameraModel(1280, 960, 1000.0, 1002.0, 642.0, 478.0, (-0.21, 0.06, 8e-4, -4e-4, -0.007))


def grid_target() -> Target:
    """A single AprilGrid, as Kalibr counts it."""
    [face, *_] = target_of("charuco").faces
    plain = structs.replace(
        face,
        pattern=Pattern.APRILGRID,
        columns=4,
        rows=3,
        square=0.08,
        marker=0.06,
        dictionary="DICT_APRILTAG_36h11",
        numbering=Numbering.KALIBR,
        first_marker=0,
    )
    return Target("grid", (plain,))


def mounted(target: Target) -> Faces:
    return Faces(target, base_from_faces(target))


def eye(lens: CameraModel) -> Eye:
    pose = Pose(looking(20.0, 30.0, 4.0), np.array([0.3, -0.2, 2.1]))
    return Eye("c1", pose, lens, 0.2)


@pytest.mark.parametrize("lens", [BARREL, WIDE], ids=["barrel", "fisheye"])
@pytest.mark.parametrize(
    "target",
    [target_of("charuco"), target_of("checkerboard"), grid_target()],
    ids=["charuco", "checkerboard", "aprilgrid"],
)
def test_a_robot_is_seen_where_the_labs_detector_finds_a_face(
    target: Target, lens: CameraModel
) -> None:
    camera, faces = eye(lens), mounted(target)
    places = np.random.default_rng(5).uniform([0.5, -1.5], [4.5, 2.5], (80, 2))
    bases = standing(places)
    seen = information_at(camera, faces, bases)
    found = np.zeros(len(bases), dtype=bool)
    found[seen.rows] = True
    each = seen_faces_each(target, bases, camera.map_from_camera, camera.lens, ())
    shown = [[face for face in faces if face.is_found(LEAST_SIDE_PX)] for faces in each]
    truth = np.array([bool(faces) for faces in shown])
    corners = corners_found(camera, faces, bases, DETECTED)
    assert np.array_equal(corners.any(axis=(1, 2)), found)
    assert 40 < truth.sum() < len(truth) - 40
    # Sheets have a white edge beyond the pattern, which hides a corner or two more.
    assert np.mean(found == truth) > 0.995
    logs = []
    for row, information in zip(seen.rows.tolist(), seen.information, strict=True):
        if truth[row]:
            told = sum(information_of(face, bases[row], camera) for face in shown[row])
            logs.append(np.log(np.linalg.det(information) / np.linalg.det(told)) / 12)
    # The quadrature's standard deviations, on average over all six directions.
    assert abs(np.median(logs)) < 0.01
    assert np.quantile(np.abs(logs), 0.95) < 0.06


def information_of(seen: SeenFace, base: Pose, camera: Eye) -> Array:
    """The information in the corners of one face, one by one."""
    points = seen.face.base_from_face @ seen.face.corners[seen.corners]
    [jacobian] = projected(
        camera.lens, Pose.stack([base]), points[None], camera.map_from_camera
    ).by_body
    flat = jacobian.reshape(-1, 6) / camera.sigma_px
    return flat.T @ flat


def test_what_may_be_seen_leaves_out_nothing_that_is() -> None:
    camera, faces = eye(BARREL), mounted(target_of("charuco"))
    places = np.random.default_rng(6).uniform(-9.0, 9.0, (2000, 2))
    told = information_at(camera, faces, standing(places))
    may = camera.may_see(faces, places)
    assert may[np.unique(told.rows // HEADINGS)].all()
    assert may.mean() < 0.6


def test_a_board_that_turns_its_back_is_not_seen() -> None:
    target = grid_target()
    told = information_at(eye(BARREL), mounted(target), standing(np.array([[3.0, 1.0]]), 36))
    assert 3 <= len(told.rows) <= 16


def test_a_face_of_one_corner_is_seen_beside_another() -> None:
    [face, *_] = target_of("charuco").faces
    target = Target("two", (face, structs.replace(face, id=1, columns=2, rows=2)))
    seen = corners_found(eye(BARREL), mounted(target), standing(np.array([[2.0, 0.5]])), DETECTED)
    assert seen[:, 1, 0].any()
    assert not seen[:, 1, 1:].any()
