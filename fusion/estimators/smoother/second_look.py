"""A second look at sightings that were taken to be wrong.

The association reads each visit's pictures by odometry and by each other. In the solution those
before and after each, of all cameras, determine where the robot stood in between, whatever its
wheels did on the way; a sighting that fits there is correct.
"""

import numpy as np

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.pictures import PictureReader
from trigpoint.fusion.estimators.explained_data import as_read
from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.drift import Drift
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.model.problem import State
from trigpoint.fusion.model.trajectory import interpolated
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique


def take_back(data: DataSet, assembled: Assembled, state: State, events: Events) -> bool:
    """Read every observation that has an unused sighting once more, at its robot's pose in the
    solution, and use the sightings that fit there; whether there were any."""
    waiting: dict[tuple[str, str], list[Entry]] = {}
    for entry in data.entries:
        observation = entry.observation
        is_whole = observation.used_views == len(observation.views)
        if not is_whole and observation.camera in state.cameras and entry.map_from_base is not None:
            waiting.setdefault((observation.camera, observation.robot), []).append(entry)
    changed = False
    for (camera, robot), entries in waiting.items():
        if robot in assembled.problem.chains:
            places = state.robots[robot].base_from_face if assembled.problem.priors.faces else None
            seen = state.cameras[camera]
            reader = PictureReader(data, robot, seen, events, places, is_strict=True)
            changed |= _read_again(data, assembled, state, reader, entries)
    return changed


def _read_again(
    data: DataSet, assembled: Assembled, state: State, reader: PictureReader, entries: list[Entry]
) -> bool:
    """Read one camera's observations of one robot again."""
    camera, robot = entries[0].observation.camera, entries[0].observation.robot
    seen = [
        entry.observation.stamp_ns
        for entry in data.of_camera(camera)
        if entry.observation.robot == robot and entry.observation.verdict is Verdict.ACCEPTED
    ]
    if not seen:
        return False
    known = state.cameras[camera]
    stamps = np.array([entry.observation.stamp_ns for entry in entries])
    taken, seen = (data.true_times_ns(known, np.array(each)) for each in (stamps, unique(seen)))
    poses, drift, is_reached = _there(data, assembled, state, robot, taken, seen)
    rows = np.flatnonzero(is_reached)
    if not len(rows):
        return False
    observations = [entries[row].observation for row in rows.tolist()]
    read = reader.read(observations, poses[rows], drift[rows])
    changed = False
    for row, (readings, wild) in zip(rows.tolist(), read, strict=True):
        entry = entries[row]
        if sum(reading is not None for reading in readings) > entry.observation.used_views:
            entry.observation = as_read(entry.observation, readings, wild)
            entry.map_from_base, changed = poses[row], True
    return changed


def _there(
    data: DataSet,
    assembled: Assembled,
    state: State,
    robot: str,
    stamps_ns: np.ndarray,
    seen_ns: np.ndarray,
) -> tuple[Pose, Array, np.ndarray]:
    """The robot's poses at moments (n) by the solution, the covariance (n, 6, 6) of its motion
    there from the nearest of the moments (m) at which the camera saw it, and whether odometry
    connects the two, (n,). What other cameras saw meanwhile is as uncertain as their poses, and is
    left out."""
    track, chain = data.tracks[robot], assembled.problem.chains[robot]
    moments = np.clip(stamps_ns, track.first_ns, track.last_ns)
    seen = unique(np.clip(seen_ns, track.first_ns, track.last_ns))
    every = unique(np.concatenate([seen, moments]))
    nodes = state.robots[robot].map_from_base
    poses = interpolated(track, chain.scales, chain.stamps_ns, nodes, every)
    drift = Drift.of(track, every, chain.scales, poses)
    after = np.minimum(np.searchsorted(seen, moments), len(seen) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(seen[before] - moments) <= np.abs(seen[after] - moments)
    nearest = seen[np.where(is_before, before, after)]
    here = np.searchsorted(every, moments)
    apart, _ = drift.between(np.searchsorted(every, nearest), here)
    return poses[here], apart, track.pieces(moments) == track.pieces(nearest)
