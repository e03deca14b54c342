"""What is measured of one session of a situation: errors in units of the bound and of the
estimator's own sigmas.

Measures are joint over all located cameras: e stacks their 6n errors by the contract's convention.
"""

import time

import numpy as np

from trigpoint.fusion.estimators.results import Results
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.tools.networks.cramer_rao import Bound

from .result import Camera, Result, Verdict
from .session import StudySession, simulated_session, worked_out

# An error of so many sigmas of the bound (the root of eᵀP⁻¹e/6 of one camera) is no noise: another
# face, another way up, or the plane's other solution.
GROSS = 8.0
# A camera whose position the bound puts within this, metres, is decided by the data.
DECIDED_M = 0.25


def measured(name: str, seed: int, *, estimator: str = "smoother") -> Result:
    """Simulate, work out and measure a session."""
    session = simulated_session(name, seed, estimator=estimator)
    began = time.process_time()
    results = worked_out(session).results()
    seconds = time.process_time() - began
    return measure_of(session, results, seconds)


def measure_of(session: StudySession, results: Results, seconds: float) -> Result:
    """The measures of results that took so many seconds."""
    bound, network = session.bound, results.network
    truth, is_open = session.simulated.cameras, session.left_open
    located = [name for name in network.located if name in bound.cameras]
    error = np.array([_pose(results, name).difference(truth[name]) for name in located])
    errors = dict(zip(located, error, strict=True))
    least, own = bound.of(located), _rows(results, located)

    def verdict(name: str) -> Verdict:
        if name in errors and _is_gross(errors[name], bound.of([name])):
            return Verdict.WRONG
        if name in network.located:
            is_sound = name in errors and name not in is_open
            return Verdict.RIGHT if is_sound else Verdict.MADE_UP
        if name in is_open:
            return Verdict.LEFT_OPEN
        return Verdict.MISSED if _is_decided(bound, name) else Verdict.UNKNOWN

    return Result(
        session=session.name,
        seed=session.seed,
        estimator=session.inputs.site.fusion.estimator,
        seconds=seconds,
        cameras=[
            Camera(name, verdict(name), is_moved=bool(network.cameras[name].earlier))
            for name in truth
        ],
        efficiency=_normalised(error, least.covariance) if located else None,
        honesty=_normalised(error, own) if located else None,
        distance=_distance_error(error, least),
        distance_bound=least.mean_distance_error,
        rejected=sum(camera.rejected for camera in network.cameras.values()),
    )


def _pose(results: Results, name: str) -> Pose:
    record = results.network.cameras[name].map_from_camera
    assert record is not None  # it is located
    return record.pose


def _rows(results: Results, names: list[str]) -> Array:
    order = results.network.located
    rows = np.array([6 * order.index(name) + axis for name in names for axis in range(6)], int)
    return results.covariance[np.ix_(rows, rows)]


def _normalised(error: Array, covariance: Array) -> float:
    """eᵀP⁻¹e/6n, after scaling P's diagonal to 1: metres and radians differ in size."""
    scale = 1 / np.sqrt(np.diagonal(covariance))
    e = error.reshape(-1) * scale
    return float(e @ np.linalg.solve(covariance * scale[:, None] * scale, e) / len(e))


def _is_gross(error: Array, bound: Bound) -> bool:
    return bool(np.sqrt(_normalised(error, bound.covariance)) > GROSS)


def _is_decided(bound: Bound, name: str) -> bool:
    if name not in bound.cameras:
        return False
    return bool(np.sqrt(np.trace(bound.of([name]).covariance[:3, :3])) < DECIDED_M)


def _distance_error(error: Array, bound: Bound) -> float:
    """Mean absolute error of the distances between cameras, metres; 0 with fewer than two."""
    first, second = np.triu_indices(len(bound.places), k=1)
    if len(first) == 0:
        return 0.0
    found = bound.places + error[:, :3]
    distances = [np.linalg.norm(p[first] - p[second], axis=1) for p in (found, bound.places)]
    return float(np.mean(np.abs(distances[0] - distances[1])))
