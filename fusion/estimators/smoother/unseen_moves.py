"""Moves of cameras that only all equations together show.

The association knows each camera by its own covariance. How cameras lie to their neighbours a map
of many drives knows far better: one that was shifted by less than its own sigma may be off by many
of those that the solution has. So the solution is asked: each visit is given a place of its own,
the equations are reduced to all these places, and for each moment between two visits of a camera
it is compared whether it was moved then or not.
"""

from collections.abc import Iterator

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import NANOSECONDS
from trigpoint.fusion.association.events import Events
from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.dataset import CameraMove, DataSet, Entry, Move
from trigpoint.fusion.model.problem import State
from trigpoint.fusion.solver.equations import Reduced, covariance_of
from trigpoint.fusion.solver.levenberg_marquardt import linearise
from trigpoint.geometry.rotation import Array

_AWAY_NS = 10 * NANOSECONDS
# A single visit may be wrong.
_FEWEST_VISITS = 2


class _Part(Struct, frozen=True):
    """What one visit shows of a place, or what is known of it from before (no `entries`). `place`,
    `name`: the names of the place and of this part of it among the cameras."""

    place: str
    name: str
    entries: tuple[int, ...]


def unseen_move(data: DataSet, state: State) -> CameraMove | None:
    """The move of a camera that is likeliest beside none, of a data set that is solved, at its
    `state`; None where none is likelier. Raises LinAlgError where a visit by itself does not
    determine its camera's place."""
    parts = _parts(data, state)
    candidates = [(mine, number) for mine in parts.values() for number in _moments(mine)]
    if not candidates:
        return None
    places = _Places(_apart(data, state, parts), parts)
    events, count = Events(data.site.fusion.priors), len(data.changes)
    prior = events.happened(count + 1) - events.happened(count) + events.pose_score

    def score(step: Array, covariance: Array) -> float:
        pushed = _innovation(step, covariance + events.push)
        return prior + events.moved(pushed) - _innovation(step, covariance)

    scores = [score(*places.moved(mine, number)) for mine, number in candidates]
    best = int(np.argmin(scores))
    return _between(data, *candidates[best]) if scores[best] < 0 else None


def _parts(data: DataSet, state: State) -> dict[str, list[_Part]]:
    """By place, its parts in order of time."""
    visits: dict[str, list[list[int]]] = {
        place: [[]] if place in data.known.poses else []
        for place in data.camera_names
        if place in state.cameras
    }
    seen_ns: dict[str, int] = {}
    stamps = {i: data.entries[i].observation.stamp_ns for i in data.usable(state.cameras)}
    for index, stamp_ns in sorted(stamps.items(), key=lambda item: item[1]):
        place = data.entries[index].observation.camera
        if place not in seen_ns or stamp_ns - seen_ns[place] > _AWAY_NS:
            visits[place].append([])
        visits[place][-1].append(index)
        seen_ns[place] = stamp_ns
    return {
        place: [
            _Part(place, place if each is mine[-1] else f"{place}#{n}", tuple(each))
            for n, each in enumerate(mine)
        ]
        for place, mine in visits.items()
    }


def _moments(parts: list[_Part]) -> Iterator[int]:
    """The numbers of the parts of a place before which its camera may have been moved."""
    for number in range(1, len(parts) - _FEWEST_VISITS + 1):
        if not parts[0].entries or number >= _FEWEST_VISITS:
            yield number


def _apart(data: DataSet, state: State, parts: dict[str, list[_Part]]) -> Reduced:
    """The equations at a state, each part a camera of its own, reduced to these."""
    cameras, lenses = {}, dict(data.lenses)
    entries, moves = list(data.entries), list[Move]()
    for part in (each for mine in parts.values() for each in mine):
        cameras[part.name], lenses[part.name] = state.cameras[part.place], data.lenses[part.place]
        if part.name not in data.site.cameras:
            moves.append(Move(data.site_camera(part.place), part.name, 0, 0))
        for index in part.entries:
            entry = entries[index]
            seen = replace(entry.observation, camera=part.name)
            entries[index] = Entry(seen, entry.map_from_base, entry.share)
    poses = {parts[place][0].name: pose for place, pose in data.known.poses.items()}
    known = replace(data.known, poses=poses)
    apart = replace(data, entries=entries, moves=moves, lenses=lenses, known=known)
    assembled = assemble(apart, State(cameras, state.robots), apart.usable(cameras))
    return linearise(assembled.problem, assembled.start).reduced()


class _Places:
    """The parts' places where those of one place are the same, and how the equations pull at
    them."""

    def __init__(self, apart: Reduced, parts: dict[str, list[_Part]]) -> None:
        self._columns, information = apart.layout.pose, apart.information
        owner = np.arange(apart.layout.size)
        for mine in parts.values():
            for part in mine:
                owner[self._columns[part.name]] = self._columns[mine[0].name]
        owners, column_of = np.unique(owner, return_inverse=True)
        together = np.eye(len(owners))[column_of]
        self._information, self._by_owners = information, information @ together
        self._covariance = covariance_of(together.T @ self._by_owners)
        step = self._covariance @ (together.T @ apart.gradient)
        self._gradient = apart.gradient - self._by_owners @ step
        self._chi2 = float(self._gradient @ np.linalg.solve(information, self._gradient))
        self._freedom = len(owner) - len(owners)

    def moved(self, parts: list[_Part], number: int) -> tuple[Array, Array]:
        """The move (6,) of a place before one of its parts that the equations show, as a
        disturbance of its pose, and its covariance: by as much larger as all else that visits show
        differs more than is expected, since lenses, targets and floors are not quite what they are
        taken to be."""
        rows = np.array([self._columns[part.name] for part in parts[number:]])
        pull = self._gradient[rows].sum(axis=0)
        across = self._by_owners[rows].sum(axis=0)
        own = self._information[rows][:, :, rows].sum(axis=(0, 2))
        covariance = np.linalg.inv(own - across @ self._covariance @ across.T)
        chi2_else = self._chi2 - float(pull @ covariance @ pull)
        scale = max(1.0, chi2_else / max(self._freedom - len(pull), 1))
        return -covariance @ pull, scale * covariance


def _innovation(step: Array, covariance: Array) -> float:
    """νᵀS⁻¹ν + ln |S|."""
    return float(step @ np.linalg.solve(covariance, step) + np.linalg.slogdet(covariance)[1])


def _between(data: DataSet, parts: list[_Part], number: int) -> CameraMove:
    """The move of a place before one of its parts."""
    last, first = (parts[each].entries for each in (number - 1, number))
    since_ns = data.entries[first[0]].observation.stamp_ns
    until_ns = data.entries[last[-1]].observation.stamp_ns if last else since_ns - 1
    return CameraMove(data.site_camera(parts[0].place), until_ns, since_ns)
