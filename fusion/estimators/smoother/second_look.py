"""A second look at sightings that were taken to be wrong.

The association reads most pictures of a visit where odometry leads from a few of them. In the
solution those before and after each say where the robot stood in between, whatever its wheels
did on the way; what fits there is right.
"""

from collections.abc import Sequence

import numpy as np

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.explanation import Read
from trigpoint.fusion.association.pictures import PictureReader
from trigpoint.fusion.estimators.explained_data import as_read
from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.problem import State
from trigpoint.fusion.model.trajectory import interpolated
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array


def take_back(
    data: DataSet, reads: Sequence[Read], assembled: Assembled, state: State, events: Events
) -> bool:
    """Read every observation that was judged by odometry alone and has a sighting that is not used
    again, where the solution puts its robot, and use what is right by that; whether there was any.

    `reads`: of the data set's entries.
    """
    waiting: dict[tuple[str, str], list[Entry]] = {}
    for entry, read in zip(data.entries, reads, strict=True):
        if not read.is_alone:
            continue
        observation = entry.observation
        is_whole = observation.used_views == len(observation.views)
        if not is_whole and observation.camera in state.cameras and entry.map_from_base is not None:
            waiting.setdefault((observation.camera, observation.robot), []).append(entry)
    changed = False
    for (camera, robot), entries in waiting.items():
        if robot in assembled.problem.chains:
            places = state.robots[robot].base_from_face if assembled.problem.priors.faces else None
            reader = PictureReader(data, robot, state.cameras[camera], events, places)
            changed |= _read_again(data, assembled, state, reader, entries)
    return changed


def _read_again(
    data: DataSet, assembled: Assembled, state: State, reader: PictureReader, entries: list[Entry]
) -> bool:
    """Read one camera's observations of one robot again."""
    robot = entries[0].observation.robot
    stamps = np.array([entry.observation.stamp_ns for entry in entries])
    poses, drift, is_reached = _there(data, assembled, state, robot, stamps)
    rows = np.flatnonzero(is_reached).tolist()
    if not rows:
        return False
    observations = [entries[row].observation for row in rows]
    read = reader.read(observations, poses[rows], drift[rows])
    changed = False
    for row, (readings, wild) in zip(rows, read, strict=True):
        entry = entries[row]
        if sum(reading is not None for reading in readings) > entry.observation.used_views:
            entry.observation = as_read(entry.observation, readings, wild)
            entry.map_from_base, changed = poses[row], True
    return changed


def _there(
    data: DataSet, assembled: Assembled, state: State, robot: str, stamps_ns: np.ndarray
) -> tuple[Pose, Array, np.ndarray]:
    """Where a robot stood at moments (n) by the solution, the covariance (n, 6, 6) of how it went
    there from the nearest moment at which it was seen, and whether odometry leads there, (n,)."""
    track, chain = data.tracks[robot], assembled.problem.chains[robot]
    moments = np.clip(stamps_ns, track.first_ns, track.last_ns)
    nodes = chain.stamps_ns
    poses = interpolated(track, chain, state.robots[robot].map_from_base, moments)
    every = np.unique(np.concatenate([nodes, moments]))
    drift = np.zeros((len(every), 6, 6))
    if len(every) > 1:
        drift[1:] = np.cumsum(track.motion(every, chain.scales).covariance, axis=0)
    after = np.minimum(np.searchsorted(nodes, moments), len(nodes) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(nodes[before] - moments) <= np.abs(nodes[after] - moments)
    nearest = nodes[np.where(is_before, before, after)]
    here, there = np.searchsorted(every, moments), np.searchsorted(every, nearest)
    apart = drift[np.maximum(here, there)] - drift[np.minimum(here, there)]
    return poses, apart, track.pieces(moments) == track.pieces(nearest)
