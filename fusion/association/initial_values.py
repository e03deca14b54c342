"""The initial values from which Gauss-Newton searches the minimum of a graph.

A tie may be the first to constrain a part of a robot's path: the path of a robot that may have
started anywhere, or what follows a lift. From metres away Gauss-Newton takes many steps, so such a
part is first moved rigidly to where the tie puts it.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from trigpoint.geometry import Pose

from .graph import Graph, Place, Placed, Variant

# A part that is off by less than this (m, rad) is left to Gauss-Newton.
_FAR = 0.1
# A tie: its node, its place, and base_from_camera.
_Seen = tuple[int, Place, Pose]


def initial_values(graph: Graph, variant: Variant) -> tuple[dict[str, Pose], dict[Place, Pose]]:
    """Return the initial poses of each robot's nodes (n) and of the places: as in the graph that
    the variant is near, or else by odometry, with loose parts moved to their first ties."""
    known = graph.data.known.poses
    places: dict[Place, Pose] = {(camera, 0): pose for camera, pose in known.items()}
    nodes: dict[str, Pose] = {}
    ties = _ties(graph, variant)
    for robot in sorted(graph.paths, key=lambda name: not graph.paths[name].is_anchored):
        path, near = graph.paths[robot], _near(variant, robot)
        whole = path.odometry if near is None else near.nodes[robot]
        lifts = sorted(gap + 1 for name, gap in variant.breaks if name == robot)
        parts = []
        for first, end in pairwise([0, *lifts, len(path.stamps_ns)]):
            part = whole[first:end]
            here = [(n - first, place, seen) for n, place, seen in ties[robot] if first <= n < end]
            is_held = path.is_anchored and not first
            shift = None if is_held else _shift(part, here, places, is_planar=path.track.planar)
            if shift is not None:
                part = shift @ part
            there = near.places if near is not None and shift is None else {}
            for node, place, seen in here:
                places.setdefault(place, there.get(place) or part[node] @ seen)
            parts.append(part)
        rotation = np.concatenate([part.rotation for part in parts])
        nodes[robot] = Pose(rotation, np.concatenate([part.translation for part in parts]))
    return nodes, places


def _near(variant: Variant, robot: str) -> Placed | None:
    """Return the graph that the variant is near; None if this robot's path is broken there where it
    is not here."""
    near = variant.near
    if near is None or any(name == robot for name, _ in near.breaks - variant.breaks):
        return None
    return near


def _shift(
    part: Pose, ties: Sequence[_Seen], places: dict[Place, Pose], *, is_planar: bool
) -> Pose | None:
    """Return the motion that takes a part of a path to where its first tie to one of the places
    puts it; None if it has no such tie, or is within `_FAR` of there."""
    for node, place, seen in ties:
        if place not in places:
            continue
        there, here = places[place] @ seen.inverse(), part[node]
        if is_planar:
            x, y, _ = there.translation
            there = Pose.planar(x, y, there.heading)
        is_far = np.abs(there.difference(here)).max() > _FAR
        return there @ here.inverse() if is_far else None
    return None


def _ties(graph: Graph, variant: Variant) -> dict[str, list[_Seen]]:
    """Return each robot's ties, in order of its nodes."""
    found: dict[str, list[_Seen]] = {robot: [] for robot in graph.paths}
    for number, tie in variant.ties.items():
        visit = graph.visits[number].visit
        seen = graph.relative(number)[0][tie.mode]
        found[visit.robot].append((graph.node_of[number], (visit.camera, tie.place), seen))
    return {robot: sorted(ties, key=lambda tie: tie[0]) for robot, ties in found.items()}
