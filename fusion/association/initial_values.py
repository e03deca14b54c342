"""The poses from which Gauss-Newton searches the minimum of a graph: those of a similar one, moved
by the core (`native/src/fusion/graph_start.cpp`) to where new ties put them."""

from itertools import pairwise

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .graph import Graph, Layout, Tie, Variant

Ties = list[tuple[int, Tie]]
"""Visits, in order, and what is used of each."""
_REAL, _WHOLE = np.float64, np.int64
START = Kernel(
    "tp_graph_start",
    *(Out(_REAL, ("n", 12)), In(_WHOLE, ("n", 2)), In(_WHOLE, ("r", 4))),
    *(In(_WHOLE, ("k", 4)), In(_REAL, ("k", 12)), In(_WHOLE, ("k",))),
)


def initial_poses(
    graph: Graph, layout: Layout, variant: Variant, ties: Ties, ends: np.ndarray, seen: Array
) -> Array:
    """Return the initial poses (n, 12) of a layout: as in the graph that the variant is near, or
    else by odometry, with the parts that new ties constrain moved to their first ones.

    `ties`: the variant's (k); `ends` (k, 4): first the two poses that each ties; `seen` (k, 12):
    the second, as seen from the first.
    """
    near = variant.near
    poses = np.concatenate([graph.odometry, np.zeros((len(layout.at), 12))])
    begun, settled = np.zeros((len(poses), 2), _WHOLE), {}
    if near is not None:
        lifted = {robot for robot, _ in near.breaks - variant.breaks}
        for robot, first in layout.first.items():
            mine = slice(first, first + len(graph.paths[robot].stamps_ns))
            if robot not in lifted:
                poses[mine] = near.poses[mine]
        if not lifted:  # else where it put cameras is not known any more
            settled = near.ties
            for place in layout.at.keys() & near.layout.at.keys():
                poses[layout.at[place]] = near.poses[near.layout.at[place]]
                begun[layout.at[place], 1] = 1
    known = [layout.at[camera, 0] for camera in graph.data.known.poses]
    poses[known], begun[known, 0] = graph.known_rows, 1
    is_new = [settled.get(number) != tie for number, tie in ties]
    START(poses, begun, _parts(graph, layout, variant), ends, seen, np.array(is_new, _WHOLE))
    return poses


def _parts(graph: Graph, layout: Layout, variant: Variant) -> np.ndarray:
    """Return the parts (r, 4) of the robots' paths between lifts, the anchored robot's first: its
    poses, whether it begins where it has to, whether it is in the plane."""
    found = []
    for robot in sorted(graph.paths, key=lambda name: not graph.paths[name].is_anchored):
        path, start = graph.paths[robot], layout.first[robot]
        lifts = sorted(gap + 1 for name, gap in variant.breaks if name == robot)
        for first, end in pairwise([0, *lifts, len(path.stamps_ns)]):
            is_held = path.is_anchored and not first
            found.append((start + first, start + end, is_held, path.track.planar))
    return np.array(found, _WHOLE)
