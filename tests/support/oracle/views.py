"""What one picture can mean: every reading of its sightings, each with its pose and evidence.

Part of the oracle (`oracle`), and like it written without fusion: plain, dense, slow.
"""

import itertools
import math
from functools import cache

import numpy as np
from msgspec import Struct

from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array, exp, hat
from trigpoint.site.target import Face, Target

Label = tuple[int, bool] | None
"""(face id, in the order of the half turn), or None: the sighting is wrong."""

_MOST_STEPS = 60
_SAME_POSE = 1.0  # two minima are one within so much of χ² between them
# Two sightings' own poses are not looked at together where they differ by so much of χ²; to be
# wrong costs a quarter of that.
_APART = 400.0


class Priors(Struct, frozen=True):
    """Prior probabilities: of a wrong sighting, each; that anybody meddled in the session, and in
    one that was meddled in of an event, each: a lift between two views, a camera moved between two
    of its views. `room`: m, of the box in which cameras hang and robots drive. `is_above_floor`: no
    camera hangs below it; `is_opaque`: no face is seen through another one, nor from behind."""

    wrong: float = 0.02
    disturbed: float = 1e-4
    event: float = 1e-2
    room: tuple[float, float, float] = (30.0, 30.0, 5.0)
    is_above_floor: bool = True
    is_opaque: bool = True

    def happened(self, count: int) -> float:
        """-2 ln of so many events."""
        return -2 * math.log(self.disturbed) - 2 * count * math.log(self.event) if count else 0.0

    @property
    def camera_room(self) -> float:
        """m³ rad³."""
        return math.prod(self.room) * 8 * math.pi**2

    @property
    def robot_room(self) -> float:
        """m² rad."""
        return self.room[0] * self.room[1] * 2 * math.pi


class Look(Struct, frozen=True, eq=False):
    """One picture: the camera's name, its lens, the stamp, the sightings."""

    camera: str
    lens: CameraModel
    stamp_ns: int
    sightings: tuple[FaceSighting, ...]


class Reading(Struct, frozen=True, eq=False):
    """One way to read a picture. `camera_from_base`, `chi2` at its minimum, `covariance` (6, 6) of
    the contract's disturbance; None where every sighting is wrong. `cost`: -2 ln of the priors and
    of what the wrong sightings' own boards explain."""

    labels: tuple[Label, ...]
    camera_from_base: Pose | None
    chi2: float
    covariance: Array | None
    cost: float

    @property
    def first_cost(self) -> float:
        """-2 ln of its evidence for a camera of which nothing is known, but for 2 ln V."""
        if self.covariance is None:
            return self.cost
        return self.cost + self.chi2 - _log_integral(self.covariance)


def readings_of(look: Look, target: Target, priors: Priors) -> list[Reading]:
    """Every reading of a picture, each of a reading's minima as one of its own."""
    fits = [_by_label(look.lens, sighting, target) for sighting in look.sightings]
    # By whatever label, it is the same board.
    wrong = [_wrong_cost(next(iter(one.values())), priors) for one in fits]
    right = -2 * math.log(1 - priors.wrong)
    found = []
    for labels in itertools.product(*([None, *one] for one in fits)):
        named = [label[0] for label in labels if label is not None]
        if len(set(named)) < len(named):
            continue
        cost = sum(wrong[i] if label is None else right for i, label in enumerate(labels))
        if not named:
            found.append(Reading(labels, None, 0.0, None, cost))
            continue
        own = [fits[i][label] for i, label in enumerate(labels) if label is not None]
        if not _may_agree(own):
            continue
        points, pixels, sigmas = corners_of(look, target, labels)
        starts = [fit.pose for one in own for fit in one]
        found += [
            Reading(labels, fit.pose, fit.chi2, fit.covariance, cost)
            for fit in _minima(look.lens, points, pixels, sigmas, starts)
            if not priors.is_opaque or _is_in_sight(look, target, labels, fit.pose)
        ]
    return found


def corners_of(look: Look, target: Target, labels: tuple[Label, ...]) -> tuple[Array, Array, Array]:
    """Of the sightings that are not wrong: points in the base (n, 3), pixels (n, 2), sigmas."""
    points, pixels, sigmas = [], [], []
    for sighting, label in zip(look.sightings, labels, strict=True):
        if label is None:
            continue
        face = target.face(label[0])
        points.append(face.base_from_face @ _on_face(face, sighting, is_turned=label[1]))
        pixels.append(np.asarray(sighting.pixels, dtype=float))
        sigmas.append(np.full(len(sighting.corners), sighting.sigma))
    return np.vstack(points), np.vstack(pixels), np.concatenate(sigmas)


def residuals(
    lens: CameraModel, pose: Pose, points: Array, pixels: Array, sigmas: Array
) -> tuple[Array, Array]:
    """Residuals (2n,) in sigmas and their derivative (2n, 6) by the pose's disturbance."""
    arm = points @ pose.rotation.T
    seen = arm + pose.translation
    projected, by_point = lens.project_by_point(seen)
    jacobian = np.concatenate([by_point, -by_point @ hat(arm)], axis=-1)
    scale = sigmas[:, None]
    error = ((projected - pixels) / scale).reshape(-1)
    return error, (jacobian / scale[..., None]).reshape(-1, 6)


class _Fit(Struct, frozen=True, eq=False):
    pose: Pose
    chi2: float
    covariance: Array


def _labels_of(sighting: FaceSighting, target: Target) -> list[tuple[int, bool]]:
    """Every face and order that a sighting may be of."""
    if sighting.face >= 0:
        faces = [target.face(sighting.face)]
    else:
        faces = [f for f in target.faces if len(target.look_alikes(f.appearance)) > 1]
        faces = [f for f in faces if f.corner_count > int(np.max(sighting.corners))]
    ways = [(f, turned) for f in faces for turned in (False, True)]
    return [(f.id, turned) for f, turned in ways if f.reads_from_both_ends or not turned]


def _on_face(face: Face, sighting: FaceSighting, *, is_turned: bool) -> Array:
    """The sighting's corners in the face's frame."""
    ids = np.asarray(sighting.corners, dtype=int)
    return face.corners[face.corner_count - 1 - ids if is_turned else ids]


def _by_label(
    lens: CameraModel, sighting: FaceSighting, target: Target
) -> dict[tuple[int, bool], list[_Fit]]:
    """The minima of camera_from_base of one sighting, by label."""
    boards: dict[tuple[object, ...], list[_Fit]] = {}
    by_label = {}
    for label in _labels_of(sighting, target):
        face = target.face(label[0])
        points = _on_face(face, sighting, is_turned=label[1])
        key = (*face.appearance, face.square, face.marker, label[1])
        if key not in boards:  # faces that look alike are one board
            boards[key] = _board_minima(lens, points, sighting)
        face_from_base = face.base_from_face.inverse()
        by_label[label] = [_of_base(fit, face_from_base) for fit in boards[key]]
    return by_label


def _board_minima(lens: CameraModel, points: Array, sighting: FaceSighting) -> list[_Fit]:
    """The minima of camera_from_face of corners (n, 3) on a face."""
    pixels = np.asarray(sighting.pixels, dtype=float)
    sigmas = np.full(len(points), sighting.sigma)
    return _minima(lens, points, pixels, sigmas, _planar_starts(lens, points, sighting))


def _of_base(fit: _Fit, face_from_base: Pose) -> _Fit:
    """camera_from_base of a fit of camera_from_face."""
    pose = fit.pose @ face_from_base
    by = np.eye(6)
    by[:3, 3:] = -hat(pose.translation - fit.pose.translation)
    return _Fit(pose, fit.chi2, by @ fit.covariance @ by.T)


def _wrong_cost(fits: list[_Fit], priors: Priors) -> float:
    """-2 ln of: a sighting is wrong, and shows a board that is anywhere in the room."""
    evidence = [-0.5 * (fit.chi2 - _log_integral(fit.covariance)) for fit in fits]
    board = -2 * float(np.logaddexp.reduce(evidence)) + 2 * math.log(priors.camera_room)
    return board - 2 * math.log(priors.wrong)


def _log_integral(covariance: Array) -> float:
    """2 ln of the integral of exp(-χ²/2) about a minimum, (6, 6)."""
    return 6 * math.log(2 * math.pi) + float(np.linalg.slogdet(covariance)[1])


def _may_agree(own: list[list[_Fit]]) -> bool:
    """Whether any minima of two or more sightings come near one pose."""
    if len(own) == 1:
        return True
    return any(
        sum(_apart(first, other) for other in others) < _APART
        for first, *others in itertools.product(*own)
    )


def _apart(first: _Fit, second: _Fit) -> float:
    error = first.pose.difference(second.pose)
    return float(error @ np.linalg.solve(first.covariance + second.covariance, error))


def _planar_starts(lens: CameraModel, points: Array, sighting: FaceSighting) -> list[Pose]:
    """camera_from_face by a homography (DLT), and the plane mirrored at the line of sight, which on
    a small face fits nearly as well."""
    seen = lens.directions(np.asarray(sighting.pixels, dtype=float))
    middle, size = points[:, :2].mean(axis=0), float(np.ptp(points[:, :2], axis=0).max())
    flat = np.column_stack([(points[:, :2] - middle) / size, np.ones(len(points))])
    rows = np.zeros((2 * len(points), 9))
    rows[0::2, :3], rows[0::2, 6:] = flat, -seen[:, :1] * flat
    rows[1::2, 3:6], rows[1::2, 6:] = flat, -seen[:, 1:] * flat
    homography = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    homography *= np.sign(homography[2, 2])  # the face lies before the camera
    first, second, there = homography.T
    scale = 2 / (np.linalg.norm(first) + np.linalg.norm(second))
    u, _, v = np.linalg.svd(np.column_stack([first, second]), full_matrices=False)
    axes = u @ v
    rotation = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
    centre = there * scale * size
    offset = np.append(middle, 0.0)
    return [
        Pose(turned, centre - turned @ offset) for turned in (rotation, _mirrored(rotation, centre))
    ]


def _mirrored(rotation: Array, centre: Array) -> Array:
    """The rotation of a plane tilted to the other side of the line of sight by as much."""
    sight = centre / np.linalg.norm(centre)
    normal = rotation[:, 2]
    axis = np.cross(normal, sight)
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        return rotation
    angle = np.arctan2(sine, normal @ sight)
    return exp(axis / sine * 2 * angle) @ rotation


def _minima(
    lens: CameraModel, points: Array, pixels: Array, sigmas: Array, starts: list[Pose]
) -> list[_Fit]:
    """The different minima that starts lead to, best first."""
    found: list[_Fit] = []
    fits = (_descended(lens, points, pixels, sigmas, start) for start in starts)
    for fit in sorted((f for f in fits if f is not None), key=lambda f: f.chi2):
        if all(_between(fit, other) > _SAME_POSE for other in found):
            found.append(fit)
    return found


def _between(fit: _Fit, other: _Fit) -> float:
    error = fit.pose.difference(other.pose)
    return float(error @ np.linalg.solve(other.covariance, error))


def _descended(
    lens: CameraModel, points: Array, pixels: Array, sigmas: Array, start: Pose
) -> _Fit | None:
    """Levenberg-Marquardt from a start; None where it leads behind the camera."""
    pose, damping = start, 1e-6
    if not _is_ahead(pose, points):
        return None
    error, jacobian = residuals(lens, pose, points, pixels, sigmas)
    chi2 = float(error @ error)
    for _ in range(_MOST_STEPS):
        normal = jacobian.T @ jacobian
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), jacobian.T @ error)
        tried = pose.disturbed(step)
        if _is_ahead(tried, points):
            error_there, jacobian_there = residuals(lens, tried, points, pixels, sigmas)
            if (there := float(error_there @ error_there)) <= chi2:
                gain = chi2 - there
                pose, chi2, damping = tried, there, damping / 10
                error, jacobian = error_there, jacobian_there
                if gain < 1e-9 and np.abs(step).max() < 1e-7:
                    break
                continue
        damping *= 10
        if damping > 1e8:
            break
    return _Fit(pose, chi2, np.linalg.inv(jacobian.T @ jacobian))


def _is_ahead(pose: Pose, points: Array) -> bool:
    return bool(np.all((pose @ points)[:, 2] > 0.02))


def _is_in_sight(
    look: Look, target: Target, labels: tuple[Label, ...], camera_from_base: Pose
) -> bool:
    """Whether each labelled face shows its front, most of its corners not hidden by others."""
    eye = camera_from_base.inverse().translation
    for sighting, label in zip(look.sightings, labels, strict=True):
        if label is None:
            continue
        face = target.face(label[0])
        points = face.base_from_face @ _on_face(face, sighting, is_turned=label[1])
        into = face.base_from_face.rotation[:, 2]
        if into @ (points.mean(axis=0) - eye) <= 0:
            return False
        hidden = np.zeros(len(points), dtype=bool)
        for other in target.faces:
            if other.id != face.id:
                hidden |= _crosses(other, eye, points)
        if np.mean(hidden) > 0.5:
            return False
    return True


def _crosses(face: Face, eye: Array, points: Array) -> np.ndarray:
    """Which lines from the eye to points (n, 3), in the base, go through a face's pattern."""
    face_from_base, low, high = _rectangle(face)
    start, ends = face_from_base @ eye, face_from_base @ points
    fall = start[2] - ends[:, 2]
    share = start[2] / np.where(np.abs(fall) < 1e-12, 1e-12, fall)
    crossing = start[:2] + share[:, None] * (ends[:, :2] - start[:2])
    inside = np.all((crossing > low) & (crossing < high), axis=1)
    return inside & (share > 1e-3) & (share < 1 - 1e-3)


@cache
def _rectangle(face: Face) -> tuple[Pose, Array, Array]:
    outline = face.outline[:, :2]
    return face.base_from_face.inverse(), outline.min(axis=0), outline.max(axis=0)
