"""Applies an explanation to the data set, for the solution to take as given."""

import msgspec
import numpy as np

from trigpoint.fusion.association.explanation import Explanation, Read
from trigpoint.fusion.model.dataset import CameraMove, DataSet, Entry, KnownCameras, Lift, Move
from trigpoint.fusion.model.observations import Observation, Verdict, observation_of
from trigpoint.fusion.model.odometry import PARTS, SLIP
from trigpoint.fusion.model.problem import State


def apply_explanation(data: DataSet, explanation: Explanation) -> State:
    """Make the data set what the explanation says, and nothing else; the state to solve from.

    Its entries are the explanation's observations, in their order.
    """
    _take_noise(data, explanation)
    _take_lifts(data, explanation)
    names = _take_moves(data, explanation)
    state = data.first_state()
    cameras = {names[key]: camera for key, camera in explanation.places.items()}
    data.forget_from(0)
    for observation, read in zip(explanation.observations, explanation.reads, strict=True):
        name = names[observation.camera, read.place]
        fresh = observation_of(name, observation.robot, observation.stamp_ns, observation.views)
        if name in cameras:
            fresh = _read(fresh, read)
        data.entries.append(Entry(fresh, read.map_from_base))
    return State(state.cameras | cameras, state.robots)


def _take_noise(data: DataSet, explanation: Explanation) -> None:
    data.jitter.clear()
    for robot, noise in explanation.noise.items():
        track, stated = data.tracks[robot], data.site.robots[robot].odometry
        scaled = {part: getattr(stated, part) * noise.odometry for part in PARTS}
        track.noise = msgspec.structs.replace(stated, **scaled)
        track.slip, track.skid = SLIP * noise.slip, 0.0
        data.odometry_scale[robot] = (noise.odometry, noise.slip)
        if noise.jitter is not None:
            data.jitter[robot] = noise.jitter


def _take_lifts(data: DataSet, explanation: Explanation) -> None:
    data.changes = []
    for track in data.tracks.values():
        track.mend()
    for lift in explanation.lifts:
        data.tracks[lift.robot].break_between(lift.after_ns, lift.before_ns)
        spans = [(lift.after_ns, lift.before_ns), *lift.or_between]
        data.changes.append(tuple(Lift(lift.robot, *span) for span in spans))


def _take_moves(data: DataSet, explanation: Explanation) -> dict[tuple[str, int], str]:
    """Add a camera for each earlier pose of one; the name of each."""
    first = {data.site_camera(name): pose for name, pose in data.known.poses.items()}
    data.moves = []
    names = {(camera, 0): camera for camera in data.site.cameras}
    for camera in data.site.cameras:
        moves = [move for move in explanation.moves if move.camera == camera]
        for number, move in enumerate(moves):
            name = f"{camera}@{number + 1}"
            names[camera, number] = name
            names[camera, number + 1] = camera
            data.lenses[name] = data.lenses[camera]
            data.moves.append(Move(camera, name, move.since_ns, move.until_ns))
            data.changes.append((CameraMove(camera, move.until_ns, move.since_ns),))
    data.moves.sort(key=lambda move: move.since_ns)
    poses = {names[camera, 0]: pose for camera, pose in first.items()}
    data.known = KnownCameras(poses, data.known.information)
    return names


def _read(observation: Observation, read: Read) -> Observation:
    """An observation as the explanation reads it."""
    if all(reading is None for reading in read.readings):
        return observation.judged(Verdict.REJECTED)
    chosen = tuple(
        reading if reading is not None else view.readings[0]
        for reading, view in zip(read.readings, observation.views, strict=True)
    )
    outliers = tuple(
        wild if reading is not None else np.ones_like(wild)
        for reading, wild in zip(read.readings, read.wild, strict=True)
    )
    done = observation.read_as(chosen).judged(Verdict.ACCEPTED)
    return done.with_outliers(outliers) if any(np.any(wild) for wild in outliers) else done
