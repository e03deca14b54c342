"""Which face a picture shows and which way up: the truth is always among the candidates."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import lens

from trigpoint.contract.messages import FaceSighting
from trigpoint.fusion.model.observations import Observation, Reading, View, observation_of, view_of
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL
from trigpoint.fusion.reading import alignment, faces
from trigpoint.fusion.reading.best_readings import readings_rms_px
from trigpoint.geometry import Pose
from trigpoint.site.config import CameraConfig
from trigpoint.site.target import Target
from trigpoint.testing.views import looking_at
from trigpoint.tools.simulation.sight.seen_corners import seen_faces
from trigpoint.tools.simulation.sight.targets import target_of

LENS = lens()
EYE = looking_at((0.0, -1.6, 1.4), (0.0, 0.0, 0.7))
SIGMA = 0.1


def picture(
    target: Target, map_from_base: Pose, *, most: int = 6, turned: bool = False, noise: float = 0.0
) -> tuple[Observation, tuple[Reading, ...]]:
    """What a camera at EYE sees of the robot, and how it is truly read; the largest faces first."""
    random = np.random.default_rng(4)
    seen = seen_faces(target, map_from_base, EYE, LENS, ())
    whole = [face for face in seen if len(face.corners) == face.face.corner_count]
    whole.sort(key=lambda face: -face.smallest_square_px)
    views, truth = [], []
    for face in whole[:most]:
        pixels = face.pixels + noise * random.standard_normal(face.pixels.shape)
        can_turn = turned and face.face.reads_from_both_ends
        alike = len(target.look_alikes(face.face.appearance)) > 1
        sighting = FaceSighting(
            target.name,
            -1 if alike else face.face.id,
            face.corners,
            (pixels[::-1] if can_turn else pixels).astype(np.float32),
            SIGMA,
        )
        view = view_of(target, sighting, CameraConfig("sim://c1"))
        assert view is not None
        views.append(view)
        truth.append(Reading(target.faces.index(face.face), can_turn))
    return observation_of("c1", "r1", 0, tuple(views)), tuple(truth)


def near(candidate: faces.Candidate, map_from_base: Pose, tolerance: float) -> bool:
    true = EYE.inverse() @ map_from_base
    return float(np.abs(candidate.camera_from_base.difference(true)).max()) < tolerance


@pytest.mark.parametrize("kind", ["charuco", "checkerboard"])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("heading", [0.0, 0.5, 1.7, -2.0, 3.0])
@pytest.mark.parametrize("most", [1, 2])
def test_truth_is_among_the_candidates(kind: str, turned: bool, heading: float, most: int) -> None:
    target, pose = target_of(kind), Pose.planar(0.1, 0.05, heading)
    observation, truth = picture(target, pose, most=most, turned=turned)
    found = faces.candidates(observation, target, LENS)
    # Pixels are float32: 3e-5 of them over a face of a hundred is below a tenth of a millimetre.
    assert any(near(c, pose, 2e-3) and c.readings == truth for c in found)
    assert [c.rms_px for c in found] == sorted(c.rms_px for c in found)
    for candidate in found:
        assert np.linalg.det(candidate.camera_from_base.rotation) == pytest.approx(1.0)


def test_look_alike_faces_from_either_end_are_all_candidates() -> None:
    target = target_of("checkerboard")
    observation, _ = picture(target, Pose.planar(0.0, 0.0, 0.4), most=1)
    found = faces.candidates(observation, target, LENS)
    assert {(r.face, r.is_turned) for c in found for r in c.readings} == {
        (face, turned) for face in range(6) for turned in (False, True)
    }


def test_two_faces_seen_as_a_solid_have_one_solution() -> None:
    target, pose = target_of("charuco"), Pose.planar(0.0, 0.0, 0.5)
    observation, _ = picture(target, pose, most=2, noise=SIGMA)
    assert len(observation.views) == 2
    good = [c for c in faces.candidates(observation, target, LENS) if c.rms_px < 3 * SIGMA]
    assert len(good) == 1
    assert near(good[0], pose, 0.02)


def test_weights_are_those_of_the_corners() -> None:
    target, pose = target_of("charuco"), Pose.planar(0.0, 0.0, 0.5)
    observation, _ = picture(target, pose, most=2)
    good, bad = observation.views
    bad = replace(bad, pixels=bad.pixels + 5.0, sigma=1e3)
    found = faces.candidates(observation_of("c1", "r1", 0, (good, bad)), target, LENS)
    assert any(near(candidate, pose, 1e-3) for candidate in found)


@pytest.mark.parametrize(
    "corners", [[0, 1, 2], [0, 1, 2, 3], []], ids=["three", "on a line", "none"]
)
def test_view_with_too_little_has_no_candidate(corners: list[int]) -> None:
    target = target_of("charuco")
    chosen = np.array(corners, dtype=int)
    pixels = 100.0 + 10.0 * np.stack([chosen, 0 * chosen], axis=-1)
    view = View(chosen, pixels, SIGMA, (Reading(0),))
    assert faces.candidates(observation_of("c1", "r1", 0, (view,)), target, LENS) == ()


def test_corners_that_are_no_numbers_have_no_candidate() -> None:
    target = target_of("charuco")
    observation, _ = picture(target, Pose.planar(0.0, 0.0, 0.5), most=1)
    view = observation.views[0]
    nothing = View(view.corners, np.full_like(view.pixels, np.nan), SIGMA, view.readings)
    assert faces.candidates(observation_of("c1", "r1", 0, (nothing,)), target, LENS) == ()


def test_mirrored_corners_fit_no_reading() -> None:
    target = target_of("charuco")
    observation, _ = picture(target, Pose.planar(0.0, 0.0, 0.5), most=1)
    view = observation.views[0]
    columns = target.faces[0].columns - 1
    flipped = view.corners // columns * columns + (columns - 1 - view.corners % columns)
    mirrored = View(flipped, view.pixels, SIGMA, view.readings)
    for candidate in faces.candidates(observation_of("c1", "r1", 0, (mirrored,)), target, LENS):
        assert candidate.rms_px > 10 * SIGMA
        assert np.linalg.det(candidate.camera_from_base.rotation) == pytest.approx(1.0)


def test_face_that_turns_its_back_is_no_reading() -> None:
    target, pose = target_of("checkerboard"), Pose.planar(0.0, 0.0, 0.4)
    observation, truth = picture(target, pose, most=1)
    view, camera_from_base = observation.views[0], EYE.inverse() @ pose
    _, rms = readings_rms_px([view], target, LENS, Pose.stack([camera_from_base]))
    best, second = np.argsort(rms)[:2]
    assert view.readings[best] == truth[0]
    assert rms[best] < 0.01 < rms[second]
    back = Reading(truth[0].face ^ 1)  # the other side of the vane
    only_back = View(view.corners, view.pixels, SIGMA, (back,))
    _, rms = readings_rms_px([only_back], target, LENS, Pose.stack([camera_from_base]))
    assert rms.tolist() == [np.inf]


def aligned(
    observation: Observation,
    target: Target,
    prior: alignment.PosePrior | None,
    tangent: list[int] = PLANAR,
) -> alignment.Alignment | None:
    return alignment.align(
        observation, target, LENS, EYE, tangent=tangent, prior=prior, extra_sigma_px=0.0
    )


def sure(map_from_base: Pose, metres: float, radians: float) -> alignment.PosePrior:
    return alignment.PosePrior(map_from_base, np.diag(np.repeat([metres**2, radians**2], 3)))


@pytest.mark.parametrize("tangent", [PLANAR, SPATIAL])
def test_marked_faces_place_the_robot_without_a_prior(tangent: list[int]) -> None:
    target, pose = target_of("charuco"), Pose.planar(0.1, -0.1, 0.5)
    observation, truth = picture(target, pose, noise=SIGMA)
    found = aligned(observation, target, None, tangent)
    assert found is not None
    assert found.readings == truth
    assert np.abs(found.map_from_base.difference(pose)).max() < 0.02
    # 2 numbers a corner; √(2·dof) is the χ²'s own sigma.
    freedom = 2 * observation.corner_count
    assert found.cost < freedom + 5 * np.sqrt(2 * freedom)


def test_identical_faces_are_told_apart_by_the_prior_alone() -> None:
    target, pose = target_of("checkerboard"), Pose.planar(0.1, -0.1, 0.4)
    observation, truth = picture(target, pose, most=1, turned=True, noise=SIGMA)
    alone = aligned(observation, target, None)
    assert alone is not None
    assert alone.margin < 9.0  # three vanes fit alike
    informed = aligned(
        observation, target, sure(pose.disturbed([0.03, 0, 0, 0, 0, 0.05]), 0.05, 0.1)
    )
    assert informed is not None
    assert informed.readings == truth
    assert informed.margin > 25.0
    assert np.abs(informed.map_from_base.difference(pose)).max() < 0.02


@pytest.mark.parametrize("most", [1, 2])
def test_faces_are_told_apart_by_a_prior_that_is_off_by_the_distance_of_two(most: int) -> None:
    """Read at the prior's middle, one looks like its neighbour."""
    target, random = target_of("checkerboard"), np.random.default_rng(3)
    for turn in np.linspace(0.0, 6.0, 12):
        pose = Pose.planar(0.1, -0.1, float(turn))
        observation, truth = picture(target, pose, most=most, noise=SIGMA)
        off = random.normal(size=2)
        off *= 0.17 / np.linalg.norm(off)
        found = aligned(observation, target, sure(pose.disturbed([*off, 0, 0, 0, 0.02]), 0.1, 0.05))
        assert found is not None
        assert found.readings == truth
        assert found.margin > 25.0
        assert np.abs(found.map_from_base.difference(pose)).max() < 0.02


def test_alignment_of_what_shows_nothing_is_none() -> None:
    target = target_of("charuco")
    view = View(np.array([0, 1]), np.array([[1.0, 1.0], [2.0, 2.0]]), SIGMA, (Reading(0),))
    assert aligned(observation_of("c1", "r1", 0, (view,)), target, None) is None
