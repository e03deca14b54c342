"""The poses from which Gauss-Newton searches the minimum of a graph.

A tie may be the first to constrain a part of a robot's path: the path of a robot that may have
started anywhere, or what follows a lift. From metres away Gauss-Newton takes many steps, so such a
part is first moved rigidly to where the tie puts it.
"""

from itertools import pairwise

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .graph import Graph, Layout, Place, Placed, Variant

# A part that is off by less than this (m, rad) is left to Gauss-Newton.
_FAR = 0.1
# A tie: its node, its place, its visit and mode.
_Seen = tuple[int, Place, int, int]


def initial_poses(graph: Graph, layout: Layout, variant: Variant) -> Array:
    """Return the initial poses (n, 12) of a layout: as in the graph that the variant is near, or
    else by odometry, with the parts that new ties constrain moved to their first ones."""
    return _Start(graph, layout, variant).poses


class _Start:
    """One variant's poses, and the `places` that have one already."""

    def __init__(self, graph: Graph, layout: Layout, variant: Variant) -> None:
        self.graph, self.layout, self.variant = graph, layout, variant
        known = graph.data.known.poses
        self.poses = np.concatenate([graph.odometry, np.zeros((len(layout.at), 12))])
        self.near = near = variant.near
        if near is not None:
            self._take_nodes(near)
            kept = [
                (row, near.layout.at[key])
                for key, row in layout.at.items()
                if key in near.layout.at
            ]
            mine, theirs = np.array(kept, dtype=int).reshape(-1, 2).T
            self.poses[mine] = near.poses[theirs]
        self.poses[[layout.at[camera, 0] for camera in known]] = graph.known_rows
        self.places: set[Place] = {(camera, 0) for camera in known}
        ties = self._ties()
        for robot in sorted(graph.paths, key=lambda name: not graph.paths[name].is_anchored):
            lifts = sorted(gap + 1 for name, gap in variant.breaks if name == robot)
            for first, end in pairwise([0, *lifts, len(graph.paths[robot].stamps_ns)]):
                here = [tie for tie in ties[robot] if first <= tie[0] < end]
                self._place(robot, first, end, here)

    def _take_nodes(self, near: Placed) -> None:
        """Take the nodes of a similar graph, but for a robot that was lifted there and is not."""
        lifted = {robot for robot, _ in near.breaks - self.variant.breaks}
        for robot, first in self.layout.first.items():
            mine = slice(first, first + len(self.graph.paths[robot].stamps_ns))
            if robot not in lifted:
                self.poses[mine] = near.poses[mine]
        if lifted:  # where it put cameras is not known any more
            self.near = None

    def _ties(self) -> dict[str, list[_Seen]]:
        """Return each robot's ties, in order of its nodes."""
        graph = self.graph
        found: dict[str, list[_Seen]] = {robot: [] for robot in graph.paths}
        for number, tie in self.variant.ties.items():
            visit = graph.visits[number].visit
            place = visit.camera, tie.place
            found[visit.robot].append((graph.node_of[number], place, number, tie.mode))
        return {robot: sorted(ties) for robot, ties in found.items()}

    def _place(self, robot: str, first: int, end: int, ties: list[_Seen]) -> None:
        """Move a part of a robot's path to where its first tie to one of the places puts it, unless
        it is there as in the graph that is near; then, the places of its other ties."""
        settled = {} if self.near is None else self.near.ties
        is_moved = False
        if any(settled.get(number) != self.variant.ties[number] for _, _, number, _ in ties):
            is_held = self.graph.paths[robot].is_anchored and not first
            shift = None if is_held else self._shift(robot, ties)
            is_moved = shift is not None
            if shift is not None:
                start = self.layout.first[robot]
                part = slice(start + first, start + end)
                self.poses[part] = (shift @ Pose.from_rows(self.poses[part])).rows()
        for node, place, number, mode in ties:
            if place in self.places:
                continue
            self.places.add(place)
            if is_moved or self.near is None or place not in self.near.layout.at:
                seen = self.graph.relative(number)[0][mode]
                self.poses[self.layout.at[place]] = (self._node(robot, node) @ seen).rows()[0]

    def _shift(self, robot: str, ties: list[_Seen]) -> Pose | None:
        """Return the motion that takes a part of a path to where its first tie to one of the places
        puts it; None if it has no such tie, or is within `_FAR` of there."""
        for node, place, number, mode in ties:
            if place not in self.places:
                continue
            camera = Pose.from_rows(self.poses[self.layout.at[place]])
            there = camera @ self.graph.relative(number)[0][mode].inverse()
            here = self._node(robot, node)
            if self.graph.paths[robot].track.planar:
                x, y, _ = there.translation
                there = Pose.planar(x, y, there.heading)
            is_far = np.abs(there.difference(here)).max() > _FAR
            return there @ here.inverse() if is_far else None
        return None

    def _node(self, robot: str, node: int) -> Pose:
        return Pose.from_rows(self.poses[self.layout.first[robot] + node])
