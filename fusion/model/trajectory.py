"""A robot's pose at any moment, from a solution's nodes and its odometry."""

import numpy as np

from trigpoint.base.clock import NANOSECONDS
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .motion import composed
from .odometry import OdometryTrack


def interpolated(
    track: OdometryTrack, scales: Array, nodes_ns: np.ndarray, nodes: Pose, stamps_ns: np.ndarray
) -> Pose:
    """map_from_base at moments (m,) that odometry covers, interpolated between nodes at `nodes_ns`
    (n,), in order, by odometry with scale errors (2,).

    Each pose follows from the node before it by odometry; the discrepancy at the node after it is
    distributed linearly in time. Before the first node odometry is followed backwards, after the
    last one forwards, and likewise on either side of a jump.
    """
    every, where = np.unique(np.concatenate([nodes_ns, stamps_ns]), return_inverse=True)
    odometry = _dead_reckoned(track, scales, every)
    at_node = where[: len(nodes_ns)]
    before = np.clip(np.searchsorted(nodes_ns, stamps_ns, "right") - 1, 0, None)
    wanted = where[len(nodes_ns) :]
    start = odometry[at_node[before]]
    pose = nodes[before] @ start.inverse() @ odometry[wanted]
    after = np.minimum(before + 1, len(nodes_ns) - 1)
    expected = nodes[before] @ start.inverse() @ odometry[at_node[after]]
    missing = nodes[after].difference(expected)
    gap = nodes_ns[after] - nodes_ns[before]
    share = np.clip((stamps_ns - nodes_ns[before]) / np.maximum(gap, 1), 0, 1)
    pieces, of_nodes = track.pieces(stamps_ns), track.pieces(nodes_ns)
    is_joined = (after > before) & (of_nodes[before] == of_nodes[after])
    pose = pose.disturbed(missing * np.where(is_joined, share, 0)[:, None])
    is_beyond = (pieces != of_nodes[before]) & (pieces == of_nodes[after])
    if not np.any(is_beyond):
        return pose
    back = nodes[after] @ odometry[at_node[after]].inverse() @ odometry[wanted]
    chosen = is_beyond[:, None]
    return Pose(
        np.where(chosen[..., None], back.rotation, pose.rotation),
        np.where(chosen, back.translation, pose.translation),
    )


def _dead_reckoned(track: OdometryTrack, scales: Array, stamps_ns: np.ndarray) -> Pose:
    """Poses at moments by dead reckoning, relative to the first one."""
    if len(stamps_ns) == 1:
        return Pose.stack([Pose.identity()])
    return composed(track.motion(stamps_ns, scales).earlier_from_later)


def odometry_poses(track: OdometryTrack, moments: np.ndarray) -> Pose:
    """Where odometry alone puts a robot at moments (n,) that it covers, odom_from_base (n)."""
    rows = np.clip(np.searchsorted(track.stamps_ns, moments, "right") - 1, 0, len(track) - 1)
    after_s = (moments - track.stamps_ns[rows]) / NANOSECONDS
    carried, _ = track.carried(track.stamps_ns[rows], after_s, np.zeros(2))
    return track.odom_from_base[rows] @ carried
