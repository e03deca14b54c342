"""What became of each sighting that a filter went through, and the robots' ways by that."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import Pose

from .belief import Belief, Surprise
from .dataset import DataSet
from .problem import Chain
from .trajectory import interpolated


@dataclass(slots=True)
class Step:
    """What became of one sighting. `before`: the belief before it, None where that is too long ago;
    `map_from_base`: afterwards; `surprise`: None where it was set aside."""

    time_ns: int
    entry: int
    before: Belief | None
    map_from_base: Pose | None
    surprise: Surprise | None


def nodes_of(data: DataSet, steps: list[Step], robot: str) -> dict[int, Pose]:
    """The robot's poses after its sightings by their times, ascending."""
    nodes: dict[int, Pose] = {}
    track = data.tracks[robot]
    if robot == data.anchored_robot and len(track):
        nodes[track.first_ns] = track.odom_from_base[0]
    for step in steps:
        is_mine = data.entries[step.entry].observation.robot == robot
        if is_mine and step.map_from_base is not None:
            nodes[step.time_ns] = step.map_from_base
    return nodes


def poses_at(
    data: DataSet, belief: Belief, robot: str, nodes: dict[int, Pose], stamps_ns: np.ndarray
) -> Pose:
    """The robot at moments (m,) that odometry covers, by its nodes and its odometry."""
    track = data.tracks[robot]
    chain = Chain(
        robot=robot,
        stamps_ns=np.array(list(nodes)),
        motion=None,
        track=track,
        scales=belief.scales(robot),
        planar=track.planar,
        is_anchored=False,
    )
    return interpolated(track, chain, Pose.stack(list(nodes.values())), stamps_ns)
