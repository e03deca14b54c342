"""What guidance is worked out from: a copy of what a solution knows that nothing changes later."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .dataset import DataSet
from .filter import Filter
from .guidance_motion import RobotPlace, place_of
from .problem import Batch, Layout, Problem, State


@dataclass(frozen=True, slots=True)
class CameraViews:
    """Where robots stood when a camera saw them (n, 3), and the usual sigma of a corner, pixels."""

    places: Array
    sigma_px: float


@dataclass(frozen=True, slots=True)
class GuidanceWorld:
    """`information`: of the dense part by `layout`; `ways`: each robot's solved poses in order;
    `views`: of the located cameras, each at its last place."""

    layout: Layout
    information: Array
    state: State
    robots: dict[str, RobotPlace]
    ways: dict[str, Pose]
    views: dict[str, CameraViews]

    @classmethod
    def of(cls, data: DataSet, known: Filter, problem: Problem, state: State) -> "GuidanceWorld":
        """From a solution (`problem`, `state`) and the filter that carries it on."""
        robots = {
            name: place_of(data, known, name)
            for name in data.site.robots
            if known.has_robot(name) and len(data.tracks[name])
        }
        ways = {name: state.robots[name].map_from_base for name in problem.chains}
        here = [name for name in data.site.cameras if name in known.reduced.layout.pose]
        views = {name: _views(problem, state, name) for name in here}
        return cls(
            known.reduced.layout, known.reduced.information, known.state, robots, ways, views
        )


def _views(problem: Problem, state: State, camera: str) -> CameraViews:
    mine = [batch for batch in problem.batches if batch.camera == camera]
    places = [state.robots[b.robot].map_from_base.translation[b.nodes] for b in mine]
    weights = [_corner_weights(batch) for batch in mine]
    if not mine:
        return CameraViews(np.zeros((0, 3)), 1.0)
    return CameraViews(np.concatenate(places), float(1 / np.median(np.concatenate(weights))))


def _corner_weights(batch: Batch) -> Array:
    """1/sigma of the used corners, their observations' shares taken out."""
    weights = batch.weights / np.sqrt(batch.shares)[:, None]
    return weights[weights > 0]
