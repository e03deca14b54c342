"""What every TargetDetector keeps to, whatever the pattern."""

import numpy as np
import pytest
from support.pictures.boards import (
    aprilgrid,
    charuco,
    checkerboard,
    picture_of,
    placed,
    plain_picture,
    target_of,
)

from trigpoint.contract.cdr import decode, encode, type_name
from trigpoint.contract.messages import Sightings
from trigpoint.edge.detector import DETECTORS, TargetDetector, detector_for
from trigpoint.site.target import Face, Pattern

FACES = {
    Pattern.CHECKERBOARD: checkerboard(8, 5),
    Pattern.CHARUCO: charuco(),
    Pattern.APRILGRID: aprilgrid(),
}


@pytest.fixture(params=list(FACES))
def face(request: pytest.FixtureRequest) -> Face:
    return FACES[request.param]


@pytest.fixture
def detector(face: Face) -> TargetDetector:
    return detector_for([target_of(face)])


def test_every_pattern_has_a_detector() -> None:
    assert set(DETECTORS) == set(Pattern) == set(FACES)


def test_sighting_travels_over_the_bus(face: Face, detector: TargetDetector) -> None:
    found = detector.detect(picture_of([placed(face, distance=0.9)]))
    assert len(found) == 1
    message = Sightings(1, "c1/optical", 640, 480, found)
    back = decode(type_name(message), encode(message))
    assert isinstance(back, Sightings)
    assert np.array_equal(back.faces[0].pixels, found[0].pixels)


def test_corners_are_ids_in_rising_order(face: Face, detector: TargetDetector) -> None:
    (found,) = detector.detect(picture_of([placed(face, distance=0.9, turn_deg=200)]))
    assert found.corners.dtype == np.uint16
    assert found.pixels.dtype == np.float32
    assert found.pixels.shape == (len(found.corners), 2)
    assert np.all(np.diff(found.corners.astype(int)) > 0)
    assert found.corners.max() < face.corner_count


def test_detector_keeps_no_state(face: Face, detector: TargetDetector) -> None:
    picture = picture_of([placed(face, distance=0.9, tilt_deg=20)], noise=2.0)
    (first,) = detector.detect(picture)
    assert detector.detect(plain_picture()) == ()
    (second,) = detector.detect(picture)
    assert np.array_equal(first.pixels, second.pixels)
    assert first.sigma == second.sigma


def test_picture_is_left_as_it_was(face: Face, detector: TargetDetector) -> None:
    picture = picture_of([placed(face, distance=0.9)])
    before = picture.copy()
    detector.detect(picture)
    assert np.array_equal(picture, before)


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (8, 8), (40, 7), (100, 2, 3)])
def test_smallest_pictures_are_no_trouble(detector: TargetDetector, shape: tuple[int, ...]) -> None:
    assert detector.detect(np.full(shape, 90, np.uint8)) == ()


def test_part_of_an_array_is_a_picture(face: Face, detector: TargetDetector) -> None:
    picture = picture_of([placed(face, distance=0.9)])
    wide = np.repeat(picture, 2, axis=1)
    assert len(detector.detect(wide[:, ::2])) == 1
