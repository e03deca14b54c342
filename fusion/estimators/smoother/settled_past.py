"""Bounds what a map keeps: of a long session the older part is summarised (`model/past`).

That is done once a solution explains everything, and nothing in it is open; or in the end in any
case, since memory and the time of a solution are to depend on the last hours and not on the age of
the map. What is not decided by then has to be seen again.
"""

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import NANOSECONDS
from trigpoint.fusion.estimators.crept import crept
from trigpoint.fusion.estimators.interface import Trajectory
from trigpoint.fusion.estimators.results import earlier_poses
from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.known_cameras import Creep, KnownCameras
from trigpoint.fusion.model.past import ODOMETRY_BEFORE_NS, Past, PastCamera
from trigpoint.fusion.model.problem import State
from trigpoint.fusion.solver.equations import covariance_of
from trigpoint.fusion.solver.filter import Filter
from trigpoint.fusion.solver.levenberg_marquardt import linearise

_OPEN_GROWTH = 3.0
# Of each robot so many sightings stay.
_LEAST_OF_A_ROBOT = 20
_MOST_EARLIER = 64
AWAY_NS = 10 * NANOSECONDS
"""Behind so long a time a robot comes before a camera anew."""
_PATH_STEP_NS = NANOSECONDS // 10


class Limits(Struct, frozen=True):
    """How much is kept at least: sightings, times that a robot came before a camera (on whose
    number the time of a solution depends most), and messages of odometry. `growth`: as many times
    as much may come before the rest is summarised, and `_OPEN_GROWTH` times while something is
    open; `paths`: whether the robots' paths are kept all the same."""

    sightings: int
    odometry: int = 200_000
    visits: int = 1_000
    growth: float = 2.0
    paths: bool = False

    def is_reached(self, data: DataSet, *, is_open: bool) -> bool:
        """Whether a part of the data is to be summarised."""
        times = _OPEN_GROWTH if is_open else self.growth
        messages = sum(len(track) for track in data.tracks.values())
        return (
            len(data.entries) > times * self.sightings
            or len(_comings_ns(data)) > times * self.visits
            or messages > times * self.odometry
        )

    def since_ns(self, data: DataSet) -> dict[str, int]:
        """By robot, the stamp from which on its sightings stay."""
        stamps: dict[str, list[int]] = defaultdict(list)
        for entry in data.entries:
            stamps[entry.observation.robot].append(entry.observation.stamp_ns)
        every_ns = np.concatenate([track.stamps_ns for track in data.tracks.values()])
        odometry_ns = _newest(every_ns, self.odometry)
        sightings = [stamp_ns for each in stamps.values() for stamp_ns in each]
        visits_ns = _newest(_comings_ns(data), self.visits)
        cut_ns = max(_newest(sightings, self.sightings), visits_ns, odometry_ns)
        moved_ns = max((m.since_ns for m in data.moves if m.since_ns < cut_ns), default=0)
        before = {} if data.past is None else data.past.since_ns
        since_ns = {}
        for robot in data.tracks:
            # A robot that stays away is not lost, as long as that is no matter of days.
            own = sorted(stamps[robot])[-_LEAST_OF_A_ROBOT:] or [cut_ns]
            own_ns = min(cut_ns, max(own[0], moved_ns, odometry_ns))
            since_ns[robot] = max(own_ns, before.get(robot, 0))
        return since_ns


LIVE = Limits(1_500, visits=120, growth=1.5)
OF_A_SESSION = Limits(10_000, 600_000, paths=True)
"""Of a recording, which is explained as a whole as long as a machine can bear."""


def past_path(path: Trajectory, past: Past, robot: str) -> Trajectory:
    """The part of a robot's path that is past, at most ten poses a second of it."""
    begin_ns = past.since_ns[robot] - ODOMETRY_BEFORE_NS
    count = max(int(np.searchsorted(path.stamps_ns, begin_ns, "right")) - 1, 0)
    rows = np.flatnonzero(np.diff(path.stamps_ns[:count] // _PATH_STEP_NS, prepend=0))
    return Trajectory(path.stamps_ns[rows], path.map_from_base[rows])


def _comings_ns(data: DataSet) -> list[int]:
    """The moments with which a robot came before a camera that had not seen it for a while."""
    seen: dict[tuple[str, str], list[int]] = defaultdict(list)
    for entry in data.entries:
        seen[entry.observation.camera, entry.observation.robot].append(entry.observation.stamp_ns)
    comings_ns = []
    for stamps in seen.values():
        own_ns = np.sort(stamps)
        is_new = np.diff(own_ns, prepend=own_ns[0] - 2 * AWAY_NS) > AWAY_NS
        comings_ns += own_ns[is_new].tolist()
    return comings_ns


def _newest(stamps: np.ndarray | list[int], count: int) -> int:
    """The oldest of so many newest stamps; 0 where there are fewer."""
    every = np.asarray(stamps, dtype=np.int64)
    return int(np.partition(every, -count)[-count]) if len(every) > count else 0


def settled_past(data: DataSet, state: State, since_ns: Mapping[str, int]) -> Past | None:
    """The past of a solved data set: all that is older than `since_ns`, by robot. None where it
    locates no camera; raises LinAlgError where it is not determined.

    It is linearised where the solution over everything is, and not at its own minimum: there, what
    it says and what the rest does cancel out as before, however little it knows by itself.
    """
    gone = [e for e in data.entries if e.observation.stamp_ns < since_ns[e.observation.robot]]
    past = replace(data, entries=gone)
    used = past.usable(state.cameras)
    if not used:
        return None
    assembled = assemble(past, state, used)
    problem, start = assembled.problem, assembled.start
    known = Filter.after(start, problem, linearise(problem, start).reduced())
    known = known.spread(crept(past, known))
    places = _last_places(past, known, max(since_ns.values()))
    if not places:
        return None
    absent = data.known_at_start.without(
        lambda kind, name: kind not in ("faces", "scales") or name in problem.chains
    )
    return Past(
        known=_known(past, known, places).beside(absent),
        since_ns=dict(since_ns),
        map_since_ns=data.map_since_ns,
        epoch_ns=data.epoch_ns,
        lenses={name: data.lenses[name] for name in data.site.cameras if name in data.lenses},
        cameras={name: _counted(past, name, since_ns) for name in data.site.cameras},
    )


def _last_places(past: DataSet, known: Filter, end_ns: int) -> dict[str, str]:
    """By camera that is located at the end of the past: the name of its place there."""
    places = {}
    for camera in past.site.cameras:
        moves = [move for move in past.moves if move.camera == camera and end_ns <= move.since_ns]
        place = moves[0].name if moves else camera
        seen = [past.entries[i].observation.stamp_ns for i in past.usable([place])]
        is_gone = any(
            told.camera == camera
            and told.since_ns < end_ns
            and max(seen, default=0) < told.since_ns
            for told in past.told
        )
        if known.has_camera(place) and not is_gone:
            places[camera] = place
    return places


def _known(past: DataSet, known: Filter, places: Mapping[str, str]) -> KnownCameras:
    """What a filter over the past knows of everything but the robots' poses: expected is where its
    cost is least."""
    layout, state, step = known.layout, known.state, known.known.mean
    columns = [layout.pose[place] for place in places.values()]
    poses = {
        camera: state.cameras[place].map_from_camera.disturbed(step[layout.pose[place]])
        for camera, place in places.items()
    }
    faces = {}
    for robot, own in layout.faces.items():
        faces[robot] = state.robots[robot].base_from_face.disturbed(step[own].reshape(-1, 6))
        columns.append(own)
    values = {}
    for camera, place in places.items():
        if place in layout.lens:
            values["lens", camera] = state.cameras[place].lens.parameters, layout.lens[place]
        if place in layout.time_offset:
            values["clock", camera] = state.cameras[place].clock, layout.time_offset[place]
    for robot, own in layout.scales.items():
        values["scales", robot] = state.robots[robot].scales, own
    columns += [own for _, own in values.values()]
    rows = np.concatenate(columns)
    return KnownCameras(
        poses=poses,
        information=covariance_of(known.known.covariance[np.ix_(rows, rows)]),
        until_ns=max(entry.observation.stamp_ns for entry in past.entries),
        creep=Creep.of_all(past.site.cameras),
        faces=faces,
        values={key: value + step[own] for key, (value, own) in values.items()},
    )


def _counted(past: DataSet, camera: str, since_ns: Mapping[str, int]) -> PastCamera:
    """A camera's counts with those of the past before."""
    before, cut_ns = past.past_of(camera), max(since_ns.values())
    entries = [e.observation for place in past.places_of(camera) for e in past.of_camera(place)]
    gone = [move for move in past.moves if move.since_ns < cut_ns]
    earlier = (*before.earlier, *earlier_poses(gone, camera))
    return PastCamera(
        before.sightings + sum(len(observation.views) for observation in entries),
        before.used + sum(observation.used_views for observation in entries),
        earlier[-_MOST_EARLIER:],
    )
