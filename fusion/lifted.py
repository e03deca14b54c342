"""A robot that was lifted and put down elsewhere: its odometry shows nothing of it.

What it drove before and after are two chains that nothing but the cameras ties together; so the
odometry is taken to know nothing of the moment, and the cameras say where the robot is since.
"""

import numpy as np

from .batch import BatchSolution, align_to
from .dataset import DataSet
from .filter import Filter, RobotEstimate, carried_on
from .observations import Observation, Verdict

# How well two places that cameras give to a robot must agree, beside what its odometry drifts.
_SIGMA_M = 0.03
_SIGMA_RAD = 0.03
_AGREEING = 25.0
_LEAST_CAMERAS = 2

# Index -> the sighting as it is read, and where it alone puts the robot.
_Placed = dict[int, tuple[Observation, RobotEstimate]]


def put_down(batch: BatchSolution, robot: str, wrong: list[int], known: Filter) -> bool:
    """Whether sightings that contradict the rest agree that a robot is elsewhere; then its
    odometry is broken before them, and they are used again."""
    data = batch.data
    placed = _placed(data, wrong, known)
    agreeing = _agreeing(data, robot, placed)
    cameras = {data.entries[index].observation.camera for index in agreeing}
    if len(cameras) < _LEAST_CAMERAS:
        return False
    # Of those that do not agree some are wrong, but none shows the robot where it was before.
    first_ns = min(data.entries[index].observation.stamp_ns for index in wrong)
    for after_ns, before_ns in _breaks(data, robot, first_ns):
        data.tracks[robot].break_between(after_ns, before_ns)
    for index in agreeing:
        observation, estimate = placed[index]
        data.entries[index].observation = observation.judged(Verdict.ACCEPTED)
        data.entries[index].map_from_base = estimate.map_from_base
    data.note(
        "robot_lifted",
        f"robot {robot} was put down elsewhere while its odometry showed nothing; its way is "
        "broken there, and it is located anew",
    )
    return True


def _placed(data: DataSet, wrong: list[int], known: Filter) -> _Placed:
    """Where each of these sightings alone puts the robot."""
    found: _Placed = {}
    for index in wrong:
        observation = data.entries[index].observation
        if not known.has_camera(observation.camera):
            continue  # it lost its place meanwhile
        aligned = align_to(data, known, observation, None)
        if aligned is not None:
            camera = known.state.cameras[observation.camera]
            apart = aligned[1].translation - camera.map_from_camera.translation
            distance = float(np.linalg.norm(apart))
            turn = known.camera_sigma_px(observation.camera, distance) / camera.lens.fx
            variance = np.repeat([_SIGMA_M**2 + (turn * distance) ** 2, _SIGMA_RAD**2 + turn**2], 3)
            estimate = RobotEstimate(observation.stamp_ns, aligned[1], np.diag(variance))
            found[index] = (aligned[0], estimate)
    return found


def _agreeing(data: DataSet, robot: str, placed: _Placed) -> list[int]:
    """The most of them that agree with one of them by the robot's odometry."""
    best: list[int] = []
    tangent = data.tracks[robot].tangent
    for _, start in placed.values():
        agreeing = []
        for index, (_, other) in placed.items():
            earlier, later = sorted([start, other], key=lambda estimate: estimate.stamp_ns)
            expected = carried_on(data, robot, earlier, later.stamp_ns, np.zeros(2))
            apart = later.map_from_base.difference(expected.map_from_base)[tangent]
            covariance = (expected.covariance + later.covariance)[np.ix_(tangent, tangent)]
            if apart @ np.linalg.solve(covariance, apart) < _AGREEING:
                agreeing.append(index)
        if len(agreeing) > len(best):
            best = agreeing
    return best


def _breaks(data: DataSet, robot: str, first_wrong_ns: int) -> list[tuple[int, int]]:
    """Between which moments the robot may have been lifted.

    It was where the map says it was when it last met a camera that it had met before. A camera that
    it met only since then may have been met before or after: it is cut off on both sides.
    """
    visits = _visits(data, robot, first_wrong_ns)
    if not visits:
        return [(data.tracks[robot].first_ns, first_wrong_ns)]
    found = [(visits[-1][2], first_wrong_ns)]
    for number in range(len(visits) - 1, 0, -1):
        camera, start_ns, end_ns = visits[number]
        if camera in data.known.poses or _is_seen_elsewhere(data, camera, robot, start_ns, end_ns):
            break
        found.append((visits[number - 1][2], start_ns))
    return found


def _visits(data: DataSet, robot: str, until_ns: int) -> list[tuple[str, int, int]]:
    """(camera, first stamp, last stamp) of a robot's runs of used sightings by one camera."""
    used = sorted(
        (entry.observation.stamp_ns, entry.observation.camera)
        for entry in data.entries
        if entry.observation.robot == robot
        and entry.observation.verdict is Verdict.ACCEPTED
        and entry.observation.stamp_ns < until_ns
    )
    visits: list[tuple[str, int, int]] = []
    for stamp_ns, camera in used:
        if visits and visits[-1][0] == camera:
            visits[-1] = (camera, visits[-1][1], stamp_ns)
        else:
            visits.append((camera, stamp_ns, stamp_ns))
    return visits


def _is_seen_elsewhere(data: DataSet, camera: str, robot: str, start_ns: int, end_ns: int) -> bool:
    """Whether a camera has used sightings of other robots, or of this one before this visit."""
    return any(
        entry.observation.robot != robot or entry.observation.stamp_ns < start_ns
        for entry in data.of_camera(camera)
        if entry.observation.verdict is Verdict.ACCEPTED and entry.observation.stamp_ns <= end_ns
    )
