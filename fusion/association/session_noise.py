"""Puts what is learnt of a session's noise into its data: corners, jitter, odometry."""

from dataclasses import replace

import msgspec

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import LEAST_SIGMA_PX, Observation
from trigpoint.fusion.model.odometry import PARTS, SLIP

from .noise import Noise


def with_noise(data: DataSet, noise: dict[str, Noise]) -> DataSet:
    """The data set with each robot's noise as learnt, beside the one given."""
    tracks, jitter = dict(data.tracks), {}
    for robot, learnt in noise.items():
        stated = data.site.robots[robot].odometry
        factor = learnt.odometry
        scaled = {part: getattr(stated, part) * factor for part in PARTS}
        tracks[robot] = data.tracks[robot].noisy(
            msgspec.structs.replace(stated, **scaled), slip=SLIP * learnt.slip, skid=0.0
        )
        if learnt.jitter is not None:
            jitter[robot] = learnt.jitter
    return replace(data, tracks=tracks, jitter=jitter)


def with_corner_scale(observation: Observation, scale: float) -> Observation:
    """An observation whose corners scatter by this factor more than stated."""
    views = tuple(
        replace(view, sigma=max(view.sigma * scale, LEAST_SIGMA_PX)) for view in observation.views
    )
    return replace(observation, views=views)
