"""Which robot a camera saw, where several carry the same target.

They look alike, but they do not drive alike: over a visit to a camera only the robot that was there
moved as its pictures show. So every robot is a hypothesis, and a visit is a robot's where its
odometry alone fits, wherever the camera may be.
"""

from dataclasses import dataclass, replace

import numpy as np

from trigpoint.clock import to_ns
from trigpoint.geometry import Pose

from .dataset import DataSet, Entry
from .faces import best_reading
from .hypotheses import DECISIVE, Hypothesis, distinct, refine
from .observations import Observation, View, observation_of
from .odometry_track import composed
from .starts import spread, starts_of

_AWAY_NS = to_ns(2.0)
_MOST_PICTURES = 256
_MOST_LOOKS = 24
_MOST_HYPOTHESES = 8
_ACCEPTABLE_RMS = 3.0
_LEAST_PICTURES = 3
_FITS_SIGMAS = 5.0
# A robot that was elsewhere fits only against its odometry, at several times the noise's χ².
_MOST_CHI2 = 2.0


@dataclass(frozen=True, slots=True)
class _Picture:
    """`faces`: what it shows, each as a view of every robot that may carry it."""

    stamp_ns: int
    faces: tuple[dict[str, View], ...]


class SharedLooks:
    """Pictures of targets that several robots carry, until it is clear whose. Not thread-safe.

    `untold`: how many pictures it stayed unclear for; `problem`: why, in words.
    """

    def __init__(self, data: DataSet) -> None:
        self._data = data
        self._open: dict[str, list[_Picture]] = {}
        self._closed: list[tuple[str, list[_Picture]]] = []
        self.untold = 0
        self.problem = ""

    def add(self, camera: str, stamp_ns: int, faces: tuple[dict[str, View], ...]) -> None:
        """Take what one picture shows, each face as a view of every robot that may carry
        it; a picture that comes late joins the visit that goes on."""
        visit = self._open.setdefault(camera, [])
        is_over = visit and stamp_ns - visit[-1].stamp_ns > _AWAY_NS
        if is_over or len(visit) >= _MOST_PICTURES:
            self._closed.append((camera, visit))
            visit = self._open[camera] = []
        visit.append(_Picture(stamp_ns, faces))

    def ready(self, *, is_end: bool = False) -> list[Observation]:
        """What is clear of the visits that are over by all robots' odometry, or all at the end."""
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

    def _told(self, camera: str, visit: list[_Picture]) -> list[Observation]:
        """Whose the faces of a visit are; one that may be another's is left out."""
        visit = sorted(visit, key=lambda picture: picture.stamp_ns)
        robot, fit = self._best(camera, visit)
        if fit is None or robot is None:
            half = len(visit) // 2
            if half >= _LEAST_PICTURES:  # perhaps one robot left as another one came
                return self._told(camera, visit[:half]) + self._told(camera, visit[half:])
            self._leave_out(camera, visit)
            return []
        found, rest = self._split(camera, robot, fit, visit)
        if not found:
            self._leave_out(camera, visit)
        elif rest:
            found += self._told(camera, rest)
        return found

    def _leave_out(self, camera: str, visit: list[_Picture]) -> None:
        self.untold += len(visit)
        self.problem = (
            f"camera {camera} saw a target that several robots carry, and their odometry does not "
            "tell which it was; give each robot its own target, or let one alone drive while the "
            "others stand"
        )

    def _best(self, camera: str, visit: list[_Picture]) -> tuple[str | None, Hypothesis | None]:
        """The robot that fits most of a visit while no other one comes near."""
        robots = dict.fromkeys(robot for p in visit for face in p.faces for robot in face)
        fits = {
            robot: fit
            for robot in robots
            if len(self._data.tracks[robot])
            and (fit := self._fit(camera, robot, visit)) is not None
        }
        if not fits:
            return None, None
        robot = min(fits, key=lambda name: fits[name].cost)
        best = fits.pop(robot)
        corners = sum(len(face[robot].corners) for p in visit for face in p.faces if robot in face)
        share = min(1.0, _MOST_LOOKS / len(visit))  # of the pictures that were looked at
        fits_odometry = best.cost < _MOST_CHI2 * max(1.0, best.rms**2) * 2 * corners * share
        is_clear = all(best.lead(fit) >= DECISIVE for fit in fits.values())
        is_good = is_clear and fits_odometry and best.rms <= _ACCEPTABLE_RMS
        return (robot, best) if is_good else (None, None)

    def _fit(self, camera: str, robot: str, visit: list[_Picture]) -> Hypothesis | None:
        """How well a robot's motion explains a visit, with the camera wherever that takes it; None
        where it does not at all."""
        data = self._as_of(camera, robot, visit)
        indices = [i for i, entry in enumerate(data.entries) if entry.map_from_base is not None]
        looks = spread(indices, _MOST_LOOKS)
        starts = starts_of(data, camera, looks, most=_MOST_HYPOTHESES) if looks else []
        state = data.first_state()
        found = distinct(refine(data, state, camera, start, looks) for start in starts)
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
