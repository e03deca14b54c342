"""What constrains a robot's steps in several variants of a graph: odometry, visits or nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .graph import Graph, Variant


@dataclass(frozen=True, slots=True)
class ShownSteps:
    """What constrains a robot's steps (m) in b variants.

    `information` (b, m, d, d): of the steps; `log_covariance` (b,): the sum of their
    ln |covariance|, and for each lift that of where the robot may be put down; `is_anywhere`
    (b, m): the steps that are not constrained otherwise. Of the motions (k) that visits show:
    `rows`, `steps` (k,): their variants and steps, `motion` (k), and `by_scale` (k, 6, 2).
    """

    information: Array
    log_covariance: Array
    is_anywhere: np.ndarray
    rows: np.ndarray
    steps: np.ndarray
    motion: Pose
    by_scale: Array


def shown_steps(graph: Graph, robot: str, variants: Sequence[Variant]) -> ShownSteps:
    path = graph.paths[robot]
    room = graph.room(path)
    ways = []
    information = np.zeros((len(variants), *path.information.shape))
    log_covariance = np.zeros(len(variants))
    is_anywhere = np.zeros(information.shape[:2], dtype=bool)
    for row, variant in enumerate(variants):
        way = graph.way(robot, variant.nothing)
        for step in sorted(step for name, step in variant.breaks if name == robot):
            across = graph.across((robot, step), variant.nothing)
            way = way.broken(step, across)
            log_covariance[row] += np.sum(np.log(room))
            if across is None:  # only the prior of the room keeps it determined
                is_anywhere[row, step] = True
        ways.append(way)
        information[row] = way.information
        log_covariance[row] += way.log_covariance.sum()
    information[is_anywhere] = np.diag(1 / room)
    return ShownSteps(
        information,
        log_covariance,
        is_anywhere,
        np.repeat(np.arange(len(ways)), [len(way.steps) for way in ways]),
        np.concatenate([way.steps for way in ways]),
        Pose(
            np.concatenate([way.motion.rotation for way in ways]),
            np.concatenate([way.motion.translation for way in ways]),
        ),
        np.concatenate([way.by_scale for way in ways]),
    )
