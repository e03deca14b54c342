"""The oracle is right where one can see it, agrees with other ways to work it out, and finds what
was drawn."""

import itertools
import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from support.oracle import posterior as oracle_module
from support.oracle.posterior import Oracle
from support.oracle.sessions import Shape, SmallSession, drawn_shape, small_session
from support.oracle.solver import gaps_of
from support.oracle.verdict import Scored
from support.oracle.views import Priors, corners_of, readings_of, residuals

from trigpoint.contract.messages import Odometry
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import wrap
from trigpoint.site.config import OdometryNoise

_PLAIN = Shape(0, (0, 0), is_alike=False)


def _true_labels(session: SmallSession) -> tuple[tuple[tuple[int, bool] | None, ...], ...]:
    pictures = [p for of_camera in session.composition.pictures.values() for p in of_camera]
    return tuple(
        tuple((f.face, f.is_turned) if f.is_good.any() else None for f in picture.faces)
        for picture in sorted(pictures, key=lambda picture: picture.t_s)
    )


def _off_m(session: SmallSession, camera: str, pose: Pose) -> float:
    truth = session.composition.last_places()[camera]
    return float(np.linalg.norm(pose.translation - truth.translation))


# -- parts ----------------------------------------------------------------------------------------


def test_a_known_face_has_its_reading_and_the_wrong_one_and_its_pose_is_the_true_one() -> None:
    session = small_session(Shape(2, (0,), is_alike=False))
    [look] = session.looks
    readings = readings_of(look, session.target, Priors())
    assert readings[0].covariance is None
    best = min((r for r in readings if all(r.labels)), key=lambda r: r.chi2)
    count = sum(len(sighting.corners) for sighting in look.sightings)
    assert best.chi2 / (2 * count - 6) == pytest.approx(1, abs=0.35)
    [(_, base)] = [
        (p.t_s, session.composition.carriers[0].ride.at(np.array([p.t_s]))[0])
        for p in session.composition.pictures["c1"]
    ]
    truth = session.composition.cameras[0].map_from_camera.inverse() @ base
    assert best.camera_from_base is not None
    assert best.covariance is not None
    error = best.camera_from_base.difference(truth)
    assert error @ np.linalg.solve(best.covariance, error) < 30  # χ² of 6: 4e-5 are above it


def test_a_board_seen_alone_may_be_any_face_either_way_up_by_either_minimum_in_sight() -> None:
    session = small_session(Shape(3, (0,), is_alike=True))
    [look] = session.looks
    assert len(look.sightings) == 1
    free = readings_of(look, session.target, Priors(is_opaque=False))
    chi2 = sorted(r.chi2 for r in free if all(r.labels))[:12]
    assert np.ptp(chi2) < 1e-4
    opaque = readings_of(look, session.target, Priors())
    assert len(opaque) == 1 + 12  # one minimum of each face and way up would show a hidden one
    assert len(free) == 1 + 24


def test_residuals_have_the_derivative_that_differences_have() -> None:
    session = small_session(_PLAIN)
    look = session.looks[0]
    best = min(readings_of(look, session.target, Priors())[1:], key=lambda r: r.cost + r.chi2)
    seen = corners_of(look, session.target, best.labels)
    pose = best.camera_from_base
    assert pose is not None
    error, jacobian = residuals(look.lens, pose, *seen)
    for column in range(6):
        step = 1e-6 * np.eye(6)[column]
        ahead = residuals(look.lens, pose.disturbed(step), *seen)[0]
        behind = residuals(look.lens, pose.disturbed(-step), *seen)[0]
        assert np.allclose(jacobian[:, column], (ahead - behind) / 2e-6, atol=1e-3, rtol=1e-4)
    assert error @ error == pytest.approx(best.chi2)


def test_the_noise_of_a_gap_is_that_of_many_drawn_drives() -> None:
    random, noise = np.random.default_rng(1), OdometryNoise()
    steps = np.array([[0.02, 0.0, 0.01]] * 60 + [[0.0, 0.0, 0.05]] * 20 + [[0.03, 0.0, 0.0]] * 40)
    drawn, poses = np.zeros((4000, 3)), np.zeros(3)
    odometry = [Odometry(0, "", "", Pose.planar(0.0, 0.0, 0.0))]
    for number, step in enumerate(steps, start=1):
        poses = _chained(poses, step)
        odometry.append(Odometry(number, "", "", Pose.planar(*poses)))
        length, turn, half = np.hypot(*step[:2]), abs(step[2]), step[2] / 2
        along, across, turned = random.standard_normal((3, len(drawn)))
        along, across = (
            along * noise.distance * np.sqrt(length),
            across * noise.lateral * np.sqrt(length),
        )
        turned *= np.sqrt(noise.heading_drive**2 * length + noise.heading_turn**2 * turn)
        off = [
            np.cos(half) * along - np.sin(half) * across,
            np.sin(half) * along + np.cos(half) * across,
            turned,
        ]
        drawn = _chained(drawn, step + np.column_stack(off))
    _, [gap] = gaps_of(odometry, [len(steps)], noise)
    error = drawn - poses
    error[:, 2] = wrap(error[:, 2])
    white = error @ gap.whitening.T
    assert np.allclose(gap.motion, poses)
    assert np.allclose(np.cov(white.T), np.eye(3), atol=0.1)


def _chained(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x = pose[..., 0] + cosine * step[..., 0] - sine * step[..., 1]
    y = pose[..., 1] + sine * step[..., 0] + cosine * step[..., 1]
    return np.stack([x, y, pose[..., 2] + step[..., 2]], axis=-1)


# -- the score ------------------------------------------------------------------------------------


def test_the_minimum_is_the_one_that_scipy_finds_over_all_pixels() -> None:
    session = small_session(_PLAIN)
    oracle = session.oracle()
    best = oracle.explanations[0]
    assert best.labels == _true_labels(session)
    start, gaps = gaps_of(
        session.odometry,
        [look.stamp_ns for look in session.looks],
        session.site.robots["r1"].odometry,
    )
    place, covariance = best.places["c1"]

    def error(unknown: np.ndarray) -> np.ndarray:
        """Of both robot poses (3,) and a disturbance (6,) of the camera's place."""
        parts, before = [], start
        camera = place.disturbed(unknown[6:])
        for view, look in enumerate(session.looks):
            base = unknown[3 * view : 3 * view + 3]
            moved = (Pose.planar(*before).inverse() @ Pose.planar(*base)).translation[:2]
            off = np.array([*moved, base[2] - before[2]]) - gaps[view].motion
            off[2] = wrap(off[2])
            parts.append(gaps[view].whitening @ off)
            seen = camera.inverse() @ Pose.planar(*base)
            points = corners_of(look, session.target, best.labels[view])
            parts.append(residuals(look.lens, seen, *points)[0])
            before = base
        return np.concatenate(parts)

    begun = np.zeros(12)
    pose = start
    for view, gap in enumerate(gaps):
        pose = begun[3 * view : 3 * view + 3] = _chained(pose, gap.motion)
    found = least_squares(error, begun, x_scale="jac", xtol=1e-14, ftol=1e-14)
    normal = found.jac.T @ found.jac
    priors = oracle.priors
    expected = 2 * found.cost + np.linalg.slogdet(normal)[1] - 12 * math.log(2 * math.pi)
    expected += sum(np.linalg.slogdet(2 * math.pi * gap.covariance)[1] for gap in gaps)
    expected += 2 * math.log(priors.camera_room)
    events = sum(len(look.sightings) for look in session.looks) * math.log(1 - priors.wrong)
    assert np.abs(found.x[6:]).max() < 1e-5
    assert best.cost == pytest.approx(expected - 2 * events, abs=1e-3)
    assert np.allclose(np.linalg.inv(normal)[6:, 6:], covariance, rtol=1e-3, atol=1e-9)


def test_one_picture_costs_what_its_reading_does_by_itself() -> None:
    session = small_session(Shape(5, (0,), is_alike=False))
    oracle = session.oracle()
    best = min(r.first_cost for r in oracle.readings[0] if r.covariance is not None)
    priors = oracle.priors
    alone = best + 2 * math.log(priors.camera_room)
    assert oracle.explanations[0].cost == pytest.approx(alone, abs=0.05)


def test_a_single_known_sighting_is_located_and_may_be_wrong_by_its_prior() -> None:
    # Of one board alone: two faces that agree are not both wrong.
    sessions = (small_session(Shape(seed, (0,), is_alike=False)) for seed in itertools.count())
    session = next(s for s in sessions if len(s.looks[0].sightings) == 1)
    verdict = session.oracle().verdicts()["c1"]
    assert verdict.is_located
    assert not verdict.is_confirmed
    assert verdict.by_wrong == pytest.approx(0.02, rel=0.05)
    assert verdict.by_lift == 0.0


def test_two_pictures_that_agree_confirm_a_camera() -> None:
    session = small_session(_PLAIN)
    verdict = session.oracle().verdicts()["c1"]
    assert verdict.is_located
    assert verdict.is_confirmed
    assert _off_m(session, "c1", verdict.places[0].map_from_camera) < 0.2


def test_equal_boards_seen_once_leave_their_camera_open_and_the_true_place_is_among_them() -> None:
    session = small_session(Shape(0, (0, 1, 0)))
    verdict = session.oracle().verdicts()["c2"]
    assert not verdict.is_located
    assert len(verdict.places) == 6
    assert min(_off_m(session, "c2", p.map_from_camera) for p in verdict.places) < 0.2
    assert sum(p.mass for p in verdict.places) + verdict.by_lift == pytest.approx(1, abs=1e-6)


# -- events ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "lifts", "moves"),
    [
        (Shape(0, (0, 1, 0, 1), is_alike=False, lift=2), {2}, set()),
        (Shape(0, (0, 0, 0), is_alike=False, move=2), set(), {2}),
        (Shape(1, (0, 0), is_alike=False, displaced=(1,)), set(), set()),
    ],
)
def test_what_happened_is_the_best_explanation(
    shape: Shape, lifts: set[int], moves: set[int]
) -> None:
    session = small_session(shape)
    best = session.oracle().explanations[0]
    assert best.labels == _true_labels(session)
    assert best.explanation.lifts == lifts
    assert best.explanation.moves == moves


def test_a_lift_that_no_picture_tells_costs_its_prior_and_places_nothing() -> None:
    session = small_session(Shape(0, (0, 1), is_alike=False))
    oracle = session.oracle()
    best = oracle.explanations[0]
    [lifted] = [
        e
        for e in oracle.explanations
        if e.explanation.lifts == {1} and e.labels == best.labels and not e.explanation.moves
    ]
    assert lifted.cost - best.cost == pytest.approx(oracle.priors.happened(1), abs=0.01)
    assert set(lifted.places) == {"c1"}
    assert lifted.cut_off == {"c2"}


def test_bounds_leave_out_nothing_that_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    session = small_session(Shape(1, (0, 0), is_alike=False, displaced=(1,)))
    bounded = session.oracle().explanations
    monkeypatch.setattr(oracle_module, "_TRUST", 0.0)
    monkeypatch.setattr(oracle_module, "WINDOW", 400.0)
    outright = session.oracle().explanations
    assert len(outright) > 20
    limit = outright[0].cost + 30
    near = [e for e in outright if e.cost < limit]
    assert [_key(e) for e in near] == [_key(e) for e in bounded if e.cost < limit]
    assert np.allclose([e.cost for e in near], [e.cost for e in bounded if e.cost < limit])


def _key(scored: Scored) -> tuple[object, ...]:
    return scored.labels, scored.explanation.lifts, scored.explanation.moves


@pytest.mark.parametrize("number", [2, 3, 4])
def test_what_the_oracle_locates_is_where_it_says(number: int) -> None:
    session = small_session(drawn_shape(number, most_views=3))
    for camera, verdict in session.oracle().verdicts().items():
        # Nobody can know of a lift after which no camera is met again.
        if verdict.is_located and session.is_lift_told:
            place = verdict.places[0]
            truth = session.composition.last_places()[camera]
            error = place.map_from_camera.difference(truth)[:3]
            assert error @ np.linalg.solve(place.covariance[:3, :3], error) < 64
        masses = sum(p.mass for p in verdict.places) + verdict.by_wrong + verdict.by_lift
        assert masses == pytest.approx(1, abs=1e-9)


def test_a_picture_between_odometry_messages_is_refused() -> None:
    session = small_session(_PLAIN)
    odometry = [m for m in session.odometry if m.stamp_ns != session.looks[0].stamp_ns]
    noise = session.site.robots["r1"].odometry
    with pytest.raises(ValueError, match="no odometry at the picture's stamp"):
        Oracle(odometry, session.looks, session.target, noise)
