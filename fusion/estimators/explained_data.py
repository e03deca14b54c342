"""Applies an explanation to a data set, for the solution to take as given; and what it leaves open,
which the solution adds."""

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.explanation import Explanation
from trigpoint.fusion.association.noise import with_noise
from trigpoint.fusion.model.dataset import DataSet, Entry, Move
from trigpoint.fusion.model.observations import (
    Observation,
    Reading,
    Verdict,
    observation_of,
)
from trigpoint.fusion.model.problem import State
from trigpoint.geometry.rotation import Array

# The relative increase of a variance that changes no sigma by more than a two-hundredth.
_LITTLE_SPREAD = 0.01


def explained(data: DataSet, explanation: Explanation) -> tuple[DataSet, State]:
    """A draft of the data set that follows from the explanation alone, and the state to solve from.

    The draft's entries are the explanation's observations, in their order.
    """
    draft = with_noise(data.draft(), explanation.noise)
    draft.odometry_scale = {
        robot: (noise.odometry, noise.slip) for robot, noise in explanation.noise.items()
    }
    draft.corner_scale = dict(explanation.corner_scale)
    _take_lifts(draft, explanation)
    names = _take_moves(draft, explanation)
    state = draft.first_state()
    cameras = {names[key]: camera for key, camera in explanation.places.items()}
    for observation, read in zip(explanation.observations, explanation.reads, strict=True):
        name = names[observation.camera, read.place]
        fresh = observation_of(name, observation.robot, observation.stamp_ns, observation.views)
        if name in cameras:
            fresh = as_read(fresh, read.readings, read.wild)
        draft.entries.append(Entry(fresh, read.map_from_base))
    return draft, State(state.cameras | cameras, state.robots)


def left_open(state: State, explanation: Explanation, events: Events) -> dict[str, Array]:
    """By camera, the covariance (6, 6) of what explanations leave open of its pose: for example
    which of two contradicting faces is wrong; or all of it, where several poses are possible."""
    found = {}
    for camera in state.cameras:
        finding = explanation.findings.get(camera)
        if finding is None:
            continue
        if not finding.is_located:  # known from before, and perhaps not there any more
            found[camera] = np.diag(events.room_variances)
            continue
        place = finding.alternatives[0]
        if np.trace(np.linalg.solve(place.covariance, place.spread)) > _LITTLE_SPREAD:
            found[camera] = place.spread
    return found


def _take_lifts(data: DataSet, explanation: Explanation) -> None:
    for alike in explanation.lifts:
        data.tracks[alike[0].robot].break_between(alike[0].after_ns, alike[0].before_ns)
        data.changes.append(alike)


def _take_moves(data: DataSet, explanation: Explanation) -> dict[tuple[str, int], str]:
    """Add a camera for each earlier pose of one; return (camera, place) -> name."""
    names = {(camera, 0): camera for camera in data.site.cameras}
    for camera in data.site.cameras:
        moves = [move for move in explanation.moves if move.camera == camera]
        for number, move in enumerate(moves):
            name = f"{camera}@{number + 1}"
            names[camera, number] = name
            names[camera, number + 1] = camera
            data.lenses[name] = data.lenses[camera]
            data.moves.append(Move(camera, name, move.since_ns, move.until_ns))
            data.changes.append((move,))
    data.moves.sort(key=lambda move: move.since_ns)
    poses = {names[camera, 0]: pose for camera, pose in data.known.poses.items()}
    data.known = replace(data.known_at_start, poses=poses)
    return names


def as_read(
    observation: Observation, readings: Sequence[Reading | None], wild: Sequence[np.ndarray]
) -> Observation:
    """An observation by its views' readings, None where a view is wrong, and outlier corners."""
    if all(reading is None for reading in readings):
        return observation.judged(Verdict.REJECTED)
    views = zip(readings, observation.views, strict=True)
    chosen = tuple(reading or view.readings[0] for reading, view in views)
    outliers = tuple(
        flags if reading is not None else np.ones_like(flags)
        for reading, flags in zip(readings, wild, strict=True)
    )
    done = observation.read_as(chosen).judged(Verdict.ACCEPTED)
    return done.with_outliers(outliers) if any(np.any(flags) for flags in outliers) else done
