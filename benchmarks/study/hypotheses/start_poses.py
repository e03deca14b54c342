"""Start poses of the search for an unlocated camera: those that single pictures allow, refined to
fit the other pictures too."""

from itertools import chain

import numpy as np

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.thinning import thinned
from trigpoint.fusion.reading import faces
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from . import coarse_fit
from .camera_hypotheses import placed

_MOST_SEEDS = 10
_FEW_PICTURES = 6
_MOST_PICTURES = 16
_MOST_KEPT = 40
# A start whose mean-square error, pixels², is this much above the best one's cannot be what it is:
# odometry between two pictures gives way by centimetres, which are up to ten pixels.
_HOPELESS_PX2 = 100.0
# Costs that differ by less than this share are equal but for rounding, as those of equal faces are
# where there is a single picture.
_EQUAL_SHARE = 1e-6


def starts_of(data: DataSet, camera: str, indices: list[int], *, most: int) -> list[Pose]:
    """The distinct camera poses that fit these observations best, best first: `most` of them, and
    those that fit as well as the last.

    The robot's pose must be known at each.
    """
    poses = _of_single_pictures(data, camera, spread(indices, _MOST_SEEDS))
    if poses is None:
        return []
    lens = data.lenses[camera]
    each = [_view_batches(data, index) for index in spread(indices, _MOST_PICTURES)]
    seen = list(chain.from_iterable(each))
    few = [each[i] for i in spread(list(range(len(each))), _FEW_PICTURES)]
    costs = coarse_fit.mean_cost(poses, list(chain.from_iterable(few)), lens)
    ordered = poses[np.argsort(costs, kind="stable")]
    kept = ordered[_distinct(ordered, _MOST_KEPT)]
    refined = coarse_fit.coarsely_refined(kept, seen, lens)
    costs = coarse_fit.mean_cost(refined, seen, lens)
    order = np.argsort(costs, kind="stable")
    order = order[costs[order] < costs[order[0]] + _HOPELESS_PX2]
    chosen = order[_distinct(refined[order], _MOST_KEPT)]
    if len(chosen) > most:
        chosen = chosen[costs[chosen] <= costs[chosen[most - 1]] * (1 + _EQUAL_SHARE)]
    return [refined[i] for i in chosen]


def spread(indices: list[int], most: int) -> list[int]:
    """At most `most` of them, evenly spread."""
    return [indices[i] for i in thinned(len(indices), most)]


def _of_single_pictures(data: DataSet, camera: str, indices: list[int]) -> Pose | None:
    poses = []
    for index in indices:
        entry = data.entries[index]
        target = data.targets[entry.observation.robot]
        poses += [
            placed(entry) @ candidate.camera_from_base.inverse()
            for candidate in faces.candidates(entry.observation, target, data.lenses[camera])
        ]
    return Pose.stack(poses) if poses else None


def _view_batches(data: DataSet, index: int) -> list[coarse_fit.ViewBatch]:
    entry = data.entries[index]
    target = data.targets[entry.observation.robot]
    return coarse_fit.view_batches(entry.observation, target, placed(entry))


def _distinct(poses: Pose, most: int) -> np.ndarray:
    """Indices of the first of every group of like poses, at most `most` of them."""
    chosen: list[int] = []
    is_open: Array = np.ones(len(poses), dtype=bool)
    while np.any(is_open) and len(chosen) < most:
        chosen.append(int(np.argmax(is_open)))
        is_open &= ~faces.are_same_pose(poses, poses[chosen[-1]])
    return np.array(chosen)
