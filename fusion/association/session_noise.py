"""Puts what is learnt of a session's noise into its data: jitter, odometry."""

from dataclasses import replace

import msgspec

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import PARTS

from .noise import Noise


def with_noise(data: DataSet, noise: dict[str, Noise]) -> DataSet:
    """The data set with each robot's noise as learnt, beside the one given."""
    tracks, jitter = dict(data.tracks), {}
    for robot, learnt in noise.items():
        stated = data.site.robots[robot].odometry
        factor = learnt.odometry
        scaled = {part: getattr(stated, part) * factor for part in PARTS}
        track = data.tracks[robot]
        tracks[robot] = track.noisy(
            msgspec.structs.replace(stated, **scaled),
            slip=track.slip * learnt.slip,
            skid=track.skid * learnt.odometry,
        )
        if learnt.jitter is not None:
            jitter[robot] = learnt.jitter
    return replace(data, tracks=tracks, jitter=jitter)
