"""Where the search for a graph's minimum starts.

A tie may be the first to hold a part of a robot's way: that of a robot which began anywhere, or
what came after a lift. From metres away Gauss-Newton takes many steps, so such a part is first
moved, as one, to where the tie puts it.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from trigpoint.geometry import Pose

from .graph import Graph, Place, Variant

# What is off by less (m, rad) is left to the steps.
_FAR = 0.1
# Node, place, and base_from_camera.
_Seen = tuple[int, Place, Pose]


def initial_values(graph: Graph, variant: Variant) -> tuple[dict[str, Pose], dict[Place, Pose]]:
    """By robot its nodes (n), and where the places are: as in what the variant is near, else along
    odometry."""
    known = graph.data.known.poses
    places: dict[Place, Pose] = {(camera, 0): pose for camera, pose in known.items()}
    nodes: dict[str, Pose] = {}
    ties = _ties(graph, variant)
    for robot in sorted(graph.paths, key=lambda name: not graph.paths[name].is_anchored):
        path = graph.paths[robot]
        gaps = sorted(gap for name, gap in variant.breaks if name == robot)
        near = variant.near
        if near is not None and any(b[0] == robot for b in near.breaks - variant.breaks):
            near = None  # its nodes are apart where these are not
        whole = path.odometry if near is None else near.nodes[robot]
        parts = []
        for first, end in pairwise([0, *(gap + 1 for gap in gaps), len(path.stamps_ns)]):
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


def _shift(
    part: Pose, ties: Sequence[_Seen], places: dict[Place, Pose], *, is_planar: bool
) -> Pose | None:
    """What moves a part of a way to where its first tie to a known place puts it; None where it
    has none, or is there."""
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
    """By robot, in order of its nodes."""
    found: dict[str, list[_Seen]] = {robot: [] for robot in graph.paths}
    for number, tie in variant.ties.items():
        visit = graph.visits[number].visit
        seen = graph.relative(number)[0][tie.mode]
        found[visit.robot].append((graph.node_of[number], (visit.camera, tie.place), seen))
    return {robot: sorted(ties, key=lambda tie: tie[0]) for robot, ties in found.items()}
