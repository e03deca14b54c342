"""Moves of cameras that only all equations together show.

The association knows each camera by its own covariance. How cameras lie to their neighbours a map
of many drives knows far better: one that was shifted by less than its own sigma may be off by many
of those that the solution has. So the solution is asked: each of its newest visits is given a place
of its own, the equations are reduced to all these places, and for each moment between two of them
it is compared whether the camera was moved then or not.
"""

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.dataset import CameraMove, DataSet, Entry, Move
from trigpoint.fusion.model.problem import State
from trigpoint.fusion.solver.equations import Reduced, covariance_of
from trigpoint.fusion.solver.levenberg_marquardt import linearise
from trigpoint.geometry.rotation import Array

from .settled_past import AWAY_NS

# A single visit may be wrong.
_FEWEST_VISITS = 2
# So many visits to a place are told apart, from those before, and of so many places at once: what a
# map of a hundred cameras and of many days costs stays below a solution. A move is asked about at
# the second visit after it, and up to two visits later.
_MOST_VISITS, _MOST_PLACES = 4, 16


class _Part(Struct, frozen=True):
    """What one visit shows of a place, or all before the newest ones. `place`, `name`: the names of
    the place and of this part of it among the cameras; `is_sure`: whether it rests on more than a
    single visit."""

    place: str
    name: str
    entries: tuple[int, ...]
    is_sure: bool


def unseen_move(data: DataSet, state: State, since_ns: int) -> CameraMove | None:
    """The move of a camera that is likeliest beside none, of those that were seen since a moment,
    of a data set that is solved, at its `state`; None where none is likelier. Raises LinAlgError
    where a visit by itself does not determine its camera's place."""
    parts = _parts(data, state)
    asked = [
        mine
        for mine in parts.values()
        if any(_moments(mine)) and _newest_ns(data, mine[-1].entries) > since_ns
    ]
    found = [
        _likeliest(data, state, parts, asked[first : first + _MOST_PLACES])
        for first in range(0, len(asked), _MOST_PLACES)
    ]
    score, move = min(found, key=lambda each: each[0], default=(0.0, None))
    return move if score < 0 else None


def _likeliest(
    data: DataSet, state: State, parts: dict[str, list[_Part]], asked: list[list[_Part]]
) -> tuple[float, CameraMove]:
    """The likeliest move of these places, and its score beside none."""
    apart = {place: [_joined(mine)] for place, mine in parts.items()}
    apart |= {mine[0].place: mine for mine in asked}
    places = _Places(_apart(data, state, apart), apart)
    events, count = Events(data.site.fusion.priors), len(data.changes)
    prior = events.happened(count + 1) - events.happened(count) + events.pose_score

    def score(step: Array, covariance: Array) -> float:
        pushed = _innovation(step, covariance + events.push)
        return prior + events.moved(pushed) - _innovation(step, covariance)

    moments = [(mine, number) for mine in asked for number in _moments(mine)]
    scores = [score(*places.moved(mine, number)) for mine, number in moments]
    best = int(np.argmin(scores))
    return scores[best], _between(data, *moments[best])


def _parts(data: DataSet, state: State) -> dict[str, list[_Part]]:
    """By place that is known or was seen, its parts in order of time."""
    visits = {place: list[list[int]]() for place in data.camera_names if place in state.cameras}
    seen_ns: dict[str, int] = {}
    stamps = {i: data.entries[i].observation.stamp_ns for i in data.usable(state.cameras)}
    for index, stamp_ns in sorted(stamps.items(), key=lambda item: item[1]):
        place = data.entries[index].observation.camera
        if place not in seen_ns or stamp_ns - seen_ns[place] > AWAY_NS:
            visits[place].append([])
        visits[place][-1].append(index)
        seen_ns[place] = stamp_ns
    found = {}
    for place, mine in visits.items():
        older, is_known = mine[:-_MOST_VISITS], place in data.known.poses
        is_sure = is_known or len(older) >= _FEWEST_VISITS
        parts = [(list(chain(*older)), is_sure)] if older or is_known else []
        parts += [(each, False) for each in mine[-_MOST_VISITS:]]
        found[place] = [
            _Part(place, place if n == len(parts) - 1 else f"{place}#{n}", tuple(each), is_sure)
            for n, (each, is_sure) in enumerate(parts)
        ]
    return {place: mine for place, mine in found.items() if mine}


def _newest_ns(data: DataSet, entries: Sequence[int]) -> int:
    return max(data.entries[index].observation.stamp_ns for index in entries)


def _joined(parts: list[_Part]) -> _Part:
    entries = tuple(index for part in parts for index in part.entries)
    return _Part(parts[0].place, parts[0].place, entries, is_sure=True)


def _moments(parts: list[_Part]) -> Iterator[int]:
    """The numbers of the parts of a place before which its camera may have been moved."""
    for number in range(1, len(parts) - _FEWEST_VISITS + 1):
        if parts[0].is_sure or number >= _FEWEST_VISITS:
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
