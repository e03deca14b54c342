"""Applies the noise learnt from a session to its data set: jitter and the noise of odometry."""

import msgspec
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import PARTS

from .noise import Noise


def with_noise(data: DataSet, noise: dict[str, Noise]) -> DataSet:
    """Return a copy of the data set with each robot's noise as learnt; the original is kept."""
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
