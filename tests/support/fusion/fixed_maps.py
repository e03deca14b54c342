"""Fixed maps of drives: what they say, and how much they hold."""

import gc
import sys
from collections.abc import Iterable

import numpy as np
from support.fusion.drives import EPOCH_NS, STEP_S, Session

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.messages import Message, PoseEstimate
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.fixed.network import FixedNetwork
from trigpoint.fusion.model.known_cameras import known_cameras
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

PLANE = [0, 1, 5]


def fixed_network(results: Results) -> FixedNetwork:
    """The network of a drive, to be held."""
    names = list(results.network.cameras)
    known = known_cameras(results.network, results.covariance, names)
    return FixedNetwork(results.network, results.covariance, known)


def corrections(
    pipeline: Pipeline, messages: Iterable[tuple[str, Message]]
) -> list[tuple[str, PoseEstimate]]:
    """What robots are told while messages come 20 ms after their moment: (camera, correction)."""
    found = []
    for node, message in messages:
        pipeline.push(node, message)
        for output in pipeline.advance(message.stamp_ns + to_ns(0.02)):  # pyright: ignore
            if output.topic is topics.CORRECTION:
                assert isinstance(output.message, PoseEstimate)
                found.append((node, output.message))
    return found


def errors(told: Iterable[PoseEstimate], truth: Pose) -> tuple[Array, Array]:
    """Errors (n, 3) in x, y and heading of what robots were told, and their χ² (n,); `truth`: a
    robot's poses every STEP_S."""
    apart, chi2 = [], []
    for message in told:
        true = truth[round((message.stamp_ns - EPOCH_NS) / to_ns(STEP_S))]
        error = message.pose.difference(true)[PLANE]
        apart.append(error)
        covariance = message.covariance[np.ix_(PLANE, PLANE)]
        chi2.append(float(error @ np.linalg.solve(covariance, error)))
    return np.array(apart), np.array(chi2)


def held_bytes(root: object) -> int:
    """How much memory an object holds, with all that only data in it refer to."""
    seen, waiting, size = set[int](), [root], 0
    while waiting:
        one = waiting.pop()
        if id(one) in seen or isinstance(one, type) or callable(one) or sys.modules is one:
            continue
        seen.add(id(one))
        size += one.nbytes if isinstance(one, np.ndarray) else sys.getsizeof(one)
        waiting += gc.get_referents(one)
    return size


def truth_of(session: Session) -> Pose:
    """The true poses of r1."""
    return session.truth["r1"]
