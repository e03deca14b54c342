"""Which robot a camera saw, where several carry the same target.

They look alike, but they do not drive alike: over a visit to a camera only the robot that was there
moved as its pictures show. So every robot is a hypothesis, and a visit is a robot's where its
odometry alone fits, wherever the camera may be. Robots that drove alike are identified once their
poses in the map are known: by which of them was where a located camera shows it, or by how other
cameras saw each of them drive meanwhile.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from trigpoint.clock import to_ns
from trigpoint.fusion.estimators.interface import Live
from trigpoint.fusion.initialisation.camera_hypotheses import Hypothesis, distinct, refine
from trigpoint.fusion.initialisation.start_poses import spread, starts_of
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.fusion.model.observations import Observation, Verdict, View, observation_of
from trigpoint.fusion.model.odometry import composed
from trigpoint.fusion.reading.alignment import placements
from trigpoint.fusion.reading.faces import best_reading
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .joint_motion import added_chi2
from .past_poses import PastPoses

_AWAY_NS = to_ns(2.0)
_MOST_PICTURES = 256
_MOST_OBSERVATIONS = 24
_MOST_HYPOTHESES = 8
_ACCEPTABLE_RMS = 3.0
_LEAST_PICTURES = 3
# χ²: five sigmas from where it is thought to have stood.
_AT_PLACE = 25.0
_FITS_SIGMAS = 5.0
# A robot that was elsewhere fits only against its odometry, at several times the noise's χ².
_MOST_CHI2 = 2.0
# Pictures that wait for places in the map; as many as an hour of one busy camera has.
_MOST_LEFT = 16384


@dataclass(frozen=True, slots=True)
class _Picture:
    """`faces`: what it shows, each as a view of every robot that may carry it."""

    stamp_ns: int
    faces: tuple[dict[str, View], ...]


@dataclass(frozen=True, slots=True)
class _Fit:
    """The robot that a visit seems to be of; `is_clear`: no other robot's odometry fits nearly as
    well; `every`: how each robot fits that does at all."""

    robot: str
    hypothesis: Hypothesis
    is_clear: bool
    every: dict[str, Hypothesis]


class RobotIdentification:
    """Pictures of targets that several robots carry, until the robot is identified. Not
    thread-safe.

    `untold`: how many pictures are not identified; `problem`: why, as text.
    """

    def __init__(self, data: DataSet) -> None:
        self._data = data
        self._open: dict[str, list[_Picture]] = {}
        self._closed: list[tuple[str, list[_Picture]]] = []
        self._left: deque[tuple[str, _Picture]] = deque(maxlen=_MOST_LEFT)
        self._looked = (0, 0, 0)
        self.untold = 0
        self.problem = ""

    def add(self, camera: str, stamp_ns: int, faces: tuple[dict[str, View], ...]) -> None:
        """Take one picture, each face as a view of every robot that may carry it; a late picture
        joins the visit that goes on."""
        visit = self._open.setdefault(camera, [])
        is_over = visit and stamp_ns - visit[-1].stamp_ns > _AWAY_NS
        if is_over or len(visit) >= _MOST_PICTURES:
            self._closed.append((camera, visit))
            visit = self._open[camera] = []
        visit.append(_Picture(stamp_ns, faces))

    def ready(self, *, is_end: bool = False) -> list[Observation]:
        """The identified observations of the visits that have ended by all robots' odometry, or of
        all visits at the end."""
        tracks = [track for track in self._data.tracks.values() if len(track)]
        until_ns = min((track.last_ns for track in tracks), default=0)
        for camera, visit in list(self._open.items()):
            if is_end or max(p.stamp_ns for p in visit) + _AWAY_NS < until_ns:
                self._closed.append((camera, self._open.pop(camera)))
        found: list[Observation] = []
        closed, self._closed = self._closed, []
        for camera, visit in closed:
            if not is_end and max(p.stamp_ns for p in visit) > until_ns:
                self._closed.append((camera, visit))
            else:
                found += self._told(camera, visit)
        return found

    def by_place(self, estimator: Live, *, is_end: bool = False) -> list[Observation]:
        """The pictures left out so far that the poses of robots and cameras identify now; tried
        again where there are more of either, or more pictures, and at the end."""
        if not self._left:
            return []
        tied = sum(estimator.robot(robot) is not None for robot in self._data.site.robots)
        looked = (self.untold, estimator.located_count, tied)
        if not estimator.located_count or (looked == self._looked and not is_end):
            return []
        self._looked = looked
        places = PastPoses(self._data, estimator)
        return self._shown_by_cameras(places) + self._told_by_other_cameras(places)

    def _shown_by_cameras(self, places: PastPoses) -> list[Observation]:
        """Pictures of located cameras where only one robot stood."""
        found: list[Observation] = []
        left, self._left = self._left, deque(maxlen=_MOST_LEFT)
        for camera, picture in left:
            own: dict[str, list[View]] = {}
            rest = []
            for face in picture.faces:
                robot = self._stood_there(places, camera, picture.stamp_ns, face)
                if robot is None:
                    rest.append(face)
                else:
                    own.setdefault(robot, []).append(face[robot])
            found += [
                observation_of(camera, robot, picture.stamp_ns, tuple(views))
                for robot, views in own.items()
            ]
            if rest:
                self._left.append((camera, _Picture(picture.stamp_ns, tuple(rest))))
            else:
                self.untold -= 1
        return found

    def _stood_there(
        self, places: PastPoses, camera: str, stamp_ns: int, face: dict[str, View]
    ) -> str | None:
        """The robot that was where a located camera shows the face, while every other one that may
        carry it was elsewhere; None where that is not known."""
        apart = {
            robot: self._apart(places, camera, robot, stamp_ns, view)
            for robot, view in face.items()
        }
        best, *others = sorted(apart, key=lambda robot: apart[robot])
        if not 0 <= apart[best] < _AT_PLACE:
            return None
        return best if all(apart[o] - apart[best] >= DECISIVE for o in others) else None

    def _apart(
        self, places: PastPoses, camera: str, robot: str, stamp_ns: int, view: View
    ) -> float:
        """χ² by which a robot was elsewhere than a camera shows it; -1 where that is not known, so
        that it may have been there."""
        there, stood = places.camera(camera), places.robot(robot, stamp_ns)
        if there is None or stood is None:
            return -1.0
        observation = observation_of(camera, robot, stamp_ns, (view,))
        tangent = self._data.tracks[robot].tangent
        shown = placements(
            self._data.moving(observation, stamp_ns),
            self._data.targets[robot],
            there.lens,
            there.map_from_camera,
            tangent=tangent,
        )
        between = stood.map_from_base.translation - there.map_from_camera.translation
        covariance = stood.covariance + _of_camera(there.covariance, float(between @ between))
        inner = covariance[np.ix_(tangent, tangent)]
        differences = [pose.difference(stood.map_from_base)[tangent] for pose in shown]
        return min((float(d @ np.linalg.solve(inner, d)) for d in differences), default=np.inf)

    def _told_by_other_cameras(self, places: PastPoses) -> list[Observation]:
        """Visits to cameras that are not located, which one robot alone explains by how other
        cameras saw it drive at the time."""
        found: list[Observation] = []
        left, self._left = self._left, deque(maxlen=_MOST_LEFT)
        for camera, visit in _visits(left):
            robot = None if places.camera(camera) else self._alone(places, camera, visit)
            if robot is None:
                self._left.extend((camera, picture) for picture in visit)
                continue
            told, rest = self._split(camera, *robot, visit)
            found += told
            self._left.extend((camera, picture) for picture in rest)
            self.untold -= len(visit) - len(rest)
        return found

    def _alone(
        self, places: PastPoses, camera: str, visit: list[_Picture]
    ) -> tuple[str, Hypothesis] | None:
        """The robot to which a visit adds so little χ² that every other one is excluded; None where
        there is none, or it does not fit."""
        best = self._best(camera, visit)
        if best is None:
            return None
        added = {
            robot: self._added(places, camera, robot, fit, visit)
            for robot, fit in best.every.items()
        }
        robot = min(added, key=lambda name: added[name])
        corners = sum(len(face[robot].corners) for p in visit for face in p.faces if robot in face)
        least, fit = added.pop(robot), best.every[robot]
        scale = max(1.0, fit.rms**2)
        if least > _MOST_CHI2 * scale * 2 * corners:
            return None
        is_alone = all(other - least >= DECISIVE * scale for other in added.values())
        return (robot, fit) if is_alone else None

    def _added(
        self,
        places: PastPoses,
        camera: str,
        robot: str,
        fit: Hypothesis,
        visit: list[_Picture],
    ) -> float:
        """χ² that a visit adds to what located cameras saw of a robot at the time."""
        poses = fit.located.map_from_base
        middle = list(poses)[len(poses) // 2]
        stood = places.robot(robot, visit[middle].stamp_ns)
        seen, shift = self._as_of(camera, robot, visit).entries, Pose.identity()
        if stood is not None:
            shift = stood.map_from_base @ poses[middle].inverse()
        entries = [
            Entry(
                seen[i].observation.read_as(fit.located.readings[i]).judged(Verdict.ACCEPTED),
                shift @ pose,
            )
            for i, pose in poses.items()
        ]
        state = replace(
            fit.located.camera, map_from_camera=shift @ fit.located.camera.map_from_camera
        )
        return added_chi2(self._data, places.camera_states(), camera, state, entries)

    def _told(self, camera: str, visit: list[_Picture]) -> list[Observation]:
        """The observations of a visit by their robots; a face that may be another's is left out."""
        visit = sorted(visit, key=lambda picture: picture.stamp_ns)
        best = self._best(camera, visit)
        if best is None:
            half = len(visit) // 2
            if half >= _LEAST_PICTURES:  # perhaps one robot left as another one came
                return self._told(camera, visit[:half]) + self._told(camera, visit[half:])
            self._leave_out(camera, visit)
            return []
        if not best.is_clear:  # nor would a part of it be
            self._leave_out(camera, visit)
            return []
        found, rest = self._split(camera, best.robot, best.hypothesis, visit)
        if not found:
            self._leave_out(camera, visit)
        elif rest:
            found += self._told(camera, rest)
        return found

    def _leave_out(self, camera: str, visit: list[_Picture]) -> None:
        self._left.extend((camera, picture) for picture in visit)
        self.untold += len(visit)
        self.problem = (
            f"camera {camera} saw a target that several robots carry, and their odometry does not "
            "tell which it was; give each robot its own target, or let one alone drive while the "
            "others stand"
        )

    def _best(self, camera: str, visit: list[_Picture]) -> _Fit | None:
        """The robot that fits a visit best; None where none fits most of it."""
        robots = dict.fromkeys(robot for p in visit for face in p.faces for robot in face)
        fits = {
            robot: fit
            for robot in robots
            if len(self._data.tracks[robot])
            and (fit := self._fit(camera, robot, visit)) is not None
        }
        if not fits:
            return None
        robot = min(fits, key=lambda name: fits[name].cost)
        best = fits[robot]
        corners = sum(len(face[robot].corners) for p in visit for face in p.faces if robot in face)
        share = min(1.0, _MOST_OBSERVATIONS / len(visit))  # of the pictures that were looked at
        fits_odometry = best.cost < _MOST_CHI2 * max(1.0, best.rms**2) * 2 * corners * share
        if not fits_odometry or best.rms > _ACCEPTABLE_RMS:
            return None
        others = [fit for name, fit in fits.items() if name != robot]
        return _Fit(robot, best, all(best.lead(fit) >= DECISIVE for fit in others), fits)

    def _fit(self, camera: str, robot: str, visit: list[_Picture]) -> Hypothesis | None:
        """How well a robot's motion explains a visit, with the camera wherever that takes it; None
        where it does not at all."""
        data = self._as_of(camera, robot, visit)
        indices = [i for i, entry in enumerate(data.entries) if entry.map_from_base is not None]
        chosen = spread(indices, _MOST_OBSERVATIONS)
        starts = starts_of(data, camera, chosen, most=_MOST_HYPOTHESES) if chosen else []
        state = data.first_state()
        found = distinct(refine(data, state, camera, start, chosen) for start in starts)
        return found[0] if found else None

    def _as_of(self, camera: str, robot: str, visit: list[_Picture]) -> DataSet:
        """The visit as if a robot had been there, in its odometry's frame; an entry a picture,
        without a place where it cannot be of that robot."""
        track = self._data.tracks[robot]
        stamps = np.array([p.stamp_ns for p in visit], dtype=np.int64)
        moments, rows = np.unique(
            np.clip(stamps, track.first_ns, track.last_ns), return_inverse=True
        )
        path = Pose.stack([Pose.identity()])
        if len(moments) > 1:
            path = composed(track.motion(moments, np.zeros(2)).earlier_from_later)
        entries = []
        for picture, row in zip(visit, rows.tolist(), strict=True):
            views = tuple(face[robot] for face in picture.faces if robot in face)
            is_possible = bool(views) and track.covers(picture.stamp_ns)
            observation = observation_of(camera, robot, picture.stamp_ns, views)
            observation = self._data.moving(observation, observation.stamp_ns)
            entries.append(Entry(observation, path[row] if is_possible else None))
        return replace(self._data, entries=entries)

    def _split(
        self, camera: str, robot: str, fit: Hypothesis, visit: list[_Picture]
    ) -> tuple[list[Observation], list[_Picture]]:
        """The faces that fit a robot, and the pictures with what is left."""
        data = self._as_of(camera, robot, visit)
        indices = [i for i, entry in enumerate(data.entries) if entry.map_from_base is not None]
        whole = refine(data, data.first_state(), camera, fit.located.map_from_camera, indices)
        located = (whole or fit).located
        limit = _FITS_SIGMAS * max(1.0, fit.rms)
        found, rest = [], []
        for index, picture in enumerate(visit):
            base = located.map_from_base.get(index)
            own, other = [], []
            views_of_robot = iter(data.entries[index].observation.views)
            for face in picture.faces:
                is_own = False
                view = next(views_of_robot) if robot in face else None
                if base is not None and view is not None:
                    _, rms, _ = best_reading(
                        view,
                        self._data.targets[robot],
                        located.camera.lens,
                        located.map_from_camera.inverse() @ base,
                    )
                    is_own = rms < limit * view.sigma
                (own if is_own else other).append(face)
            if own:
                views = tuple(face[robot] for face in own)
                found.append(observation_of(camera, robot, picture.stamp_ns, views))
            if other:
                rest.append(_Picture(picture.stamp_ns, tuple(other)))
        return found, rest


def _visits(left: Iterable[tuple[str, _Picture]]) -> list[tuple[str, list[_Picture]]]:
    """Pictures by camera and visit, each in order of time."""
    visits: list[tuple[str, list[_Picture]]] = []
    last: dict[str, list[_Picture]] = {}
    for camera, picture in sorted(left, key=lambda item: item[1].stamp_ns):
        visit = last.get(camera)
        if visit is None or picture.stamp_ns - visit[-1].stamp_ns > _AWAY_NS:
            visit = last[camera] = []
            visits.append((camera, visit))
        visit.append(picture)
    return visits


def _of_camera(covariance: Array, distance_m2: float) -> Array:
    """What a camera's own uncertainty adds to where it shows a robot, (6, 6), in any direction."""
    shift, turn = np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])
    return np.diag(np.repeat([shift + distance_m2 * turn, turn], 3))
