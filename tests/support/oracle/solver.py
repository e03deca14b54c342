"""The oracle's solver: poses of robot and cameras for explanations of one structure, all at once.

Part of the oracle (`oracle`): dense Levenberg-Marquardt with derivatives by differences.
"""

import itertools
import math
from typing import Protocol

import numpy as np
from msgspec import Struct
from support.oracle.views import Priors, Reading

from trigpoint.contract.messages import Odometry
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, wrap
from trigpoint.site.config import OdometryNoise

_MOST_STEPS = 40
_DIFFERENCE = 1e-6
_SMALL_GAIN = 1e-7
# 10 µm and 10 µrad, which odometry that turns on the spot is not sure of: it has no inverse else.
_FLOOR = 1e-10


class _Events(Protocol):
    """What a structure needs of an explanation."""

    @property
    def lifts(self) -> frozenset[int]: ...
    @property
    def moves(self) -> frozenset[int]: ...


class Gap(Struct, frozen=True, eq=False):
    """Motion (3,) x, y, heading in the earlier pose's frame, its covariance, and a matrix that
    makes an error of it white."""

    motion: Array
    covariance: Array
    whitening: Array


def gaps_of(
    odometry: list[Odometry], stamps_ns: list[int], noise: OdometryNoise
) -> tuple[Array, list[Gap]]:
    """The first pose (3,), and the motion from there to the first picture, and so on."""
    index = {message.stamp_ns: i for i, message in enumerate(odometry)}
    missing = [stamp for stamp in stamps_ns if stamp not in index]
    if missing:
        raise ValueError(f"no odometry at the picture's stamp {missing[0]}")
    poses = np.array([[*m.pose.translation[:2], m.pose.heading] for m in odometry])
    rows = [0, *(index[stamp] for stamp in stamps_ns)]
    gaps = [_gap(poses[a : b + 1], noise) for a, b in itertools.pairwise(rows)]
    return poses[0], gaps


def _gap(poses: Array, noise: OdometryNoise) -> Gap:
    """The motion from the first to the last pose (n, 3); each increment's noise is independent."""
    covariance = np.zeros((3, 3))
    for earlier, later in itertools.pairwise(poses):
        step = _relative(earlier, later)
        length, turn = float(np.hypot(*step[:2])), abs(float(step[2]))
        half = step[2] / 2
        along = np.array([[np.cos(half), -np.sin(half)], [np.sin(half), np.cos(half)]])
        own = np.zeros((3, 3))
        own[:2, :2] = along @ np.diag([noise.distance**2, noise.lateral**2]) @ along.T * length
        own[2, 2] = noise.heading_drive**2 * length + noise.heading_turn**2 * turn
        # In the frame of the first pose: what is behind turns and shifts what comes after it.
        begun = _relative(poses[0], earlier)
        turned = _turned(begun[2])
        by = np.eye(3)
        there = turned @ step[:2]
        by[:2, 2] = [-there[1], there[0]]
        into = np.eye(3)
        into[:2, :2] = turned
        covariance = by @ covariance @ by.T + into @ own @ into.T
    covariance = covariance + _FLOOR * np.eye(3)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    return Gap(_relative(poses[0], poses[-1]), covariance, whitening)


def _turned(heading: float) -> Array:
    return np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])


def _relative(earlier: Array, later: Array) -> Array:
    """later in earlier's frame; (…, 3)."""
    d = later - earlier
    cosine, sine = np.cos(earlier[..., 2]), np.sin(earlier[..., 2])
    x = cosine * d[..., 0] + sine * d[..., 1]
    y = -sine * d[..., 0] + cosine * d[..., 1]
    return np.stack([x, y, wrap(d[..., 2])], axis=-1)


def after(pose: Array, motion: Array) -> Array:
    """The pose (…, 3) that a motion (3,) leads to."""
    cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x = pose[..., 0] + cosine * motion[0] - sine * motion[1]
    y = pose[..., 1] + sine * motion[0] + cosine * motion[1]
    return np.stack([x, y, wrap(pose[..., 2] + motion[2])], axis=-1)


def _before(pose: Array, motion: Array) -> Array:
    """The pose (…, 3) from which a motion (3,) leads here."""
    heading = pose[..., 2] - motion[2]
    cosine, sine = np.cos(heading), np.sin(heading)
    x = pose[..., 0] - cosine * motion[0] + sine * motion[1]
    y = pose[..., 1] - sine * motion[0] - cosine * motion[1]
    return np.stack([x, y, wrap(heading)], axis=-1)


# -- what explanations share ----------------------------------------------------------------------


class Structure:
    """Which pictures tie which stretch of the way to which place of a camera.

    A stretch goes from lift to lift; a place from one of a camera's moves to the next. `places`:
    the number of each picture's place, None where all its sightings are wrong; `last_places`: of
    each camera; `is_tied`: by number, whether a place hangs together with the map.
    """

    def __init__(
        self,
        start: Array,
        gaps: list[Gap],
        cameras: list[str],
        right: tuple[bool, ...],
        events: _Events,
        priors: Priors,
    ) -> None:
        self.start, self.gaps, self.right = start, gaps, right
        self.views = range(len(gaps))
        self.lifts = events.lifts
        self.stretch = [sum(lift <= view for lift in events.lifts) for view in self.views]
        self.places, self.last_places = _places(cameras, right, events.moves)
        count = 1 + max((p for p in self.places if p is not None), default=-1)
        groups = self._groups(count)
        self.is_tied = [groups["place", number] == groups["stretch", 0] for number in range(count)]
        self.held = self._held(groups)
        self.free = [view for view in self.views if view not in self.held]
        self.size = 3 * len(self.free) + 6 * count
        self.count = count
        self.reckoned = self._reckoned()
        self.constant = self._constant(cameras, events, priors)

    def solved(self, chosen: list[list[Reading]]) -> "Solution":
        """The minimum of each of many explanations, by their readings of each picture."""
        problem = _Problem(self, chosen)
        return problem.solution()

    def _groups(self, count: int) -> dict[tuple[str, int], tuple[str, int]]:
        """Of each stretch and place, the first of all that hang together with it."""
        stretches = range(1 + max(self.stretch, default=0))
        group = {("stretch", s): ("stretch", s) for s in stretches}
        group |= {("place", p): ("place", p) for p in range(count)}
        for view, place in enumerate(self.places):
            if place is not None:
                first = group["stretch", self.stretch[view]]
                second = group["place", place]
                one = min(first, second, key=lambda g: (g[0] == "place", g[1]))
                for key, value in group.items():
                    if value in (first, second):
                        group[key] = one
        return group

    def _held(self, groups: dict[tuple[str, int], tuple[str, int]]) -> set[int]:
        """The pictures whose robot pose is held: the first of each group that no map ties."""
        held: set[int] = set()
        known = {groups["stretch", 0]}
        for view in self.views:
            group = groups["stretch", self.stretch[view]]
            if group not in known:
                known.add(group)
                held.add(view)
        return held

    def _reckoned(self) -> Array:
        """Dead reckoning through all gaps, (views, 3)."""
        poses, pose = [], self.start
        for gap in self.gaps:
            pose = after(pose, gap.motion)
            poses.append(pose)
        return np.array(poses)

    def _constant(self, cameras: list[str], events: _Events, priors: Priors) -> float:
        """The part of the cost that is the same for all: priors of events, rooms, odometry's
        normalisation."""
        cost = priors.happened(len(events.lifts) + len(events.moves))
        for view in self.views:
            is_lifted = view in events.lifts
            if not is_lifted:
                cost += float(np.linalg.slogdet(2 * math.pi * self.gaps[view].covariance)[1])
            elif view not in self.held:
                cost += 2 * math.log(priors.robot_room)
        return cost + self.count * 2 * math.log(priors.camera_room)


def _places(
    cameras: list[str], right: tuple[bool, ...], moves: frozenset[int]
) -> tuple[list[int | None], dict[str, int | None]]:
    """The number of each picture's place, and of each camera's last one; None where no sighting
    there is right."""
    moved = [
        sum(m <= view for m in moves if cameras[m] == camera) for view, camera in enumerate(cameras)
    ]
    numbers: dict[tuple[str, int], int] = {}
    places: list[int | None] = []
    for view, camera in enumerate(cameras):
        key = camera, moved[view]
        places.append(numbers.setdefault(key, len(numbers)) if right[view] else None)
    last = {camera: numbers.get((camera, moved[view])) for view, camera in enumerate(cameras)}
    return places, last


# -- the minimum ----------------------------------------------------------------------------------


class Solution(Struct, frozen=True, eq=False):
    """Of each of n explanations: `costs` (n,), robot poses `x` (n, views, 3), cameras' places
    (n, places), and the covariance (n, size, size) of all unknowns."""

    structure: Structure
    costs: Array
    x: Array
    cameras: Pose
    covariance: Array

    @property
    def is_below_floor(self) -> np.ndarray:
        """(n,) bool: whether a camera would hang there."""
        return np.any(self.cameras.translation[..., 2] < 0, axis=-1)

    def place(self, number: int, row: int) -> tuple[Pose, Array]:
        """map_from_camera of one explanation's place, and its covariance."""
        own = 3 * len(self.structure.free) + 6 * number + np.arange(6)
        pose = Pose(self.cameras.rotation[row, number], self.cameras.translation[row, number])
        return pose, self.covariance[row][np.ix_(own, own)]

    def camera_from_base(self, view: int, row: int) -> Pose:
        """Of one explanation's picture, which must have a place."""
        number = self.structure.places[view]
        assert number is not None
        return self.place(number, row)[0].inverse() @ Pose.planar(*self.x[row, view])


class _Problem:
    """Many explanations of one structure."""

    def __init__(self, structure: Structure, chosen: list[list[Reading]]) -> None:
        self.structure = structure
        self.own = np.array([sum(r.cost + r.chi2 for r in readings) for readings in chosen])
        self.seen: dict[int, Pose] = {}
        self.whitening: dict[int, Array] = {}
        for view in structure.views:
            if structure.right[view]:
                poses, roots = [], []
                for readings in chosen:
                    pose, covariance = readings[view].camera_from_base, readings[view].covariance
                    assert pose is not None
                    assert covariance is not None
                    poses.append(pose)
                    roots.append(np.linalg.inv(np.linalg.cholesky(covariance)))
                self.seen[view] = Pose.stack(poses)
                self.whitening[view] = np.array(roots)

    def solution(self) -> Solution:
        """Levenberg-Marquardt on all at once; each goes its own way."""
        structure = self.structure
        x, cameras = self._begun()
        rows = np.arange(len(self.own))
        error = self._error(rows, x, cameras)
        jacobian = self._jacobian(rows, x, cameras, error)
        chi2 = np.sum(error**2, axis=1)
        damping = np.full(len(rows), 1e-4)
        active = rows if structure.size else rows[:0]
        for _ in range(_MOST_STEPS):
            if not len(active):
                break
            step = self._step(error[active], jacobian[active], damping[active])
            there = self._moved(x[active], cameras[active], step)
            error_there = self._error(active, *there)
            chi2_there = np.sum(error_there**2, axis=1)
            gain = chi2[active] - chi2_there
            better = np.isfinite(chi2_there) & (gain >= 0)
            taken = active[better]
            x[taken] = there[0][better]
            cameras.rotation[taken] = there[1].rotation[better]
            cameras.translation[taken] = there[1].translation[better]
            error[taken], chi2[taken] = error_there[better], chi2_there[better]
            jacobian[taken] = self._jacobian(taken, x[taken], cameras[taken], error[taken])
            damping[taken] *= 0.1
            damping[active[~better]] *= 10
            is_done = (better & (gain < _SMALL_GAIN)) | (damping[active] > 1e6)
            active = active[~is_done]
        normal = np.swapaxes(jacobian, 1, 2) @ jacobian
        volume = np.linalg.slogdet(normal)[1] - structure.size * math.log(2 * math.pi)
        costs = chi2 + volume + structure.constant + self.own
        return Solution(structure, costs, x, cameras, np.linalg.inv(normal))

    def _begun(self) -> tuple[Array, Pose]:
        """Dead reckoning, and places by the first picture of each that can be reached."""
        structure, count = self.structure, len(self.own)
        x = np.tile(structure.reckoned, (count, 1, 1))
        rotation = np.tile(np.eye(3), (count, structure.count, 1, 1))
        cameras = Pose(rotation, np.zeros((count, structure.count, 3)))
        is_known = {s: s == 0 for s in structure.stretch}
        for view in structure.held:
            is_known[structure.stretch[view]] = True
        placed: set[int] = set()
        for _ in structure.views:
            for view, place in enumerate(structure.places):
                stretch = structure.stretch[view]
                if place is None:
                    continue
                if is_known[stretch] and place not in placed:
                    there = _planar(x[:, view]) @ self.seen[view].inverse()
                    cameras.rotation[:, place] = there.rotation
                    cameras.translation[:, place] = there.translation
                    placed.add(place)
                elif not is_known[stretch] and place in placed:
                    base = _one(cameras, place) @ self.seen[view]
                    pose = np.column_stack([base.translation[:, :2], base.heading])
                    self._reckon_from(x, view, pose)
                    is_known[stretch] = True
        return x, cameras

    def _reckon_from(self, x: Array, view: int, pose: Array) -> None:
        """Fill a stretch from where one of its pictures puts the robot, both ways."""
        structure = self.structure
        x[:, view] = pose
        same = [v for v in structure.views if structure.stretch[v] == structure.stretch[view]]
        for later in [v for v in same if v > view]:
            x[:, later] = after(x[:, later - 1], structure.gaps[later].motion)
        for earlier in reversed([v for v in same if v < view]):
            x[:, earlier] = _before(x[:, earlier + 1], structure.gaps[earlier + 1].motion)

    def _error(self, rows: np.ndarray, x: Array, cameras: Pose) -> Array:
        """White residuals (n, r) of some explanations."""
        structure, parts = self.structure, []
        for view, gap in enumerate(structure.gaps):
            if view not in structure.lifts:
                before = x[:, view - 1] if view else np.broadcast_to(structure.start, x[:, 0].shape)
                off = _relative(before, x[:, view]) - gap.motion
                off[:, 2] = wrap(off[:, 2])
                parts.append(off @ gap.whitening.T)
            place = structure.places[view]
            if place is not None:
                expected = _one(cameras, place).inverse() @ _planar(x[:, view])
                off = expected.difference(self.seen[view][rows])
                parts.append((self.whitening[view][rows] @ off[..., None])[..., 0])
        return np.concatenate(parts, axis=1) if parts else np.zeros((len(rows), 0))

    def _jacobian(self, rows: np.ndarray, x: Array, cameras: Pose, error: Array) -> Array:
        """By differences, those of all unknowns at once: (n, r, size)."""
        size = self.structure.size
        each = np.repeat(np.arange(len(rows)), size)
        steps = np.tile(_DIFFERENCE * np.eye(size), (len(rows), 1))
        there = self._error(rows[each], *self._moved(x[each], cameras[each], steps))
        change = (there - error[each]) / _DIFFERENCE
        return np.swapaxes(change.reshape(len(rows), size, error.shape[1]), 1, 2)

    def _step(self, error: Array, jacobian: Array, damping: Array) -> Array:
        normal = np.swapaxes(jacobian, 1, 2) @ jacobian
        diagonal = np.einsum("nii->ni", normal)
        loaded = normal + (damping[:, None] * diagonal)[:, :, None] * np.eye(normal.shape[1])
        gradient = np.einsum("nri,nr->ni", jacobian, error)
        return -np.linalg.solve(loaded, gradient[..., None])[..., 0]

    def _moved(self, x: Array, cameras: Pose, step: Array) -> tuple[Array, Pose]:
        free = self.structure.free
        x = x.copy()
        x[:, free] += step[:, : 3 * len(free)].reshape(len(step), len(free), 3)
        by = step[:, 3 * len(free) :].reshape(len(step), self.structure.count, 6)
        return x, cameras.disturbed(by)


def _planar(x: Array) -> Pose:
    return Pose.planar(x[:, 0], x[:, 1], x[:, 2])


def _one(cameras: Pose, place: int) -> Pose:
    return Pose(cameras.rotation[:, place], cameras.translation[:, place])
