"""A camera that was moved: its sightings until then stay with its earlier pose.

The earlier pose becomes a camera of its own in the data set, «c1@1», which goes on holding the
robot's path where it was seen from there; lens and clock stay one camera's. The camera itself is
located anew from what it saw since.
"""

from dataclasses import replace

import numpy as np

from trigpoint.fusion.model.dataset import KnownCameras, Move
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.problem import State
from trigpoint.fusion.solver.filter import Filter
from trigpoint.geometry.pose import angle_between

from .batch import BatchSolution

# A camera stands elsewhere where its new pose is this far from the old one: far beyond what the
# few pictures since leave open, and far below what anyone would call moving it.
_LEAST_SHIFT_M = 0.01
_LEAST_TURN_RAD = 0.01


def relocate(batch: BatchSolution, camera: str, since_ns: int, known: Filter) -> bool:
    """Split a camera at a moment and locate it by what it saw since; whether that succeeded.

    Where it does not, everything is as before.
    """
    data = batch.data
    before = batch.state, data.known
    entries = [(entry.observation, entry.map_from_base) for entry in data.entries]
    old = batch.state.cameras[camera]
    move = _split(batch, camera, since_ns, known)
    if batch.locate(camera):
        new = batch.state.cameras[camera].map_from_camera
        shift = np.linalg.norm(new.translation - old.map_from_camera.translation)
        is_turned = angle_between(new, old.map_from_camera) > _LEAST_TURN_RAD
        if shift > _LEAST_SHIFT_M or is_turned:
            data.moves.append(move)
            data.note(
                "camera_moved",
                f"camera {camera} was moved by {shift:.2f} m; it is located anew, and what it saw "
                "before stays with its earlier place",
            )
            return True
    data.rename(move.name, camera, until_ns=since_ns)
    for entry, (observation, map_from_base) in zip(data.entries, entries, strict=True):
        entry.observation, entry.map_from_base = observation, map_from_base
    del data.lenses[move.name]
    batch.state, data.known = before
    batch.undetermined.pop(camera, None)
    return False


def _split(batch: BatchSolution, camera: str, since_ns: int, known: Filter) -> Move:
    data = batch.data
    number = 1 + sum(move.camera == camera for move in data.moves)
    name = f"{camera}@{number}"
    data.rename(camera, name, until_ns=since_ns)
    for entry in data.of_camera(camera):
        observation = entry.observation
        entry.observation = observation.judged(Verdict.PENDING)
        entry.map_from_base = batch.pose_at(known, observation.robot, observation.stamp_ns)
    old = [entry.observation.stamp_ns for entry in data.of_camera(name)]
    data.lenses[name] = data.lenses[camera]
    data.known = _renamed(data.known, camera, name)
    cameras = {name if key == camera else key: value for key, value in batch.state.cameras.items()}
    batch.state = State(cameras, batch.state.robots)
    return Move(camera, name, since_ns, max(old, default=since_ns))


def _renamed(known: KnownCameras, camera: str, name: str) -> KnownCameras:
    poses = {name if key == camera else key: pose for key, pose in known.poses.items()}
    return KnownCameras(poses, known.information)


def of_its_time(moves: list[Move], observation: Observation) -> Observation:
    """An observation that comes late, as one of where its camera was then."""
    for move in moves:
        if move.camera == observation.camera and observation.stamp_ns < move.since_ns:
            return replace(observation, camera=move.name)
    return observation
